// The data of a log, loaded again when the files change.

import { reasonIn } from "../dom.js";
import { NO_ANSWER } from "../live.js";

const GAP_S = 1; // as in recorder/rows/row_quality.py: after a longer pause, or where time goes back, a drive begins
const POLL_MS = 2000;
const WORK_POLL_MS = 400;
const LOAD_SHARE = 5; // loading, which reads all of a growing log, may take a sixth of the time

class Refused extends Error {}

export async function ask(path, options) {
  const answer = await fetch(path, options).catch(() => {
    throw new Error(NO_ANSWER);
  });
  if (answer.ok) return answer;
  throw new Refused(reasonIn(await answer.text(), answer.status));
}

/** Columns that lie one after the other. */
export function columnsOf(values, names) {
  const length = values.length / names.length;
  return Object.fromEntries(names.map((name, at) => [name, values.subarray(at * length, (at + 1) * length)]));
}

/** Start work of the server, and wait until it is done or no longer wanted. Return its state. */
export async function awaited(address, { isWanted, onProgress }) {
  let state = await (await ask(address, { method: "POST" })).json();
  while (isWanted() && !state.about && !state.problem) {
    onProgress(state);
    await new Promise((resolve) => setTimeout(resolve, WORK_POLL_MS));
    state = await (await ask(address)).json();
  }
  if (isWanted() && state.problem) throw new Error(state.problem);
  return state;
}

export class LogData extends EventTarget {
  /** Events: `rows`, `tags` and `lag` (of the steering) when these have changed, `problem` with its text as detail
   * ("": solved). */
  constructor(address) {
    super();
    this.address = address;
    this.state = null;
    this.columns = {};
    this.breaks = [];
    this.length = 0;
    this.tags = [];
    this.tagsVersion = null; // of the file that was read
    this.pollProblem = ""; // that the last poll has found
    this.busyUntil = 0;
    this.tagRequests = 0;
  }

  async load() {
    const began = performance.now();
    const [state, rows] = await Promise.all([
      ask(`${this.address}/state`).then((answer) => answer.json()),
      ask(`${this.address}/rows`).then((answer) => answer.arrayBuffer()),
    ]);
    this.columns = columnsOf(new Float64Array(rows), state.columns);
    this.length = this.columns.row.length;
    this.countDriven();
    this.state = state;
    this.busyUntil = performance.now() + LOAD_SHARE * (performance.now() - began);
    this.dispatchEvent(new Event("rows"));
    await this.loadTags();
  }

  /** Find `driven_s`, the time driven until each row, and `breaks`, the rows that begin another drive. */
  countDriven() {
    const { time_s } = this.columns;
    const driven = (this.columns.driven_s = new Float64Array(this.length));
    this.breaks = [];
    for (let at = 1; at < this.length; at += 1) {
      const step = time_s[at] - time_s[at - 1];
      const isBreak = !(step >= 0 && step <= GAP_S);
      if (isBreak) this.breaks.push(at);
      driven[at] = driven[at - 1] + (isBreak ? 0 : step);
    }
  }

  async loadTags() {
    const request = (this.tagRequests += 1);
    try {
      const { version, names, tags, stale } = await (await ask(`${this.address}/tags`)).json();
      if (request < this.tagRequests) return; // a later request has, or will have, the newer answer
      this.tagsVersion = version;
      this.tags = tags.map(([first, last, name]) => ({
        first: this.position(first, false),
        last: this.position(last, true),
        rows: [first, last],
        name: names[name],
      }));
      this.report(stale ? `${stale} tags belong to an earlier log with this name, and do not count` : "");
    } catch (error) {
      if (!(error instanceof Refused)) throw error;
      this.tags = [];
      this.report(error.message);
    }
    this.dispatchEvent(new Event("tags"));
  }

  report(problem) {
    this.dispatchEvent(new CustomEvent("problem", { detail: problem || this.state?.problem || "" }));
  }

  /** The position of the first row that is not before `row`; with `isLast`, of the last row that is not after it. */
  position(row, isLast) {
    const rows = this.columns.row;
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (isLast ? rows[middle] <= row : rows[middle] < row) low = middle + 1;
      else high = middle;
    }
    return isLast ? low - 1 : low;
  }

  rowsOf({ first, last }) {
    const rows = this.columns.row;
    return [Math.min(rows[first], rows[last]), Math.max(rows[first], rows[last])];
  }

  follow() {
    setInterval(() => this.poll(), POLL_MS);
  }

  async poll() {
    if (document.hidden || performance.now() < this.busyUntil || this.isPolling) return;
    this.isPolling = true;
    let problem = "";
    try {
      problem = await this.refresh();
      if (!problem && this.pollProblem) await this.loadTags(); // shows what was shown before it
    } catch (error) {
      problem = error instanceof Refused ? error.message : NO_ANSWER;
    }
    if (problem && problem !== this.pollProblem) this.report(problem);
    this.pollProblem = problem;
    this.isPolling = false;
  }

  /** Load what has changed. Return the problem of the log, "" for none. */
  async refresh() {
    const { log, lag, tags, growing } = await (await ask(`${this.address}/version`)).json();
    const changed = log === this.state.version ? "" : await this.changed(growing);
    if (lag !== this.state.lag) {
      this.state.lag = lag;
      this.dispatchEvent(new Event("lag"));
    }
    if (tags !== this.tagsVersion) {
      this.tagsVersion = tags; // before they are read: an unreadable file is read once
      await this.loadTags();
    }
    return changed;
  }

  async changed(isGrowing) {
    if (isGrowing || this.state.problem) {
      await this.load();
      return "";
    }
    const { fingerprint, version } = await (await ask(`${this.address}/state`)).json();
    if (fingerprint !== this.state.fingerprint) return "this log has been replaced by another one: reload the page to see it";
    this.state.version = version; // touched, or copied
    return "";
  }
}
