// Handles at the edges of what is selected, to be dragged.

import { make } from "../dom.js";
import { withEdge } from "./selection.js";

const MOST = 40; // stretches; of more, an edge is a matter of keys
const MIN_WIDTH = 16; // pixels of a stretch whose edges can be told apart
const SIDES = ["first", "last"];

export class Edges {
  /** `onChange(stretches)`: an edge is dragged. */
  constructor(curves, { onChange }) {
    Object.assign(this, { curves, onChange, handles: new Map() });
    curves.watch(() => this.place());
  }

  /** Put them where the edges are now; those that are dragged stay the same elements. */
  place() {
    const { plots, selection } = this.curves;
    for (const plot of plots) {
      const handles = this.#handlesOf(plot, selection.length <= MOST ? selection.length : 0);
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
    if (!this.handles.has(plot)) this.handles = new Map(this.curves.plots.map((each) => [each, this.handles.get(each) ?? []]));
    while (handles.length > 2 * stretches) handles.pop().remove();
    while (handles.length < 2 * stretches) handles.push(plot.over.appendChild(this.#handle(plot, handles.length)));
    this.handles.set(plot, handles);
    return handles;
  }

  #handle(plot, at) {
    const handle = make("div", { className: "edge" });
    for (const event of ["mousedown", "click"]) handle.addEventListener(event, (each) => each.stopPropagation()); // the plot's
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
