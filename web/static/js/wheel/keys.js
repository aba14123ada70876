// Arrow keys and WASD, by the rule of Unity's input axes: the steering moves 3 times full lock a second, out and back. A
// key of the other side jumps to 0 first. Two opposite keys cancel out.

const PER_S = 3;
const SIDES = {
  ArrowLeft: "left",
  KeyA: "left",
  ArrowRight: "right",
  KeyD: "right",
  ArrowUp: "up",
  KeyW: "up",
  ArrowDown: "down",
  KeyS: "down",
};

class Axis {
  value = 0;

  advance(target, seconds) {
    if (target * this.value < 0) this.value = 0;
    const most = PER_S * seconds;
    this.value += Math.min(Math.max(target - this.value, -most), most);
  }
}

export class Keys {
  device = "keyboard";
  #held = new Set();
  #steering = new Axis();
  #throttle = new Axis();

  /** Whether a key, by its place on the keyboard, is for driving. */
  static drives(code) {
    return code in SIDES;
  }

  down(code) {
    this.#held.add(code);
  }

  up(code) {
    this.#held.delete(code);
  }

  /** Release all keys. The steering is 0 at once, because a hidden page gets no frames. */
  release() {
    this.#held.clear();
    this.#steering.value = this.#throttle.value = 0;
  }

  /** Time has passed. */
  advance(seconds) {
    const sides = new Set([...this.#held].map((code) => SIDES[code]));
    const pull = (less, more) => sides.has(more) - sides.has(less);
    this.#steering.advance(pull("left", "right"), seconds);
    this.#throttle.advance(pull("down", "up"), seconds);
    this.isSteering = sides.has("left") || sides.has("right");
    this.isTouching = sides.size > 0;
    this.steering = this.#steering.value;
    this.throttle = this.#throttle.value;
  }
}
