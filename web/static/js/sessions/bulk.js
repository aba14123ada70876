// What the list's filter finds in all of its sessions: looked at, tagged, and undone as one.

import { fillGrid, picturesOf } from "../grid.js";
import { showStatus } from "../live.js";
import { History } from "../session/history.js";
import { ask } from "../session/log_data.js";
import { counted } from "../session/selection.js";

const by = (id) => document.getElementById(id);
const form = by("filters");
const done = new History({
  address: "/sessions",
  state: { fingerprint: "" },
  async change(action, name, rows) {
    const body = JSON.stringify({ action, name, rows });
    return (await ask("/sessions.tags", { method: "POST", headers: { "Content-Type": "application/json" }, body })).json();
  },
});
let looked = null; // the stretches in the grid, and the query that has found them
let queue = Promise.resolve();

function inOrder(make) {
  queue = queue.then(make).catch((error) => showStatus(error.message)).then(showHistory);
}

function showHistory() {
  by("undo").disabled = !done.done.length;
  by("redo").disabled = !done.undone.length;
}

function query() {
  return new URLSearchParams(new FormData(form)).toString();
}

/** Each stretch that is neither excluded nor fine, with its log. */
async function find() {
  const { logs, problems } = await (await ask(`/sessions.found?${query()}`)).json();
  const stretches = logs.flatMap((of) => of.rows.map((rows) => ({ of, rows, isTicked: true })));
  return { query: query(), stretches, problems };
}

/** The rows of the ticked stretches, by their logs. */
function rowsByLog(stretches) {
  const logs = new Map();
  for (const { of, rows } of stretches) {
    if (!logs.has(of.key)) logs.set(of.key, { key: of.key, log: of.log, rows: [] });
    logs.get(of.key).rows.push(rows);
  }
  return [...logs.values()];
}

function said(logs) {
  const rows = logs.flatMap((each) => each.rows).map(([first, last]) => ({ first, last }));
  return `${counted(rows)} of ${logs.length.toLocaleString("en")} ${logs.length === 1 ? "session" : "sessions"}`;
}

async function tag(name) {
  const found = looked?.query === query() ? looked : await find();
  const ticked = found.stretches.filter((each) => each.isTicked);
  if (!ticked.length) {
    showStatus(["nothing is left of it: all is excluded or fine", ...found.problems].join("; "));
    return;
  }
  const answer = await done.make("add", name, rowsByLog(ticked));
  showStatus([`${name}: ${said(answer.changed)}`, answer.notice, ...found.problems].filter(Boolean).join("; "));
  close();
}

async function look() {
  if (looked) {
    close();
    return;
  }
  looked = await find();
  by("looking").hidden = false;
  by("list").hidden = true;
  const { stretches } = looked;
  const shown = stretches.map(({ of, rows: [first, last] }) => {
    const count = of.camera ? picturesOf(last - first + 1, stretches.length) : 0;
    const numbers = Array.from({ length: count }, (_, at) => Math.round(first + ((last - first) * at) / Math.max(count - 1, 1)));
    return {
      title: `${of.name}, rows ${first} to ${last}`,
      href: `/sessions/${of.key}#row=${first}`,
      pictures: numbers.map((row) => ({ address: `/sessions/${of.key}/pictures/${of.camera}/${row}?v=${of.version}`, title: `row ${row}` })),
    };
  });
  fillGrid(by("looking").querySelector("ol"), shown, (ticked) => stretches.forEach((each, at) => (each.isTicked = ticked[at] ?? true)));
  showStatus(stretches.length ? said(rowsByLog(stretches)) : "nothing is left of it: all is excluded or fine");
}

function close() {
  looked = null;
  by("looking").hidden = true;
  by("list").hidden = false;
}

async function step(move, words) {
  const change = await done[move]();
  const what = change && `${words}: ${change.action} ${change.name}, ${said(change.rows)}`;
  showStatus([what ?? `nothing is left to ${move}`, change && done.notice].filter(Boolean).join("; "));
}

/** There is something to tag where the filter is of rows. */
function show() {
  const { only, where } = Object.fromEntries(new FormData(form));
  by("bulk").hidden = !where.trim() && !by("bulk").dataset.kinds.split(",").includes(only);
  close();
}

by("look-at").addEventListener("click", () => inOrder(look));
by("exclude").addEventListener("click", () => inOrder(() => tag("exclude")));
by("fine").addEventListener("click", () => inOrder(() => tag("fine")));
by("undo").addEventListener("click", () => inOrder(() => step("undo", "undone")));
by("redo").addEventListener("click", () => inOrder(() => step("redo", "again")));
by("bulk").addEventListener("submit", (event) => {
  event.preventDefault();
  const name = by("name").value.trim();
  if (name) inOrder(() => tag(name));
});
for (const event of ["input", "change"]) form.addEventListener(event, show);
done.restore();
show();
showHistory();
