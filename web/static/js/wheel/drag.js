// Steering by a drag of the mouse or of a finger, from where it began. The mouse is that of Udacity's training mode:
// 170 pixels are full lock, and without the button the car goes straight. A finger also drives and brakes, up and down.

const FULL_LOCK_PX = 170;
const FINGER_LOCK_SHARE = 0.3; // of the width: a phone is narrow
const FULL_THROTTLE_PX = 110;
const THROTTLE_FROM_PX = 30; // nobody drags straight aside

const share = (moved, full) => Math.min(Math.max(moved / full, -1), 1);

export class Drag {
  steering = 0;
  throttle = 0;
  isTouching = false;
  #pointer = null;

  /** `device`: "mouse", or "touch" for fingers and pens. `onChange` is called with the event that has changed it. */
  constructor(element, device, onChange) {
    this.device = device;
    element.addEventListener("pointerdown", (event) => {
      if ((event.pointerType === "mouse") !== (device === "mouse") || event.button !== 0 || this.#pointer) return;
      element.setPointerCapture(event.pointerId); // it may leave the element
      const lock = Math.min(FULL_LOCK_PX, FINGER_LOCK_SHARE * element.clientWidth);
      this.#pointer = { id: event.pointerId, x: event.clientX, y: event.clientY, lock: device === "mouse" ? FULL_LOCK_PX : lock };
      this.isTouching = true;
      onChange(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (event.pointerId !== this.#pointer?.id) return;
      this.steering = share(Math.round(event.clientX - this.#pointer.x), this.#pointer.lock);
      if (device === "touch") {
        const up = this.#pointer.y - event.clientY;
        this.throttle = share(Math.sign(up) * Math.max(Math.abs(up) - THROTTLE_FROM_PX, 0), FULL_THROTTLE_PX);
      }
      onChange(event);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(name, (event) => {
        if (event.pointerId !== this.#pointer?.id) return;
        this.release();
        onChange(event);
      });
    }
    element.addEventListener("contextmenu", (event) => this.isTouching && event.preventDefault());
  }

  get isSteering() {
    return this.isTouching;
  }

  release() {
    this.#pointer = null;
    this.steering = this.throttle = 0;
    this.isTouching = false;
  }

  advance() {
    // a hand is as fast as it is
  }
}
