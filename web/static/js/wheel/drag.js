// Steering by dragging the mouse or a finger from where the drag began. The mouse works as in Udacity's training mode:
// 170 pixels are full lock, and without the button the car goes straight. A finger also drives (up) and brakes (down).

const FULL_LOCK_PX = 170;
const FINGER_LOCK_SHARE = 0.3; // of the element's width, on narrow phones
const FULL_THROTTLE_PX = 110;
const THROTTLE_FROM_PX = 30; // a drag to the side also goes up or down a little

const share = (moved, full) => Math.min(Math.max(moved / full, -1), 1);

export class Drag {
  steering = 0;
  throttle = 0;
  #pointer = null;

  /** `device`: "mouse", or "touch" for fingers and pens. `onChange` gets the event that has changed the steering. */
  constructor(element, device, onChange) {
    this.device = device;
    element.addEventListener("pointerdown", (event) => {
      if ((event.pointerType === "mouse") !== (device === "mouse") || event.button !== 0 || this.#pointer) return;
      element.setPointerCapture(event.pointerId); // the pointer may leave the element
      const lock = Math.min(FULL_LOCK_PX, FINGER_LOCK_SHARE * element.clientWidth);
      this.#pointer = { id: event.pointerId, x: event.clientX, y: event.clientY, lock: device === "mouse" ? FULL_LOCK_PX : lock };
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

  get isTouching() {
    return this.#pointer !== null;
  }

  get isSteering() {
    return this.isTouching;
  }

  release() {
    this.#pointer = null;
    this.steering = this.throttle = 0;
  }

  advance() {
    // unlike keys, a hand sets the steering itself
  }
}
