// The rows that match the filter in all sessions of the list: look at them, tag them, undo.

import { by, number } from "../dom.js";
import { fillGrid, spread } from "../grid.js";
import { showStatus } from "../live.js";
import { ask } from "../session/log_data.js";
import { counted } from "../session/selection.js";
import { changeTags, TagChanges } from "../tag_changes.js";

const NOTHING_LEFT = "nothing is left: all of it is excluded or fine";
const form = by("filters");
const changes = new TagChanges({
  change: (action, name, rows) => changeTags("/sessions.tags", { action, name, rows }),
  tag: (name) => changes.inOrder(() => tag(name)),
  describe,
});
let inGrid = null; // the query and the stretches in the grid

function query() {
  return new URLSearchParams(new FormData(form)).toString();
}

/** The stretches that are neither excluded nor fine. */
async function find() {
  const { logs, problems } = await (await ask(`/sessions.found?${query()}`)).json();
  const stretches = logs.flatMap((log) => log.rows.map((rows) => ({ log, rows, isTicked: true })));
  return { query: query(), stretches, problems };
}

function rowsByLog(stretches) {
  const logs = new Map();
  for (const { log, rows } of stretches) {
    if (!logs.has(log.key)) logs.set(log.key, { key: log.key, log: log.log, rows: [] });
    logs.get(log.key).rows.push(rows);
  }
  return [...logs.values()];
}

function describe(logs) {
  const rows = logs.flatMap((log) => log.rows).map(([first, last]) => ({ first, last }));
  return `${counted(rows)} of ${number(logs.length)} ${logs.length === 1 ? "recording" : "recordings"}`;
}

async function tag(name) {
  const { stretches, problems } = inGrid?.query === query() ? inGrid : await find();
  const ticked = stretches.filter((stretch) => stretch.isTicked);
  if (!ticked.length) return showStatus([NOTHING_LEFT, ...problems].join("; "));
  const answer = await changes.make("add", name, rowsByLog(ticked));
  showStatus([`${name}: ${describe(answer.changed)}`, answer.notice, ...problems].filter(Boolean).join("; "));
  close();
}

async function look() {
  if (inGrid) return close();
  inGrid = await find();
  by("looking").hidden = false;
  by("list").hidden = true;
  const { stretches } = inGrid;
  const shown = stretches.map(({ log: { key, name, camera, version }, rows: [first, last] }) => {
    const numbers = camera ? spread(first, last, stretches.length) : [];
    return {
      title: `${name}, rows ${first} to ${last}`,
      href: `/sessions/${key}#row=${first}`,
      pictures: numbers.map((row) => ({ address: `/sessions/${key}/pictures/${camera}/${row}?v=${version}`, title: `row ${row}` })),
    };
  });
  fillGrid(by("looking").querySelector("ol"), shown, (ticked) => stretches.forEach((stretch, at) => (stretch.isTicked = ticked[at] ?? true)));
  showStatus(stretches.length ? describe(rowsByLog(stretches)) : NOTHING_LEFT);
}

function close() {
  inGrid = null;
  by("looking").hidden = true;
  by("list").hidden = false;
}

/** The tools are for a filter of rows. */
function show() {
  const { only, where } = Object.fromEntries(new FormData(form));
  by("bulk").hidden = !where.trim() && !by("bulk").dataset.kinds.split(",").includes(only);
  close();
}

by("look-at").addEventListener("click", () => changes.inOrder(look));
for (const event of ["input", "change"]) form.addEventListener(event, show);
changes.restore("/sessions");
show();
