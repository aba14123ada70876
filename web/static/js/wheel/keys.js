// Arrow keys and WASD, by the rule of Unity's input axes: the steering moves 3 times full lock a second, out and back. A
// key of the other side jumps to 0 first. Two opposite keys cancel out.

const PER_S = 3;
const SIDES = {
  ArrowLeft: "left", ArrowRight: "right", ArrowUp: "up", ArrowDown: "down",
  KeyA: "left", KeyD: "right", KeyW: "up", KeyS: "down",
};

/** A value after so many more seconds on its way to a target. */
function moved(value, target, seconds) {
  const from = target * value < 0 ? 0 : value;
  const most = PER_S * seconds;
  return from + Math.min(Math.max(target - from, -most), most);
}

export class Keys {
  device = "keyboard";
  steering = 0;
  throttle = 0;
  #held = new Set();

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
    this.steering = this.throttle = 0;
  }

  advance(seconds) {
    const sides = new Set([...this.#held].map((code) => SIDES[code]));
    const pull = (less, more) => sides.has(more) - sides.has(less);
    this.steering = moved(this.steering, pull("left", "right"), seconds);
    this.throttle = moved(this.throttle, pull("down", "up"), seconds);
    this.isSteering = sides.has("left") || sides.has("right");
    this.isTouching = sides.size > 0;
  }
}
