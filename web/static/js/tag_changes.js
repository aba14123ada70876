// The changes of tags that a page makes, and the commands that do the same. One undo reverts one change. The server
// keeps no history: an undo is another change. The browser keeps the changes until the tab is closed.

import { by } from "./dom.js";
import { showStatus } from "./live.js";
import { ask } from "./session/log_data.js";

const OPPOSITE = { add: "remove", remove: "add" };
export const EXCLUDE = "exclude";
export const FINE = "fine";

export async function changeTags(address, change) {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(change) };
  return (await ask(address, options)).json();
}

export class TagChanges {
  /** `change(action, name, rows)` asks the server. `tag(name)`: the user has chosen a name for the selection.
   * `describe(rows)` returns words for rows. `onChange()`: tags have changed. */
  constructor({ change, tag, describe, onChange = () => {} }) {
    Object.assign(this, { change, tag, describe, onChange, done: [], undone: [], commands: [], queue: Promise.resolve() });
    const calls = { [EXCLUDE]: () => tag(EXCLUDE), [FINE]: () => tag(FINE), undo: () => this.undo(), redo: () => this.redo() };
    for (const [id, call] of Object.entries(calls)) by(id).addEventListener("click", call);
    by("name").form.addEventListener("submit", (event) => {
      event.preventDefault();
      const name = by("name").value.trim();
      if (name) tag(name);
      by("name").blur();
    });
    this.keys = { x: calls[EXCLUDE], f: calls[FINE], t: () => by("name").focus() };
    Object.assign(this.keys, { u: calls.undo, undo: calls.undo, r: calls.redo, redo: calls.redo });
  }

  /** Restore the changes that this tab made to `subject` before it was reloaded. */
  restore(subject) {
    if (this.key) return;
    this.key = `changes 2 of ${subject}`;
    Object.assign(this, JSON.parse(sessionStorage.getItem(this.key) ?? "{}"));
    this.show();
  }

  /** Make changes one after the other, in the order of the user's actions. */
  inOrder(make) {
    this.queue = this.queue.then(make).catch((error) => showStatus(error.message)).then(() => this.show());
  }

  /** Change all of these rows at once. Return what the server has changed. */
  async make(action, name, rows) {
    const answer = await this.change(action, name, rows);
    if (answer.changed.length) {
      this.done.push({ action, name, rows: answer.changed });
      this.undone = [];
      await this.keep(answer);
    }
    return answer;
  }

  undo() {
    this.inOrder(() => this.move("undo", this.done, this.undone));
  }

  redo() {
    this.inOrder(() => this.move("redo", this.undone, this.done));
  }

  async move(word, from, to) {
    const change = from.at(-1);
    if (!change) return showStatus(`nothing to ${word}`);
    const action = word === "undo" ? OPPOSITE[change.action] : change.action;
    const answer = await this.change(action, change.name, change.rows);
    if (!answer.changed.length && answer.notice) throw new Error(answer.notice);
    from.pop(); // after the change: an error leaves everything as it was
    to.push(change);
    await this.keep(answer);
    const done = `${word === "undo" ? "undone" : "again"}: ${change.action} ${change.name}, ${this.describe(change.rows)}`;
    showStatus([done, answer.notice].filter(Boolean).join("; "));
  }

  async keep({ commands: more }) {
    this.commands.push(...more);
    const { done, undone, commands } = this;
    sessionStorage.setItem(this.key, JSON.stringify({ done, undone, commands }));
    await this.onChange();
  }

  show() {
    by("undo").disabled = !this.done.length;
    by("redo").disabled = !this.undone.length;
    if (!by("commands")) return;
    by("commands").textContent = this.commands.join("\n");
    if (by("copy")) by("copy").hidden = !this.commands.length;
  }
}
