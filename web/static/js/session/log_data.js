// The page's data of its log, fetched again when the files change.

import { reasonIn } from "../dom.js";

const GAP_S = 1; // as recorder/rows/row_quality.py: behind a longer pause, or where time goes back, a new drive begins
const POLL_MS = 2000;
const WORK_POLL_MS = 400;
const LOAD_SHARE = 5; // a log that is being recorded is read in full each time: that may take a fifth of the time

export class Refused extends Error {}

export async function ask(path, options) {
  const answer = await fetch(path, options);
  if (answer.ok) return answer;
  throw new Refused(reasonIn(await answer.text(), answer.status));
}

/** Columns that lie one after the other. */
export function columnsOf(values, names) {
  const length = values.length / names.length;
  return Object.fromEntries(names.map((name, at) => [name, values.subarray(at * length, (at + 1) * length)]));
}

/** Work that the server does: begun, and asked for until it is done. It is given up where it `isWanted()` no more. */
export async function awaited(address, { isWanted, onProgress }) {
  let found = await (await ask(address, { method: "POST" })).json();
  while (isWanted() && !found.about && !found.problem) {
    onProgress(found);
    await new Promise((resolve) => setTimeout(resolve, WORK_POLL_MS));
    found = await (await ask(address)).json();
  }
  if (isWanted() && found.problem) throw new Error(found.problem);
  return found;
}

export class LogData extends EventTarget {
  /** Events: `rows` (all is new), `tags`, `lag` (of the steering: measured), and `problem` with its text as detail (empty: it is over). */
  constructor(address) {
    super();
    this.address = address;
    this.state = null;
    this.columns = {};
    this.breaks = [];
    this.length = 0;
    this.tags = [];
    this.names = [];
    this.tagsVersion = null; // of the file, as it was when it was read
    this.storeProblem = ""; // why the store that the log is in does not answer
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

  /** `driven_s`: the time that was driven until each row; `breaks`: the rows that begin another drive. */
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
      const found = await (await ask(`${this.address}/tags`)).json();
      if (request < this.tagRequests) return; // a later request has, or will have, the newer answer
      this.tagsVersion = found.version;
      this.names = found.names;
      this.tags = found.tags.map(([first, last, name]) => ({
        first: this.position(first, false),
        last: this.position(last, true),
        rows: [first, last],
        name: found.names[name],
      }));
      this.report(found.stale ? `${found.stale} tags beside this log are of what had its name before, and do not count` : "");
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

  /** The position of a row: of the first that is not before it or, `isLast`, the last that is not behind it. */
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

  /** The rows of a stretch of positions. */
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
    try {
      const found = await (await ask(`${this.address}/version`)).json();
      if (found.problem !== this.storeProblem) this.report((this.storeProblem = found.problem));
      if (found.log !== this.state.version) await this.changed(found);
      if (found.lag !== this.state.lag) {
        this.state.lag = found.lag;
        this.dispatchEvent(new Event("lag"));
      }
      if (found.tags !== this.tagsVersion) {
        this.tagsVersion = found.tags; // fetched once, also where they cannot be read
        await this.loadTags();
      }
    } catch (error) {
      this.report(error instanceof Refused ? error.message : "bc-web does not answer: it was ended, or is restarted");
    } finally {
      this.isPolling = false;
    }
  }

  async changed(found) {
    const fingerprint = this.state.fingerprint;
    if (found.growing || this.state.problem) {
      await this.load(); // more of the same
      return;
    }
    const state = await (await ask(`${this.address}/state`)).json();
    if (state.fingerprint === fingerprint) this.state.version = state.version; // touched, or copied
    else this.report("this log has been replaced by another one: reload the page to see it");
  }
}
