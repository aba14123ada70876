// The whole log in a strip above the curves: steering, bands, and the part that the curves show. Drag this part, or
// drag over the strip to show another part.

import { drawAll, drawTracks, fittedContext } from "./bands.js";

const LANE = 4;

export class Overview {
  constructor(canvas, data, curves) {
    Object.assign(this, { canvas, data, curves, dragged: null });
    curves.watch(() => this.draw());
    canvas.addEventListener("pointerdown", (event) => this.begin(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("pointerup", (event) => this.end(event));
  }

  begin(event) {
    if (!this.data.length) return;
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.position(event);
    const { view } = this.curves;
    this.dragged = { at, view: view && at >= view.min && at <= view.max ? view : null, isMoved: false };
  }

  drag(event) {
    if (!this.dragged) return;
    const at = this.position(event);
    const { view, at: begun } = this.dragged;
    this.dragged.isMoved ||= Math.abs(at - begun) * this.canvas.clientWidth > 4 * this.data.length;
    if (!this.dragged.isMoved) return;
    if (view) this.curves.show(view.min + at - begun, view.max + at - begun);
    else this.curves.show(Math.min(at, begun), Math.max(at, begun));
  }

  /** A click shows this place. The zoom stays. */
  end(event) {
    if (this.dragged && !this.dragged.isMoved) {
      const { min, max } = this.curves.view ?? { min: 0, max: this.data.length / 10 };
      const at = this.position(event);
      this.curves.show(at - (max - min) / 2, at + (max - min) / 2);
    }
    this.dragged = null;
  }

  position({ clientX }) {
    const { left, width } = this.canvas.getBoundingClientRect();
    return Math.min(Math.max((clientX - left) / width, 0), 1) * (this.data.length - 1);
  }

  draw() {
    const { canvas, curves, data } = this;
    const [plot] = curves.plots;
    canvas.hidden = !plot;
    if (!plot) return;
    const scale = devicePixelRatio;
    const context = fittedContext(canvas, plot);
    const across = (at) => (at / Math.max(data.length - 1, 1)) * canvas.width;
    const box = { top: 0, height: canvas.height, min: 0, max: data.length - 1, across };
    drawTracks(context, data, curves.odd, curves.colors, box, LANE * scale);
    drawAll(context, curves.selection, box, [[curves.colors.selection, 0, canvas.height]]);
    this.drawSteering(context, across);
    const { min, max } = curves.view ?? { min: 0, max: data.length - 1 };
    context.fillStyle = curves.colors.outside;
    context.fillRect(0, 0, across(min), canvas.height);
    context.fillRect(across(max), 0, canvas.width - across(max), canvas.height);
    context.strokeStyle = curves.colors.break;
    context.lineWidth = scale;
    context.strokeRect(across(min) + scale / 2, scale / 2, across(max) - across(min) - scale, canvas.height - scale);
  }

  /** At each pixel, a line from the lowest to the highest steering. */
  drawSteering(context, across) {
    const { height, width } = this.canvas;
    const { steering } = this.data.columns;
    const y = (value) => height / 2 - (value * (height - 4)) / 2;
    context.strokeStyle = this.curves.colors.steering;
    context.lineWidth = 1;
    context.beginPath();
    let at = 0;
    for (let x = 0; x < width; x += 1) {
      let low = at ? steering[at - 1] : Infinity; // joined to the pixel before
      let high = at ? low : -Infinity;
      for (; at < steering.length && across(at) <= x + 1; at += 1) {
        if (steering[at] < low) low = steering[at];
        if (steering[at] > high) high = steering[at];
      }
      if (low > high) continue;
      context.moveTo(x + 0.5, y(high) - 0.5);
      context.lineTo(x + 0.5, y(low) + 0.5);
    }
    context.stroke();
  }
}
