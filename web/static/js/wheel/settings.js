// A person's settings for driving. The browser remembers them.

const NAME = "wheel";
const DEFAULTS = {
  holds: true, // the page holds the speed
  hold_mph: 10,
  hold_of: "", // the drive for which this speed was chosen
  dead_zone: 0.1, // share of a stick's range
  curve: 1.5, // exponent: above 1, a stick steers finely near its middle
  steer_axis: 0, // for a wheel whose axes have no standard order
  throttle_axis: -1, // none
  brake_axis: -1,
  button_r: -1, // learnt: what does the same as this key; -1 is none
  button_x: -1,
  button_b: -1,
  button_h: -1,
  button_escape: -1,
  recorded: false, // show the picture as recorded
};
const BOUNDS = { hold_mph: [1, 100], dead_zone: [0, 0.9], curve: [1, 4], steer_axis: [0, 15], throttle_axis: [-1, 15], brake_axis: [-1, 15] };
for (const name of Object.keys(DEFAULTS)) if (name.startsWith("button_")) BOUNDS[name] = [-1, 63];

export function loadSettings() {
  const kept = JSON.parse(localStorage.getItem(NAME)) ?? {};
  return Object.fromEntries(Object.entries(DEFAULTS).map(([name, value]) => [name, valid(name, kept[name], value)]));
}

/** Change a setting. An invalid value changes nothing. */
export function saveSetting(settings, name, value) {
  settings[name] = valid(name, value, settings[name]);
  localStorage.setItem(NAME, JSON.stringify(settings));
}

/** A value within its bounds; `fallback` for an invalid one. */
function valid(name, value, fallback) {
  if (typeof value !== typeof fallback || Number.isNaN(value)) return fallback;
  if (typeof value !== "number") return value;
  const [min, max] = BOUNDS[name];
  return Math.min(Math.max(value, min), max);
}
