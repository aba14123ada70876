// Changes of the tags of several logs, each undone and redone as one. The browser keeps them while the tab is open.

import { ask } from "../session/log_data.js";

const KEPT = "changes of the map";

export class TagChanges {
  constructor() {
    Object.assign(this, { done: [], undone: [], commands: [] }, JSON.parse(sessionStorage.getItem(KEPT) ?? "{}"));
  }

  keep() {
    const { done, undone, commands } = this;
    sessionStorage.setItem(KEPT, JSON.stringify({ done, undone, commands }));
  }

  /** Name the rows of logs; what could be changed, as one that is undone. */
  async make(name, logs) {
    const change = { name, ...(await this.send("add", name, logs)) };
    if (change.logs.length) {
      this.done.push({ name, logs: change.logs });
      this.undone = [];
      this.keep();
    }
    return change;
  }

  undo() {
    return this.turn(this.done, this.undone, "remove");
  }

  redo() {
    return this.turn(this.undone, this.done, "add");
  }

  async turn(from, to, action) {
    const change = from.at(-1);
    if (!change) return null;
    const { problems } = await this.send(action, change.name, change.logs);
    if (problems.length === change.logs.length) throw new Error(problems.join("; "));
    from.pop();
    to.push(change);
    this.keep();
    return { ...change, problems };
  }

  /** One log after the other: where one cannot be changed, the others are. */
  async send(action, name, logs) {
    const found = { logs: [], problems: [] };
    for (const { at, log, rows } of logs) {
      try {
        const answer = await ask(`${at}/tags`, {
          method: "POST",
          headers: { "Content-Type": "application/json" },
          body: JSON.stringify({ action, name, rows, log }),
        });
        const { changed, commands } = await answer.json();
        if (changed.length) found.logs.push({ at, log, rows: changed });
        this.commands.push(...commands);
      } catch (error) {
        found.problems.push(error.message);
      }
    }
    return found;
  }
}

