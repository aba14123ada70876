// The picture of the centre camera, painted on a canvas.

export class Picture {
  #canvas;
  #context;
  #newest = 0;

  constructor(canvas) {
    this.#canvas = canvas;
    this.#context = canvas.getContext("2d", { alpha: false });
  }

  /** Paint a frame. True once it is on the screen; false if a newer one is, or if it does not decode. */
  async paint(number, jpeg) {
    const image = await createImageBitmap(jpeg).catch(() => null);
    if (!image || number < this.#newest) return false;
    this.#newest = number;
    if (this.#canvas.width !== image.width || this.#canvas.height !== image.height) {
      Object.assign(this.#canvas, { width: image.width, height: image.height });
    }
    this.#context.drawImage(image, 0, 0);
    image.close();
    await new Promise(requestAnimationFrame);
    return true;
  }

  /** Another process numbers its frames anew. */
  restart() {
    this.#newest = 0;
  }
}
