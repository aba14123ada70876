// The selected stretches on the page of a session: selecting by mouse, keys and the grid of pictures.

import { by } from "../dom.js";
import { showStatus } from "../live.js";
import { Edges } from "./edges.js";
import { Looking } from "./looking.js";
import * as selecting from "./selection.js";

const NONE = "select a stretch first: drag over the curves, or press j";

export class Selected {
  /** `onPick(position)`: a picture of the grid was clicked. */
  constructor(page, data, curves, filter, { onPick }) {
    Object.assign(this, { page, data, curves, filter, stretches: [], filled: " " });
    new Edges(curves, { onChange: (stretches) => this.select(stretches) });
    this.looking = new Looking(by("looking"), data, { onPick, onChange: (stretches) => this.select(stretches, true) });
    by("look-at").addEventListener("click", () => this.togglePictures());
  }

  /** Select stretches. The grid of pictures shows them, unless the user chose them there. */
  select(stretches, isByGrid = false) {
    const { data } = this;
    const selection = (this.stretches = selecting.merged(stretches));
    this.curves.mark({ selection });
    by("exclude").disabled = by("fine").disabled = by("tag").disabled = !selection.length || Boolean(data.state.problem);
    by("look-at").disabled = !selection.length || !data.state.cameras.length;
    by("selected").textContent = selecting.words(selection, data);
    this.fillTrim(selection);
    if (this.looking.isOpen && !isByGrid) this.showPictures(selection.length > 0);
  }

  /** Fill the form for a trimmed log. Without a selection, entered rows stay. */
  fillTrim(selection) {
    if (!by("make-trim")) return; // not of an unfinished log
    const { first, last } = by("make-trim").elements;
    if (!selection.length && `${first.value} ${last.value}` !== this.filled) return;
    const stretch = selection.length ? { first: selection[0].first, last: selection.at(-1).last } : { first: 0, last: this.data.length - 1 };
    [first.value, last.value] = this.data.length ? this.data.rowsOf(stretch) : ["", ""];
    this.filled = `${first.value} ${last.value}`;
    if (by("make").open) by("make-trim").dispatchEvent(new Event("show"));
  }

  /** A click selects the stretch there; with shift or control, it adds the stretch or removes it. */
  click(position, { shiftKey, ctrlKey, metaKey }) {
    const clicked = selecting.at([...this.filter.groups, ...this.data.tags], position);
    const selected = selecting.at(this.stretches, position);
    if (!shiftKey && !ctrlKey && !metaKey) this.select(clicked ? [clicked] : []);
    else if (selected) this.select(this.stretches.filter((stretch) => stretch !== selected));
    else if (clicked) this.select([...this.stretches, clicked]);
  }

  grow(seconds) {
    if (this.stretches.length) this.select(selecting.grown(this.stretches, this.data, seconds));
    else showStatus(NONE);
  }

  /** Begin (`edge` "first") or end the selection at the present moment. */
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

  take(change) {
    if (this.stretches.length) change(this.stretches);
    else showStatus(NONE);
  }

  /** Show the selected stretches as pictures, or the cameras again. */
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
