// What the page changes of the tags: names for stretches, each a change that is undone as one, and the commands that
// do the same.

import { History } from "./history.js";
import { counted } from "./selection.js";

const by = (id) => document.getElementById(id);

export class Tagging {
  /** `selected()`: the stretches that are selected. */
  constructor(data, { selected, showStatus }) {
    Object.assign(this, { data, selected, showStatus, done: new History(data), queue: Promise.resolve() });
    by("undo").addEventListener("click", () => this.undo());
    by("redo").addEventListener("click", () => this.redo());
    by("name-form").addEventListener("submit", (event) => {
      event.preventDefault();
      const name = by("name").value.trim();
      if (name) this.tag(name);
      by("name").blur();
    });
    by("name").addEventListener("focus", () => this.offerNames());
    by("copy").addEventListener("click", () => this.copy());
  }

  /** Take up what was done in this tab before; the data's log is known by now. */
  restore() {
    if (this.done.key) return;
    this.done.restore();
    this.show();
  }

  /** One after the other, so that they are written in the order of the user's actions. */
  inOrder(make) {
    this.queue = this.queue.then(async () => {
      try {
        await make();
      } catch (error) {
        this.showStatus(error.message);
      }
      this.show();
    });
  }

  /** Tag what is selected now, whatever is selected when its turn comes. */
  tag(name) {
    const stretches = this.selected();
    if (stretches.length) this.inOrder(() => this.make(name, stretches));
    else this.showStatus("select a stretch first: drag over the curves, or press j");
  }

  /** Tag stretches, as one change. */
  async make(name, stretches) {
    if (this.data.state.problem) throw new Error(this.data.state.problem);
    if (!stretches.length) throw new Error("nothing is left of it");
    const rows = stretches.map((stretch) => this.data.rowsOf(stretch));
    const answer = await this.done.make("add", name, rows);
    const what = `${name}: ${said(rows)}`;
    this.showStatus(answer.notice || (answer.changed.length ? what : `${what}, as before`));
  }

  remove(name, rows) {
    this.inOrder(() => this.done.make("remove", name, [rows]));
  }

  undo() {
    this.inOrder(async () => this.say("undone", await this.done.undo()));
  }

  redo() {
    this.inOrder(async () => this.say("again", await this.done.redo()));
  }

  say(how, change) {
    this.showStatus(change ? `${how}: ${change.action} ${change.name}, ${said(change.rows)}` : `nothing is left to ${how === "again" ? "redo" : "undo"}`);
  }

  show() {
    by("commands").textContent = this.done.commands.join("\n");
    by("copy").hidden = !this.done.commands.length;
    by("undo").disabled = !this.done.done.length;
    by("redo").disabled = !this.done.undone.length;
  }

  async offerNames() {
    const answer = await fetch(`${this.data.address}/names`);
    if (!answer.ok) return;
    const names = await answer.json();
    by("names").replaceChildren(...names.map((name) => Object.assign(document.createElement("option"), { value: name })));
  }

  async copy() {
    try {
      await navigator.clipboard.writeText(`${this.done.commands.join("\n")}\n`);
      this.showStatus("copied");
    } catch {
      getSelection().selectAllChildren(by("commands")); // no clipboard where the connection is not encrypted
      this.showStatus("selected: copy it with ctrl c");
    }
  }
}

function said(rows) {
  return rows.length === 1 ? `rows ${rows[0].join(" to ")}` : counted(rows.map(([first, last]) => ({ first, last })));
}
