// The lists below the curves: odd stretches, tags, events, worst moments.

import { button, clock, make, number } from "../dom.js";
import { words } from "./odd.js";

const MAX_ITEMS = 200; // of a list; the curves show all

export function listOdd(element, groups, data, { isLeft, onPick }) {
  fill(element, groups, (group) => [
    button(words(group) || "show", () => onPick(group), { className: isLeft(group) ? "" : "done" }),
    rowsText(data, group, group.causes.join("; ")),
  ]);
}

export function listTags(element, data, { canChange, onPick, onRemove }) {
  fill(element, data.tags, (tag) => {
    const ariaLabel = `remove ${tag.name}, rows ${tag.rows.join(" to ")}`;
    return [
      button(tag.name, () => onPick(tag), { className: tag.name === "exclude" ? "exclude" : "tag" }),
      rowsText(data, tag),
      button("remove", () => onRemove(tag), { className: "small", disabled: !canChange, ariaLabel }),
    ];
  });
}

export function listEvents(element, events, onPick) {
  fill(element, events, (event) => [
    button(clock(event.seconds), () => onPick(event), { className: event.is_intervention ? "exclude" : "tag" }),
    make("span", { className: "dim" }, event.text),
  ]);
}

export function listWorst(element, moments, onPick) {
  fill(element, moments, (moment) => [button(moment.short, () => onPick(moment)), make("span", { className: "dim" }, moment.words)]);
}

function fill(element, items, made) {
  const lines = items.slice(0, MAX_ITEMS).map((item) => make("li", {}, ...made(item)));
  if (items.length > MAX_ITEMS) lines.push(make("li", { className: "dim" }, `and ${number(items.length - MAX_ITEMS)} more`));
  if (!items.length) lines.push(make("li", { className: "dim" }, "none"));
  element.replaceChildren(...lines);
}

function rowsText(data, { first, last }, cause = "") {
  const rows = data.rowsOf({ first, last });
  const text = `rows ${rows[0]} to ${rows[1]}, at ${clock(data.columns.driven_s[first])}`;
  return make("span", { className: "dim" }, cause ? `${text}: ${cause}` : text);
}
