// The changes made on this page, to be undone and redone. The server has no record of them: undoing is one more change
// of the tags, as `bc-log tag --remove` would make it. The browser keeps them for as long as the tab is open.

const OPPOSITE = { add: "remove", remove: "add" };

export class History {
  constructor(data) {
    this.data = data;
    this.done = [];
    this.undone = [];
    this.commands = [];
  }

  /** Take up the changes made in this tab before it was reloaded; the data's log is known by now. */
  restore() {
    this.key = `changes 2 of ${this.data.address} ${this.data.state.fingerprint}`;
    const kept = JSON.parse(sessionStorage.getItem(this.key) ?? "{}");
    for (const name of ["done", "undone", "commands"]) this[name] = kept[name] ?? [];
  }

  keep() {
    const { done, undone, commands } = this;
    sessionStorage.setItem(this.key, JSON.stringify({ done, undone, commands }));
  }

  /** Make a change of all of these rows at once; the server's answer. */
  async make(action, name, rows) {
    const answer = await this.data.change(action, name, rows);
    if (answer.changed.length) {
      this.done.push({ action, name, rows: answer.changed });
      this.undone = [];
      this.commands.push(...answer.commands);
      this.keep();
    }
    return answer;
  }

  async undo() {
    return this.move(this.done, this.undone, (action) => OPPOSITE[action]);
  }

  async redo() {
    return this.move(this.undone, this.done, (action) => action);
  }

  async move(from, to, turned) {
    const change = from.at(-1);
    if (!change) return null;
    const answer = await this.data.change(turned(change.action), change.name, change.rows);
    if (!answer.changed.length && answer.notice) throw new Error(answer.notice);
    this.notice = answer.notice; // what of it could not be changed
    from.pop(); // not before it is done: an error leaves all as it was
    to.push(change);
    this.commands.push(...answer.commands);
    this.keep();
    return change;
  }
}
