// The time from a key's event to the first painted frame in which the car obeys.

const KEPT = 100;

export class Delays {
  newest = []; // ms
  #waiting = []; // [number of the control, time of its event]

  /** An event has changed the control that was sent under this number. */
  sent(number, event_ms) {
    this.#waiting.push([number, event_ms]);
    if (this.#waiting.length > KEPT) this.#waiting.shift();
  }

  /** A frame with the control of this number is on the screen. */
  painted(number) {
    const now = performance.now();
    while (this.#waiting.length && this.#waiting[0][0] <= number) {
      this.newest.push(now - this.#waiting.shift()[1]);
      if (this.newest.length > KEPT) this.newest.shift();
    }
  }

  /** Drop events whose frames will not come. */
  forget() {
    this.#waiting = [];
  }

  /** The median of the latest delays; null before the first. */
  get median() {
    const sorted = [...this.newest].sort((a, b) => a - b);
    return sorted.length ? sorted[sorted.length >> 1] : null;
  }
}
