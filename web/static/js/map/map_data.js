// The data of a map: its columns, the tags of its logs, and the rows of its points.

import { ask, awaited, columnsOf } from "../session/log_data.js";
import { changeTags } from "../tag_changes.js";

const COLUMNS = ["x", "y", "log", "row", "steering", "predicted", "nearest", "alone", "group", "odd"]; // web/processes/picture_maps.py

export class PictureMap {
  /** `addresses`: the logs, as in the page's address; none for the index. `onChange()`: progress, or the result. */
  constructor(addresses, { onChange }) {
    Object.assign(this, { addresses, onChange });
    this.clear("");
  }

  clear(run) {
    Object.assign(this, { run, about: null, logs: [], columns: {}, length: 0, problem: "", progress: null, key: "" });
  }

  get query() {
    return new URLSearchParams([...this.addresses.map((address) => ["of", address]), ["run", this.run]]);
  }

  get isWaiting() {
    return !this.about && !this.problem;
  }

  async make(run) {
    this.clear(run);
    const making = (this.making = {});
    const isWanted = () => this.making === making; // else another one was begun, or it was stopped
    this.onChange();
    try {
      const state = await awaited(`/map.state?${this.query}`, {
        isWanted,
        onProgress: (progress) => {
          Object.assign(this, { key: progress.key, progress });
          this.onChange();
        },
      });
      if (!isWanted()) return;
      const values = new Float32Array(await (await ask(`/map.points?key=${state.key}`)).arrayBuffer());
      if (!isWanted()) return;
      this.columns = columnsOf(values, COLUMNS);
      Object.assign(this, { about: state.about, key: state.key, logs: state.logs, length: this.columns.row.length });
      this.arrange();
    } catch (error) {
      if (!isWanted()) return;
      this.problem = error.message;
    }
    this.onChange();
  }

  async stop() {
    this.making = null;
    this.problem = "stopped";
    this.onChange();
    await ask(`/map.stop?key=${this.key}`, { method: "POST" });
  }

  async loadTags() {
    this.logs = (await (await ask(`/map.state?${this.query}`)).json()).logs;
  }

  /** Find `order`, the points by log and row, and `after`, the next point of the same log (-1: none). */
  arrange() {
    const { log } = this.columns;
    this.order = this.inOrder(Array.from({ length: this.length }, (_, at) => at));
    this.after = new Int32Array(this.length).fill(-1);
    this.order.forEach((at, place) => {
      const next = this.order[place + 1];
      if (next !== undefined && log[next] === log[at]) this.after[at] = next;
    });
  }

  logOf(at) {
    return this.logs[this.columns.log[at]];
  }

  /** The rows of a point: its own, and the rows after it whose pictures are not shown. */
  rowsOf(at) {
    const row = this.columns.row[at];
    if (this.about.step === 1) return [row, row];
    const next = this.after[at];
    return [row, next < 0 ? row : this.columns.row[next] - 1];
  }

  /** Add a name to rows of logs, or remove it. If one log fails, the others are changed. */
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

  inOrder(points) {
    const { log, row } = this.columns;
    return [...points].sort((a, b) => log[a] - log[b] || row[a] - row[b]);
  }

  /** The rows of points: [{at, log, rows: [[first, last], ...]}, ...]. Neighbours are one stretch. */
  stretches(points) {
    const rowsByLog = new Map();
    let before = -1;
    for (const at of this.inOrder(points)) {
      const log = this.logOf(at);
      if (!rowsByLog.has(log)) rowsByLog.set(log, []);
      const rows = rowsByLog.get(log);
      const [first, last] = this.rowsOf(at);
      if (before >= 0 && this.after[before] === at) rows.at(-1)[1] = last;
      else rows.push([first, last]);
      before = at;
    }
    return [...rowsByLog].map(([log, rows]) => ({ at: log.at, log: log.fingerprint, rows }));
  }

  tagsOf(at) {
    const row = this.columns.row[at];
    return this.logOf(at).tags.filter(([first, last]) => first <= row && row <= last).map(([, , name]) => name);
  }

  picture(at) {
    const log = this.logOf(at);
    return `${log.at}/pictures/center/${this.columns.row[at]}?v=${log.version}`;
  }

  page(at) {
    const run = this.run === "pixels" ? "" : `&run=${this.run}`;
    return `${this.logOf(at).at}#row=${this.columns.row[at]}${run}`;
  }

  /** The points nearest to a point, itself first. */
  nearest(at, count) {
    const { x, y } = this.columns;
    const apart = (other) => (x[other] - x[at]) ** 2 + (y[other] - y[at]) ** 2;
    return [...this.order].sort((a, b) => apart(a) - apart(b)).slice(0, count);
  }
}
