// The lists under the curves: odd stretches, tags, and the commands that do what was done here.

import { clock } from "./clock.js";
import { words } from "./odd.js";

const MOST = 200; // of each list; all of them are in the curves

export function listOdd(element, groups, data, { isLeft, onPick }) {
  fill(element, groups, (group) => [
    button(words(group) || "show", () => onPick(group), isLeft(group) ? "" : "done"),
    rowsText(data, group, group.causes.join("; ")),
  ]);
}

export function listTags(element, data, { canChange, onPick, onRemove }) {
  fill(element, data.tags, (tag) => {
    const remove = button("remove", () => onRemove(tag), "small");
    remove.setAttribute("aria-label", `remove ${tag.name}, rows ${tag.rows.join(" to ")}`);
    remove.disabled = !canChange;
    return [button(tag.name, () => onPick(tag), tag.name === "exclude" ? "exclude" : "tag"), rowsText(data, tag), remove];
  });
}

export function listEvents(element, events, onPick) {
  fill(element, events, (event) => [
    button(clock(event.seconds), () => onPick(event), event.is_intervention ? "exclude" : "tag"),
    text("span", event.text, "dim"),
  ]);
}

export function listWorst(element, moments, onPick) {
  fill(element, moments, (moment) => [button(moment.short, () => onPick(moment), ""), text("span", moment.words, "dim")]);
}

function fill(element, items, made) {
  const lines = items.slice(0, MOST).map((item) => {
    const line = document.createElement("li");
    line.append(...made(item));
    return line;
  });
  if (items.length > MOST) lines.push(text("li", `and ${(items.length - MOST).toLocaleString("en")} more`, "dim"));
  if (!items.length) lines.push(text("li", "none", "dim"));
  element.replaceChildren(...lines);
}

function rowsText(data, { first, last }, why = "") {
  const rows = data.rowsOf({ first, last });
  const where = `rows ${rows[0]} to ${rows[1]}, at ${clock(data.columns.driven_s[first])}`;
  return text("span", why ? `${where}: ${why}` : where, "dim");
}

function button(label, onClick, kind) {
  const made = text("button", label, kind);
  made.type = "button";
  made.addEventListener("click", onClick);
  return made;
}

function text(kind, content, style) {
  const made = document.createElement(kind);
  made.textContent = content;
  if (style) made.className = style;
  return made;
}
