// The whole log in a strip that stays in view: steering, bands, the present moment, and the part that the curves show.
// Click or drag to go to a moment.

import { drawAll, drawTracks } from "./bands.js";

const LANE = 4;

export class Overview {
  /** `onMove(position)`: the strip was dragged to that moment. */
  constructor(element, data, curves, { onMove }) {
    const [canvas, marker] = element.children;
    Object.assign(this, { canvas, marker, data, curves });
    curves.watch(() => this.draw());
    const move = ({ clientX, buttons }) => {
      const { left, width } = element.getBoundingClientRect();
      if (buttons && data.length) onMove(Math.round(Math.min(Math.max((clientX - left) / width, 0), 1) * (data.length - 1)));
    };
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      move(event);
    });
    element.addEventListener("pointermove", move);
  }

  point(position) {
    this.marker.style.left = `${(position / Math.max(this.data.length - 1, 1)) * 100}%`;
  }

  draw() {
    const { canvas, curves, data } = this;
    const [plot] = curves.plots;
    canvas.hidden = !plot;
    if (!plot) return;
    const scale = devicePixelRatio;
    canvas.width = canvas.clientWidth * scale;
    canvas.height = canvas.clientHeight * scale;
    const context = canvas.getContext("2d");
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
