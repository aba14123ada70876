// Selected stretches. They are in order and do not overlap.

/** The stretches in order. Overlapping ones become one. */
export function merged(stretches) {
  const result = [];
  for (const { first, last } of [...stretches].sort((a, b) => a.first - b.first)) {
    const before = result.at(-1);
    if (before && first <= before.last) before.last = Math.max(before.last, last);
    else result.push({ first, last });
  }
  return result;
}

/** The stretches, beginning and ending so many seconds earlier and later; negative seconds shorten them. No stretch
 * grows into another drive, and each keeps a row. */
export function grown(stretches, data, { earlierS = 0, laterS = 0 }) {
  return merged(stretches.map(({ first, last }) => {
    const begin = Math.min(moved(data, first, -earlierS), last);
    return { first: begin, last: Math.max(moved(data, last, laterS), begin) };
  }));
}

/** The position so many seconds later, or the end of the drive. */
function moved(data, position, seconds) {
  if (!seconds) return position;
  const step = Math.sign(seconds);
  const { driven_s: time } = data.columns;
  const breaks = new Set(data.breaks);
  const isEnd = (at) => (step > 0 ? at === data.length - 1 || breaks.has(at + 1) : at === 0 || breaks.has(at));
  let at = position;
  while (!isEnd(at) && Math.abs(time[at] - time[position]) < Math.abs(seconds) - 1e-6) at += step;
  return at;
}

/** The stretches, with an edge of one of them moved to a position, but not over its neighbours. */
export function withEdge(stretches, number, side, position) {
  const changed = stretches.map((stretch) => ({ ...stretch }));
  const before = changed[number - 1]?.last ?? -1;
  const behind = changed[number + 1]?.first ?? Infinity;
  const stretch = changed[number];
  if (side === "first") stretch.first = Math.min(Math.max(position, before + 1), stretch.last);
  else stretch.last = Math.max(Math.min(position, behind - 1), stretch.first);
  return changed;
}

/** The shortest stretch at a position; null without one. */
export function at(stretches, position) {
  const around = stretches.filter(({ first, last }) => first <= position && position <= last);
  return around.sort((a, b) => a.last - a.first - (b.last - b.first))[0] ?? null;
}

export function words(stretches, data) {
  if (!stretches.length) return "";
  if (stretches.length > 1) return `${counted(stretches)} selected`;
  const [first, last] = data.rowsOf(stretches[0]);
  return `rows ${first} to ${last} selected`;
}

/** "452 rows in 7 stretches" */
export function counted(stretches) {
  const rows = stretches.reduce((sum, { first, last }) => sum + last - first + 1, 0);
  const [row, stretch] = [rows === 1 ? "row" : "rows", stretches.length === 1 ? "stretch" : "stretches"];
  return `${rows.toLocaleString("en")} ${row} in ${stretches.length.toLocaleString("en")} ${stretch}`;
}
