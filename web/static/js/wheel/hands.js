// One control from all devices. The device whose steering began last steers. Throttle and brake come from any device.

export class Hands {
  #devices;
  #settings;
  #used;
  #before = new Map();
  #hasBegun = false;

  constructor(devices, settings) {
    this.#devices = devices;
    this.#settings = settings;
    this.#used = devices[0];
  }

  release() {
    for (const device of this.#devices) device.release();
  }

  get isWaiting() {
    return !this.#hasBegun;
  }

  /** The speed is held from now on; before, the car waits for the first touch. */
  begin() {
    this.#hasBegun = true;
  }

  /** The control after so many more seconds. */
  control(seconds) {
    for (const device of this.#devices) device.advance(seconds);
    const begun = (name) => this.#devices.find((device) => device[name] && !this.#before.get(device)?.[name]);
    this.#used = begun("isSteering") ?? (this.#used.isSteering ? this.#used : (begun("isTouching") ?? this.#used));
    for (const device of this.#devices) {
      this.#before.set(device, { isSteering: device.isSteering, isTouching: device.isTouching });
    }
    const touching = this.#devices.some((device) => device.isTouching);
    this.#hasBegun ||= touching;
    const throttle = this.#devices.find((device) => device.throttle)?.throttle ?? 0;
    return {
      steering: this.#used.steering,
      throttle,
      hold_mph: this.#settings.holds && this.#hasBegun && !throttle ? this.#settings.hold_mph : null,
      device: this.#used.device,
      touching,
    };
  }
}
