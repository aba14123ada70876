// Gamepads and wheels, by the Gamepad API. The one that was moved last is used. One that is not at rest when it appears
// is not heeded before it has been: a stick that hangs aside, a pedal that was never pressed.

const STANDARD = { steering: 0, brake: 6, throttle: 7 }; // an axis, two triggers
const TRIGGER_FROM = 0.05;
const POLLS_TO_BEGIN = 2; // a single spike is noise
const PEDAL_AT_REST = 0.9; // an axis of -1 .. 1 rests at one of its ends
const FLIPS_OF_NOISE = 8; // from side to side in a second: no hand does that
const NOISE_MS = 1000;

const finite = (value) => (Number.isFinite(value) ? Math.min(Math.max(value, -1), 1) : 0);

/** A stick's steering: 0 within the dead zone, then by a curve to full lock. */
export function shaped(value, deadZone, curve) {
  const beyond = Math.max(Math.abs(finite(value)) - deadZone, 0) / (1 - deadZone);
  return Math.sign(value) * beyond ** curve || 0;
}

export class Gamepads {
  device = "gamepad";
  steering = 0;
  throttle = 0;
  isSteering = false;
  isTouching = false;
  name = ""; // of the one that is used
  #index = null;
  #pads = new Map();
  #settings;
  #onProblem;

  /** `onProblem` is called with a text when there is a problem that the person should know. */
  constructor(settings, onProblem) {
    this.#settings = settings;
    this.#onProblem = onProblem;
  }

  /** Their names, for the page. */
  get names() {
    return [...this.#pads.values()].map((pad) => pad.name);
  }

  /** The window has lost the focus: they must be at rest before they steer again. */
  release() {
    for (const pad of this.#pads.values()) Object.assign(pad, { hasRested: false, moved: 0 });
    this.#rest();
  }

  advance() {
    const now = performance.now();
    const pads = this.#connected();
    for (const index of this.#pads.keys()) if (!pads.has(index)) this.#unplug(index);
    for (const [index, pad] of pads) {
      const known = this.#pads.get(index) ?? this.#plug(index, pad);
      Object.assign(known, this.#read(known, pad, now));
      const isMoved = known.steering !== 0 || known.throttle !== 0;
      if (!isMoved) known.hasRested = true;
      known.moved = isMoved && known.hasRested ? known.moved + 1 : 0;
      if (known.moved === POLLS_TO_BEGIN) this.#index = index;
    }
    const used = this.#pads.get(this.#index);
    if (!used || used.moved < POLLS_TO_BEGIN) return this.#rest();
    Object.assign(this, { name: used.name, steering: used.steering, throttle: used.throttle });
    this.isSteering = this.steering !== 0;
    this.isTouching = true;
  }

  #connected() {
    let all = [];
    try {
      all = navigator.getGamepads();
    } catch {
      // not allowed here
    }
    return new Map([...all].filter((pad) => pad?.connected).map((pad) => [pad.index, pad]));
  }

  #plug(index, pad) {
    const known = { name: String(pad.id).slice(0, 60) || "gamepad", moved: 0, hasRested: false, flips: [], side: 0, rests: {} };
    this.#pads.set(index, known);
    return known;
  }

  #unplug(index) {
    const { name } = this.#pads.get(index);
    this.#pads.delete(index);
    if (index !== this.#index) return;
    this.#index = null;
    this.#onProblem(`${name} was unplugged: its steering is back at 0`);
  }

  #rest() {
    this.steering = this.throttle = 0;
    this.isSteering = this.isTouching = false;
  }

  #read(known, pad, now) {
    const { dead_zone, curve, steer_axis, throttle_axis, brake_axis } = this.#settings;
    const isStandard = pad.mapping === "standard";
    const steering = shaped(pad.axes[isStandard ? STANDARD.steering : steer_axis], dead_zone, curve);
    if (this.#isNoise(known, steering, now)) return { steering: 0, throttle: 0 };
    const pedal = (button, axis) => Math.max(trigger(pad.buttons[button]), isStandard ? 0 : pressed(known, pad.axes, axis));
    return { steering, throttle: pedal(STANDARD.throttle, throttle_axis) - pedal(STANDARD.brake, brake_axis) };
  }

  #isNoise(known, steering, now) {
    const side = Math.sign(steering);
    if (side && side !== known.side) {
      known.flips.push(now);
      known.side = side;
    }
    known.flips = known.flips.filter((at) => now - at < NOISE_MS);
    const isNoise = known.flips.length > FLIPS_OF_NOISE;
    if (isNoise && !known.isNoisy) this.#onProblem(`${known.name} sends noise and is ignored: give it a larger dead zone`);
    known.isNoisy = isNoise;
    return isNoise;
  }
}

function trigger(button) {
  const value = finite(button?.value);
  return value > TRIGGER_FROM ? value : 0;
}

/** How far a pedal is pressed. An axis reads 0 before it was moved: it counts once it has been at one of its ends. */
function pressed(known, axes, axis) {
  if (axis < 0 || axis >= axes.length) return 0;
  const value = finite(axes[axis]);
  if (Math.abs(value) >= PEDAL_AT_REST) known.rests[axis] ??= Math.sign(value);
  const rest = known.rests[axis];
  const way = rest ? (1 - rest * value) / 2 : 0;
  return way > TRIGGER_FROM ? way : 0;
}
