// The changes of tags that a page makes: a name for rows, or taken from them, each undone as one, and the commands that
// do the same. The server has no record of them: undoing is one more change, as `bc-log tag --remove` would make it.
// The browser keeps them for as long as the tab is open.

import { by } from "./dom.js";
import { showStatus } from "./live.js";
import { ask } from "./session/log_data.js";

const OPPOSITE = { add: "remove", remove: "add" };
export const EXCLUDE = "exclude";
export const FINE = "fine";

/** Ask the server for a change of tags; what it has done. */
export async function changeTags(address, change) {
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(change) };
  return (await ask(address, options)).json();
}

export class TagChanges {
  /** `change(action, name, rows)` asks the server; `tag(name)`: a name was chosen for what is selected; `said(rows)`
   * has the words for rows; `onChange()`: the tags are other ones. */
  constructor({ change, tag, said, onChange = () => {} }) {
    Object.assign(this, { change, tag, said, onChange, done: [], undone: [], commands: [], queue: Promise.resolve() });
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

  /** Take up the changes made in this tab before it was reloaded. */
  restore(of) {
    if (this.key) return;
    this.key = `changes 2 of ${of}`;
    Object.assign(this, JSON.parse(sessionStorage.getItem(this.key) ?? "{}"));
    this.show();
  }

  /** One after the other, so that they are written in the order of the user's actions. */
  inOrder(make) {
    this.queue = this.queue.then(make).catch((error) => showStatus(error.message)).then(() => this.show());
  }

  /** Change all of these rows at once; what the server has done. */
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
    if (!change) return showStatus(`nothing is left to ${word}`);
    const action = word === "undo" ? OPPOSITE[change.action] : change.action;
    const answer = await this.change(action, change.name, change.rows);
    if (!answer.changed.length && answer.notice) throw new Error(answer.notice);
    from.pop(); // not before it is done: an error leaves all as it was
    to.push(change);
    await this.keep(answer);
    const what = `${word === "undo" ? "undone" : "again"}: ${change.action} ${change.name}, ${this.said(change.rows)}`;
    showStatus([what, answer.notice].filter(Boolean).join("; "));
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
