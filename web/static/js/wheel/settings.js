// What a person has chosen for driving. The browser remembers it.

const NAME = "wheel";
const DEFAULTS = {
  holds: true, // the speed
  hold_mph: 10,
  hold_of: "", // the drive that this speed was chosen for
  dead_zone: 0.1, // of a stick's way
  curve: 1.5, // exponent: above 1, a stick steers finely about its middle
  steer_axis: 0, // of a wheel whose axes have no standard order
  throttle_axis: -1, // none
  brake_axis: -1,
  recorded: false, // the picture as it is recorded
};
const BOUNDS = { hold_mph: [1, 100], dead_zone: [0, 0.9], curve: [1, 4], steer_axis: [0, 15], throttle_axis: [-1, 15], brake_axis: [-1, 15] };

/** The settings, each a valid value. */
export function loadSettings() {
  let kept = {};
  try {
    kept = JSON.parse(localStorage.getItem(NAME)) ?? {};
  } catch {
    // no storage here, or not ours: the defaults hold
  }
  return Object.fromEntries(Object.entries(DEFAULTS).map(([name, usual]) => [name, valid(name, kept[name], usual)]));
}

/** Change one of them; what is no valid value changes nothing. */
export function saveSetting(settings, name, value) {
  settings[name] = valid(name, value, settings[name]);
  try {
    localStorage.setItem(NAME, JSON.stringify(settings));
  } catch {
    // it holds until the page is closed
  }
}

const HELD = "wheel held";

/** This tab holds the wheel of a drive and goes away; it may be a reload. */
export function keepHeld(drive) {
  try {
    sessionStorage.setItem(HELD, drive);
  } catch {
    // no storage here: a reloaded page gets the wheel if it is free
  }
}

/** Whether this tab held the wheel of that drive before it was reloaded. */
export function heldBefore(drive) {
  try {
    const held = sessionStorage.getItem(HELD);
    sessionStorage.removeItem(HELD);
    return held === drive;
  } catch {
    return false;
  }
}

function valid(name, value, otherwise) {
  if (typeof value !== typeof otherwise || Number.isNaN(value)) return otherwise;
  if (typeof value !== "number") return value;
  const [least, most] = BOUNDS[name];
  return Math.min(Math.max(value, least), most);
}
