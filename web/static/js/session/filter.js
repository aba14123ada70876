// The listed stretches: all odd stretches, those of one kind, the rows with a flag, or the rows that meet a condition.
// A filter selects its stretches, so that the user can look at them and tag them at once.

import { button, by, number } from "../dom.js";
import { ask } from "./log_data.js";
import { grouped, left } from "./odd.js";

const SURE = "sure";

export class Filter {
  /** `onChange(isSelected)`: other stretches are listed, and selected or not. */
  constructor(data, { onChange, showStatus }) {
    Object.assign(this, { data, onChange, showStatus, kind: "", condition: null, groups: [] });
    by("where-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.find(by("where").value);
      by("where").blur(); // keys are for the page again
    });
    by("where-clear").addEventListener("click", () => this.use(""));
  }

  refresh() {
    this.#list(this.kind);
  }

  /** List the stretches of a kind, or with "" all odd stretches. */
  use(kind) {
    this.#list(kind);
    this.onChange(Boolean(kind));
  }

  #list(kind) {
    Object.assign(this, { kind, condition: null, groups: this.#groupsOf(kind) });
  }

  async find(condition) {
    try {
      const answer = await ask(`${this.data.address}/where?condition=${encodeURIComponent(condition)}`);
      const groups = (await answer.json()).map(([first, last]) => ({ first, last, flags: new Set(), causes: [] }));
      Object.assign(this, { kind: "", condition, groups });
      this.onChange(true);
    } catch (error) {
      this.showStatus(error.message);
    }
  }

  /** Its stretches that are neither excluded nor fine. */
  get toDo() {
    return left(this.groups, this.data.tags);
  }

  get sure() {
    return left(this.#groupsOf(SURE), this.data.tags);
  }

  #groupsOf(kind) {
    const { odd, flags } = this.data.state;
    if (flags[kind]) return flags[kind].map(([first, last]) => ({ first, last, flags: new Set([kind]), causes: [] }));
    return grouped(odd.filter(([flag, , , , isSure]) => !kind || (kind === SURE ? isSure : flag === kind)));
  }

  /** Show the buttons of the kinds, with the numbers of stretches that are neither excluded nor fine. */
  show() {
    const isWhere = this.condition !== null;
    const { odd, flags } = this.data.state;
    const kinds = [...[...new Set(odd.map(([flag]) => flag))].sort(), ...Object.keys(flags)];
    if (odd.some((stretch) => stretch[4])) kinds.unshift(SURE);
    const chips = kinds.map((kind) => {
      const count = number(left(this.#groupsOf(kind), this.data.tags).length);
      const title = `${count} stretches that are neither excluded nor fine`;
      const chip = button(`${named(kind)} ${count}`, () => this.use(kind === this.kind ? "" : kind), { title, ariaPressed: kind === this.kind });
      chip.dataset.kind = kind;
      return chip;
    });
    const focused = document.activeElement?.dataset.kind;
    by("kinds").replaceChildren(...chips);
    if (focused) chips.find((chip) => chip.dataset.kind === focused)?.focus();
    by("odd-title").textContent = isWhere ? `Rows where ${this.condition}` : "Odd stretches";
    by("where-clear").hidden = !isWhere;
    const query = isWhere ? { where: this.condition } : { only: `with ${named(this.kind)}` };
    by("everywhere").hidden = !isWhere && (!this.kind || this.kind.endsWith("_picture")); // the list lacks those kinds
    by("everywhere").href = `/sessions?${new URLSearchParams(query)}`;
  }
}

function named(kind) {
  return kind === SURE ? "surely odd rows" : kind.replaceAll("_", " ");
}
