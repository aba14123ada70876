// How long it takes from a key's event to the first painted frame in which it is in force.

const KEPT = 100;

export class Delays {
  newest = []; // ms
  #waiting = []; // [number of the control, time of its event]

  /** An event has changed the control that is sent under this number. */
  sent(number, event_ms) {
    this.#waiting.push([number, event_ms]);
    if (this.#waiting.length > KEPT) this.#waiting.shift();
  }

  /** A frame is on the screen in which the control of this number is in force. */
  painted(number) {
    const now = performance.now();
    while (this.#waiting.length && this.#waiting[0][0] <= number) {
      this.newest.push(now - this.#waiting.shift()[1]);
      if (this.newest.length > KEPT) this.newest.shift();
    }
  }

  /** What waits will never be painted. */
  forget() {
    this.#waiting = [];
  }

  /** Of the last ones; null before the first. */
  get median() {
    const sorted = [...this.newest].sort((a, b) => a - b);
    return sorted.length ? sorted[sorted.length >> 1] : null;
  }
}
