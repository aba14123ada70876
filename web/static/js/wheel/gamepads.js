// Gamepads and wheels, by the Gamepad API. The one moved last is used. A device must be at rest once before it counts:
// a stick may hang to the side, and a pedal that was never pressed reads 0.

const BUTTONS = { r: 0, b: 1, x: 2, h: 3, escape: 9 }; // of a standard gamepad, by the key that each presses
const STANDARD = { steering: 0, brake: 6, throttle: 7 }; // an axis, two triggers
const TRIGGER_FROM = 0.05;
const POLLS_TO_BEGIN = 2; // a single spike is noise
const PEDAL_AT_REST = 0.9; // an axis of -1 .. 1 rests at one of its ends
const FLIPS_OF_NOISE = 8; // from side to side in NOISE_MS: no hand does that
const NOISE_MS = 1000;

const finite = (value) => (Number.isFinite(value) ? Math.min(Math.max(value, -1), 1) : 0);

/** A stick's steering: 0 within the dead zone, then by a curve to full lock. */
function shaped(value, deadZone, curve) {
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
  #onKey;
  #onLearnt = null;

  /** `onProblem` gets messages for the person, `onKey` the keys that buttons press. */
  constructor(settings, onProblem, onKey) {
    this.#onKey = onKey;
    this.#settings = settings;
    this.#onProblem = onProblem;
  }

  get names() {
    return [...this.#pads.values()].map((pad) => pad.name);
  }

  /** The next button that is pressed is given to `onLearnt`, instead of doing something; null: none is awaited. */
  learn(onLearnt) {
    this.#onLearnt = onLearnt;
  }

  /** The window has lost the focus: devices must be at rest before they steer again. */
  release() {
    for (const pad of this.#pads.values()) Object.assign(pad, { hasRested: false, moved: 0 });
    this.#rest();
  }

  advance() {
    const now = performance.now();
    const pads = this.#connected();
    for (const index of this.#pads.keys()) if (!pads.has(index)) this.#unplug(index);
    for (const [index, pad] of pads) {
      const state = this.#pads.get(index) ?? this.#plug(index, pad);
      Object.assign(state, this.#read(state, pad, now));
      const isMoved = state.steering !== 0 || state.throttle !== 0;
      if (!isMoved) state.hasRested = true;
      state.moved = isMoved && state.hasRested ? state.moved + 1 : 0;
      if (state.moved === POLLS_TO_BEGIN) this.#index = index;
    }
    const used = this.#pads.get(this.#index);
    if (!used || used.moved < POLLS_TO_BEGIN) return this.#rest();
    Object.assign(this, { name: used.name, steering: used.steering, throttle: used.throttle });
    this.isSteering = this.steering !== 0;
    this.isTouching = true;
  }

  #connected() {
    const all = navigator.getGamepads?.() ?? []; // only at an encrypted or local address
    return new Map([...all].filter((pad) => pad?.connected).map((pad) => [pad.index, pad]));
  }

  #plug(index, pad) {
    const state = { name: String(pad.id).slice(0, 60) || "gamepad", moved: 0, hasRested: false, flips: [], side: 0, rests: {}, down: {} };
    this.#pads.set(index, state);
    return state;
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

  #read(state, pad, now) {
    const { dead_zone, curve, steer_axis, throttle_axis, brake_axis } = this.#settings;
    const isStandard = pad.mapping === "standard";
    this.#press(state, pad.buttons, isStandard);
    const steering = shaped(pad.axes[isStandard ? STANDARD.steering : steer_axis], dead_zone, curve);
    if (this.#isNoise(state, steering, now)) return { steering: 0, throttle: 0 };
    const pedal = (button, axis) => Math.max(trigger(pad.buttons[button]), isStandard ? 0 : pressed(state, pad.axes, axis));
    return { steering, throttle: pedal(STANDARD.throttle, throttle_axis) - pedal(STANDARD.brake, brake_axis) };
  }

  #press(state, buttons, isStandard) {
    buttons.forEach((button, at) => {
      if (isStandard && (at === STANDARD.brake || at === STANDARD.throttle)) return;
      const isDown = trigger(button) > 0;
      if (isDown && state.down[at] === false) this.#pressed(at, isStandard); // it was seen released before
      state.down[at] = isDown;
    });
  }

  #pressed(at, isStandard) {
    const onLearnt = this.#onLearnt;
    this.#onLearnt = null;
    if (onLearnt) return onLearnt(at);
    const buttonOf = (key) => (this.#settings[`button_${key}`] >= 0 || !isStandard ? this.#settings[`button_${key}`] : BUTTONS[key]);
    const key = Object.keys(BUTTONS).find((name) => buttonOf(name) === at);
    if (key) this.#onKey(key);
  }

  #isNoise(state, steering, now) {
    const side = Math.sign(steering);
    if (side && side !== state.side) {
      state.flips.push(now);
      state.side = side;
    }
    state.flips = state.flips.filter((at) => now - at < NOISE_MS);
    const isNoise = state.flips.length > FLIPS_OF_NOISE;
    if (isNoise && !state.isNoisy) this.#onProblem(`${state.name} sends noise and is ignored: give it a larger dead zone`);
    state.isNoisy = isNoise;
    return isNoise;
  }
}

function trigger(button) {
  const value = finite(button?.value);
  return value > TRIGGER_FROM ? value : 0;
}

/** How far a pedal is pressed, 0 to 1. An axis counts after it was at one of its ends: before, it reads 0. */
function pressed(state, axes, axis) {
  if (axis < 0 || axis >= axes.length) return 0;
  const value = finite(axes[axis]);
  if (Math.abs(value) >= PEDAL_AT_REST) state.rests[axis] ??= Math.sign(value);
  const rest = state.rests[axis];
  const share = rest ? (1 - rest * value) / 2 : 0;
  return share > TRIGGER_FROM ? share : 0;
}
