// A map: asked for, waited for, and its columns; the tags of its logs, and the rows that a choice of points stands for.

import { ask, awaited, columnsOf } from "../session/log_data.js";
import { changeTags } from "../tag_changes.js";

const COLUMNS = ["x", "y", "log", "row", "steering", "predicted", "nearest", "alone", "group", "odd"]; // web/processes/picture_maps.py

export class PictureMap {
  /** `of`: the logs as the address has them; `onChange()`: further, or there. */
  constructor(of, { onChange }) {
    Object.assign(this, { of, onChange });
    this.clear("");
  }

  clear(run) {
    Object.assign(this, { run, about: null, logs: [], columns: {}, length: 0, problem: "", progress: null, key: "" });
  }

  get query() {
    return new URLSearchParams([...this.of.map((each) => ["of", each]), ["run", this.run]]);
  }

  get isWaiting() {
    return !this.about && !this.problem;
  }

  async make(run) {
    this.clear(run);
    this.onChange();
    try {
      const isWanted = () => this.run === run && !this.problem; // no other one was asked for, and it was not stopped
      const found = await awaited(`/map.state?${this.query}`, {
        isWanted,
        onProgress: (progress) => {
          Object.assign(this, { key: progress.key, progress });
          this.onChange();
        },
      });
      if (!isWanted()) return;
      const values = new Float32Array(await (await ask(`/map.points?key=${found.key}`)).arrayBuffer());
      if (this.run !== run) return;
      this.columns = columnsOf(values, COLUMNS);
      Object.assign(this, { about: found.about, key: found.key, logs: found.logs, length: this.columns.row.length });
      this.arrange();
    } catch (error) {
      if (this.run !== run) return;
      this.problem = error.message;
    }
    this.onChange();
  }

  async stop() {
    this.problem = "stopped";
    this.onChange();
    await ask(`/map.stop?key=${this.key}`, { method: "POST" });
  }

  /** The tags as they are now. */
  async loadTags() {
    this.logs = (await (await ask(`/map.state?${this.query}`)).json()).logs;
  }

  /** `after`: the next point of the same log (-1: none), by rows. */
  arrange() {
    const { log, row } = this.columns;
    this.order = Array.from({ length: this.length }, (_, at) => at).sort((a, b) => log[a] - log[b] || row[a] - row[b]);
    this.after = new Int32Array(this.length).fill(-1);
    this.order.forEach((at, place) => {
      const next = this.order[place + 1];
      if (next !== undefined && log[next] === log[at]) this.after[at] = next;
    });
  }

  logOf(at) {
    return this.logs[this.columns.log[at]];
  }

  /** The rows that a point stands for: its own, and those after it of which no picture is shown. */
  rowsOf(at) {
    const row = this.columns.row[at];
    if (this.about.step === 1) return [row, row];
    const next = this.after[at];
    return [row, next < 0 ? row : this.columns.row[next] - 1];
  }

  /** Name the rows of logs, or take the name from them: one log after the other, where one cannot be changed, the
   * others are. */
  async change(action, name, logs) {
    const done = { changed: [], commands: [], notice: "" };
    const problems = [];
    for (const { at, log, rows } of logs) {
      try {
        const { changed, commands } = await changeTags(`${at}/tags`, { action, name, rows, log });
        if (changed.length) done.changed.push({ at, log, rows: changed });
        done.commands.push(...commands);
      } catch (error) {
        problems.push(error.message);
      }
    }
    if (problems.length === logs.length) throw new Error(problems.join("; "));
    return { ...done, notice: problems.join("; ") };
  }

  /** Points by session and row. */
  inOrder(points) {
    const { log, row } = this.columns;
    return [...points].sort((a, b) => log[a] - log[b] || row[a] - row[b]);
  }

  /** The rows of points: [{at, log, rows: [[first, last], ...]}, ...], neighbours as one stretch. */
  stretches(points) {
    const found = new Map();
    let before = -1;
    for (const at of this.inOrder(points)) {
      const log = this.logOf(at);
      if (!found.has(log)) found.set(log, []);
      const rows = found.get(log);
      const [first, last] = this.rowsOf(at);
      if (before >= 0 && this.after[before] === at) rows.at(-1)[1] = last;
      else rows.push([first, last]);
      before = at;
    }
    return [...found].map(([log, rows]) => ({ at: log.at, log: log.fingerprint, rows }));
  }

  tagsOf(at) {
    const row = this.columns.row[at];
    return this.logOf(at).tags.filter(([first, last]) => first <= row && row <= last).map(([, , name]) => name);
  }

  picture(at) {
    const log = this.logOf(at);
    return `${log.at}/pictures/center/${this.columns.row[at]}?v=${log.version}`;
  }

  /** The page of the log at this row. */
  page(at) {
    const run = this.run === "pixels" ? "" : `&run=${this.run}`;
    return `${this.logOf(at).at}#row=${this.columns.row[at]}${run}`;
  }

  /** The points that lie nearest to one, itself first. */
  like(at, count) {
    const { x, y } = this.columns;
    const apart = (other) => (x[other] - x[at]) ** 2 + (y[other] - y[at]) ** 2;
    return [...this.order].sort((a, b) => apart(a) - apart(b)).slice(0, count);
  }
}
