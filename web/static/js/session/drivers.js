// A band below the curves that shows who drove.

import { colourReader, make } from "../dom.js";
import { fittedContext } from "./bands.js";
import { DRIVERS } from "./course.js";

export class DriverBand {
  constructor(figure, course, curves) {
    Object.assign(this, { figure, course, curves, canvas: figure.querySelector("canvas") });
    curves.watch(() => this.draw());
  }

  /** The course has changed: show names, shares and the band. */
  show() {
    const { shares } = this.course;
    this.figure.hidden = !shares.length;
    const words = shares.map(([style, name, share]) => make("span", { className: `by-${style}` }, `${name} ${percent(share)}`));
    this.figure.querySelector("figcaption").replaceChildren("who drove: ", ...words);
    this.draw();
  }

  draw() {
    const { canvas } = this;
    const [plot] = this.curves.plots;
    if (this.figure.hidden || !plot) return;
    const context = fittedContext(canvas, plot);
    const color = colourReader(canvas);
    const { min, max } = plot.scales.x;
    const across = (at) => ((at - min) / (max - min)) * canvas.width;
    for (const { driver, first, last } of this.course.stretches) {
      if (last < min - 1 || first > max + 1) continue;
      const left = across(first - 0.5);
      context.fillStyle = color(DRIVERS[driver][2]);
      context.fillRect(left, 0, Math.max(across(last + 0.5) - left, devicePixelRatio), canvas.height);
    }
  }
}

function percent(share) {
  const whole = Math.round(share * 100);
  return whole > 0 && (whole < 100 || share === 1) ? `${whole} %` : `${(share * 100).toFixed(1)} %`;
}
