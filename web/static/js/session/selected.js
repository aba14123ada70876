// What is selected on the page of a session, and how: by drags, clicks, keys and the grid of its pictures.

import { by } from "../dom.js";
import { showStatus } from "../live.js";
import { Edges } from "./edges.js";
import { Looking } from "./looking.js";
import * as selecting from "./selection.js";

const NONE = "select a stretch first: drag over the curves, or press j";

export class Selected {
  /** `onPick(position)`: a picture of the grid was clicked. */
  constructor(page, data, curves, filter, { onPick }) {
    Object.assign(this, { page, data, curves, filter, stretches: [] });
    new Edges(curves, { onChange: (stretches) => this.select(stretches) });
    this.looking = new Looking(by("looking"), data, { onPick, onChange: (stretches) => this.select(stretches, true) });
    by("look-at").addEventListener("click", () => this.togglePictures());
  }

  /** Select stretches; the grid of pictures shows them, too, unless it is where they were chosen. */
  select(stretches, isByGrid = false) {
    const { data } = this;
    const selection = (this.stretches = selecting.merged(stretches));
    this.curves.mark({ selection });
    by("exclude").disabled = by("fine").disabled = by("tag").disabled = !selection.length || Boolean(data.state.problem);
    by("look-at").disabled = !selection.length || !data.state.cameras.length;
    by("selected").textContent = selecting.words(selection, data);
    this.fillTrim(selection.length ? { first: selection[0].first, last: selection.at(-1).last } : { first: 0, last: data.length - 1 });
    if (this.looking.isOpen && !isByGrid) this.showPictures(selection.length > 0);
  }

  /** Trimming keeps the selected rows. Of a log in a store, nothing is made. */
  fillTrim(stretch) {
    if (!by("make-trim")) return;
    const { elements } = by("make-trim");
    [elements.first.value, elements.last.value] = this.data.length ? this.data.rowsOf(stretch) : ["", ""];
    if (by("make").open) by("make-trim").dispatchEvent(new Event("show"));
  }

  /** A click selects the stretch that is there as a whole; with shift, or control, next to what is selected. */
  click(position, { shiftKey, ctrlKey, metaKey }) {
    const found = selecting.at([...this.filter.groups, ...this.data.tags], position);
    const chosen = selecting.at(this.stretches, position);
    if (!shiftKey && !ctrlKey && !metaKey) this.select(found ? [found] : []);
    else if (chosen) this.select(this.stretches.filter((each) => each !== chosen));
    else if (found) this.select([...this.stretches, found]);
  }

  grow(seconds) {
    if (this.stretches.length) this.select(selecting.grown(this.stretches, this.data, seconds));
    else showStatus(NONE);
  }

  /** It begins, or ends, at the moment that is shown. */
  begin(edge) {
    if (!this.data.length) return;
    const at = this.curves.position;
    if (edge === "first") this.select([{ first: at, last: Math.max(at, this.stretches.at(-1)?.last ?? at) }]);
    else this.select([{ first: Math.min(at, this.stretches[0]?.first ?? at), last: at }]);
  }

  clear() {
    if (this.looking.isOpen) this.showPictures(false);
    else this.select([]);
  }

  /** Call `change` with the stretches of now, whatever is selected when its turn comes. */
  take(change) {
    if (this.stretches.length) change(this.stretches);
    else showStatus(NONE);
  }

  /** The selected stretches as pictures, instead of the cameras at one moment. */
  showPictures(isShown) {
    if (isShown) this.looking.open(this.stretches, this.filter.groups);
    else this.looking.close();
    this.page.classList.toggle("in-grid", this.looking.isOpen);
    by("look-at").setAttribute("aria-pressed", this.looking.isOpen);
  }

  togglePictures() {
    if (this.looking.isOpen || this.stretches.length) this.showPictures(!this.looking.isOpen);
    else showStatus("select stretches first: drag over the curves, press j, or choose a kind");
  }
}
