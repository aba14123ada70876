// What the list's filter finds in all of its sessions: looked at, tagged, and undone as one.

import { by, number } from "../dom.js";
import { fillGrid, spread } from "../grid.js";
import { showStatus } from "../live.js";
import { ask } from "../session/log_data.js";
import { counted } from "../session/selection.js";
import { changeTags, TagChanges } from "../tag_changes.js";

const form = by("filters");
const changes = new TagChanges({
  change: (action, name, rows) => changeTags("/sessions.tags", { action, name, rows }),
  tag: (name) => changes.inOrder(() => tag(name)),
  said,
});
let looked = null; // the stretches in the grid, and the query that has found them

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
  return `${counted(rows)} of ${number(logs.length)} ${logs.length === 1 ? "session" : "sessions"}`;
}

async function tag(name) {
  const found = looked?.query === query() ? looked : await find();
  const ticked = found.stretches.filter((each) => each.isTicked);
  if (!ticked.length) return showStatus(["nothing is left of it: all is excluded or fine", ...found.problems].join("; "));
  const answer = await changes.make("add", name, rowsByLog(ticked));
  showStatus([`${name}: ${said(answer.changed)}`, answer.notice, ...found.problems].filter(Boolean).join("; "));
  close();
}

async function look() {
  if (looked) return close();
  looked = await find();
  by("looking").hidden = false;
  by("list").hidden = true;
  const { stretches } = looked;
  const shown = stretches.map(({ of, rows: [first, last] }) => {
    const numbers = of.camera ? spread(first, last, stretches.length) : [];
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

/** There is something to tag where the filter is of rows. */
function show() {
  const { only, where } = Object.fromEntries(new FormData(form));
  by("bulk").hidden = !where.trim() && !by("bulk").dataset.kinds.split(",").includes(only);
  close();
}

by("look-at").addEventListener("click", () => changes.inOrder(look));
for (const event of ["input", "change"]) form.addEventListener(event, show);
changes.restore("/sessions");
show();
