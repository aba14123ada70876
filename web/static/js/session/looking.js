// The selected stretches as a grid of pictures, in place of the cameras.

import { clock } from "../dom.js";
import { fillGrid, spread } from "../grid.js";
import { at } from "./selection.js";
import { words } from "./odd.js";

export class Looking {
  /** `onPick(position)`: a picture was clicked. `onChange(stretches)`: these stretches are ticked. */
  constructor(element, data, { onPick, onChange }) {
    Object.assign(this, { element, data, onPick, onChange, isOpen: false });
  }

  open(stretches, groups) {
    this.isOpen = true;
    this.stretches = stretches;
    this.element.hidden = false;
    const shown = stretches.map((stretch) => {
      const { first, last } = stretch;
      const rows = this.data.rowsOf(stretch);
      const group = at(groups, first);
      const kind = group?.flags.size ? `${words(group)}, ` : "";
      const title = `${kind}rows ${rows[0]} to ${rows[1]}, at ${clock(this.data.columns.driven_s[first])}`;
      return { title, pictures: spread(first, last, stretches.length).map((position) => this.picture(position)) };
    });
    fillGrid(this.element.querySelector("ol"), shown, (ticked) => this.onChange(stretches.filter((_, number) => ticked[number] ?? true)));
  }

  close() {
    this.isOpen = false;
    this.element.hidden = true;
    this.element.querySelector("ol").replaceChildren();
  }

  picture(position) {
    const { cameras, version } = this.data.state;
    const camera = cameras.includes("center") ? "center" : cameras[0];
    const row = this.data.columns.row[position];
    return {
      address: `${this.data.address}/pictures/${camera}/${row}?v=${version}`,
      title: `row ${row}`,
      pick: () => this.onPick(position),
    };
  }
}
