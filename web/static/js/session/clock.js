// Times and steering as text.

/** Seconds as 1:02.3, or 1:00:02.3 from an hour on. */
export function clock(seconds) {
  const tenths = Math.round(seconds * 10);
  const minutes = Math.floor(tenths / 600);
  const rest = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return minutes < 60
    ? `${minutes}:${rest}`
    : `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}

/** Steering (-1 to 1) in degrees; in shares of full lock if the angle at 1 is unknown (null). */
export function angle(steering, maxDeg, digits = 1) {
  return maxDeg === null ? `${(steering * 100).toFixed(digits)} %` : `${(steering * maxDeg).toFixed(digits)}°`;
}
