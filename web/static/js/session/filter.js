// The odd stretches that are gone through: all, those of one kind, or instead of them the rows with a flag, or those
// for which a condition holds. A filter selects what it finds, so that it can be looked at and tagged at once.

import { button, by, number } from "../dom.js";
import { ask } from "./log_data.js";
import { grouped, left } from "./odd.js";

const SURE = "sure";

export class Filter {
  /** `onChange(isSelected)`: other stretches are listed; they are to be selected, or not. */
  constructor(data, { onChange, showStatus }) {
    Object.assign(this, { data, onChange, showStatus, kind: "", found: null, groups: [] });
    by("where-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.find(by("where").value);
      by("where").blur(); // the keys are the page's again
    });
    by("where-clear").addEventListener("click", () => this.use(""));
  }

  /** The log has other rows. */
  refresh() {
    if (this.found) this.found = null;
    this.groups = this.#groupsOf(this.kind);
  }

  /** List the stretches of a kind, or with "" all that are odd. */
  use(kind) {
    this.kind = kind;
    this.found = null;
    this.groups = this.#groupsOf(kind);
    this.onChange(Boolean(kind));
  }

  /** List the rows for which a condition holds. */
  async find(condition) {
    try {
      const answer = await ask(`${this.data.address}/where?condition=${encodeURIComponent(condition)}`);
      this.found = (await answer.json()).map(([first, last]) => ({ first, last, flags: new Set(), causes: [] }));
      this.kind = "";
      this.groups = this.found;
      this.condition = condition;
      this.onChange(true);
    } catch (error) {
      this.showStatus(error.message);
    }
  }

  /** Its stretches that nobody has dealt with yet. */
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

  /** The buttons of the kinds, each with the number of what is left of it. */
  show() {
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
    by("odd-title").textContent = this.found ? `Rows where ${this.condition}` : "Odd stretches";
    by("where-clear").hidden = !this.found;
    const query = this.found ? { where: this.condition } : { only: `with ${named(this.kind)}` };
    by("everywhere").hidden = !this.found && (!this.kind || this.kind.endsWith("_picture")); // those, a list cannot know
    by("everywhere").href = `/sessions?${new URLSearchParams(query)}`;
  }
}

function named(kind) {
  return kind === SURE ? "surely odd rows" : kind.replaceAll("_", " ");
}
