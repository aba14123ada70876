// Many stretches at once: all that are surely odd, and the rows for which a condition holds.

import { listStretches } from "./lists.js";
import { ask } from "./log_data.js";
import { left, sure } from "./odd.js";

const EXCLUDE = "exclude";
const by = (id) => document.getElementById(id);

export class Many {
  /** `change` makes changes in their order; `onPick` shows a stretch. */
  constructor(data, done, { change, onPick, showStatus }) {
    Object.assign(this, { data, done, change, onPick, showStatus, found: [] });
    by("exclude-odd").addEventListener("click", () => this.exclude(() => left(sure(data.state.odd), data.tags)));
    by("exclude-where").addEventListener("click", () => this.exclude(() => left(this.found, data.tags, [EXCLUDE])));
    by("where-form").addEventListener("submit", (event) => {
      event.preventDefault();
      this.find(by("where").value);
    });
  }

  /** Exclude each of the stretches: every one is a tag, which is undone like any. */
  exclude(chosen) {
    this.change(async () => {
      const stretches = chosen();
      for (const stretch of stretches) await this.done.make("add", EXCLUDE, this.data.rowsOf(stretch));
      this.showStatus(`${EXCLUDE}: ${stretches.length} stretches`);
    });
  }

  /** List the rows for which a condition holds; nothing is tagged yet. */
  async find(condition) {
    try {
      const answer = await ask(`${this.data.address}/where?condition=${encodeURIComponent(condition)}`);
      this.found = (await answer.json()).map(([first, last]) => ({ first, last }));
      const rows = this.found.reduce((sum, { first, last }) => sum + last - first + 1, 0);
      this.showStatus(`${rows.toLocaleString("en")} rows in ${this.found.length.toLocaleString("en")} stretches`);
    } catch (error) {
      this.found = [];
      this.showStatus(error.message);
    }
    listStretches(by("where-found"), this.found, this.data, this.onPick);
    this.show();
  }

  /** The buttons, by what is left to exclude. */
  show() {
    const { state, tags } = this.data;
    by("exclude-odd").disabled = Boolean(state.problem) || !left(sure(state.odd), tags).length;
    by("exclude-where").disabled = Boolean(state.problem) || !left(this.found, tags, [EXCLUDE]).length;
  }
}
