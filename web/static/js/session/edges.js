// Handles to drag the edges of selected stretches.

import { make } from "../dom.js";
import { withEdge } from "./selection.js";

const MAX_STRETCHES = 40; // with handles
const MIN_WIDTH = 16; // pixels of a stretch with handles
const SIDES = ["first", "last"];

export class Edges {
  constructor(curves, { onChange }) {
    Object.assign(this, { curves, onChange, handles: new Map() });
    curves.watch(() => this.place());
  }

  /** Put the handles at the edges. A dragged handle stays the same element. */
  place() {
    const { plots, selection } = this.curves;
    for (const plot of plots) {
      const handles = this.#handlesOf(plot, selection.length <= MAX_STRETCHES ? selection.length : 0);
      const width = plot.bbox.width / devicePixelRatio;
      handles.forEach((handle, at) => {
        const { first, last } = selection[at >> 1];
        const [begin, end] = [first - 0.5, last + 0.5].map((edge) => plot.valToPos(edge, "x"));
        const left = at % 2 ? end : begin;
        handle.hidden = !handle.isDragged && (left < 0 || left > width || end - begin < MIN_WIDTH);
        handle.style.transform = `translateX(${left}px)`;
      });
    }
  }

  #handlesOf(plot, stretches) {
    const handles = this.handles.get(plot) ?? [];
    if (!this.handles.has(plot)) this.handles = new Map(this.curves.plots.map((drawn) => [drawn, this.handles.get(drawn) ?? []]));
    while (handles.length > 2 * stretches) handles.pop().remove();
    while (handles.length < 2 * stretches) handles.push(plot.over.appendChild(this.#handle(plot, handles.length)));
    this.handles.set(plot, handles);
    return handles;
  }

  #handle(plot, at) {
    const handle = make("div", { className: "edge" });
    for (const name of ["mousedown", "click"]) handle.addEventListener(name, (event) => event.stopPropagation());
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("gotpointercapture", () => (handle.isDragged = true));
    handle.addEventListener("lostpointercapture", () => (handle.isDragged = false));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.isDragged) return;
      const { selection } = this.curves;
      const across = event.clientX - plot.over.getBoundingClientRect().left;
      const position = this.curves.clamped(Math.round(plot.posToVal(across, "x")));
      this.onChange(withEdge(selection, at >> 1, SIDES[at % 2], position), position);
    });
    return handle;
  }
}
