// Changes by commands appear without a reload: this script polls the versions of the lists. An element with data-live
// (names of lists) and data-version gets the event `folders-changed` when a version changes. Server-sent events would
// keep a connection open in each tab, and a browser opens at most six to a server.

import { reasonIn } from "./dom.js";

const EVERY_MS = 2000;
const WHILE_CHANGING_MS = 500; // while logs are read, or a command works
const STATUS_FOR_MS = 8000;
export const NO_ANSWER = "bc-web does not answer: it has ended, or is restarting";
const status = document.getElementById("status");
let unanswered = 0;
let next = 0;
let forgetting = 0;

export function showStatus(text) {
  status.textContent = text.replaceAll("`", "");
  clearTimeout(forgetting);
  forgetting = setTimeout(() => (status.textContent = ""), STATUS_FOR_MS);
}

async function poll() {
  clearTimeout(next);
  if (document.hidden) return;
  let hasChanged = false;
  let reason = NO_ANSWER;
  try {
    const answer = await fetch("/changes");
    if (!answer.ok) throw new Error((reason = reasonIn(await answer.text(), answer.status)));
    const versions = await answer.json();
    const isBack = unanswered > 0; // a list may lack what was entered meanwhile
    if (isBack) showStatus("");
    unanswered = 0;
    for (const element of document.querySelectorAll("[data-live]")) {
      const version = element.dataset.live.split(" ").map((name) => versions[name]).join("; ");
      if (version === element.dataset.version && !isBack) continue;
      element.dataset.version = version;
      hasChanged = true;
      element.dispatchEvent(new CustomEvent("folders-changed", { bubbles: true }));
    }
  } catch {
    unanswered += 1;
    if (unanswered > 1) showStatus(reason);
  }
  next = setTimeout(poll, hasChanged ? WHILE_CHANGING_MS : EVERY_MS);
}

// times are sent in UTC, and shown in the browser's time zone; what a poll brings in, too
const inShort = new Intl.DateTimeFormat(undefined, { dateStyle: "medium", timeStyle: "short" });
function showLocalTimes() {
  for (const time of document.querySelectorAll("time[datetime]")) {
    const local = inShort.format(new Date(time.dateTime));
    if (time.textContent === local) continue;
    time.title = `${time.dateTime.replace("T", " ").replace("Z", "")} UTC`;
    time.textContent = local;
  }
}
showLocalTimes();
new MutationObserver(showLocalTimes).observe(document.getElementById("main"), { childList: true, subtree: true, characterData: true });

// commands are for those who also work in a terminal
const COMMANDS = "shows commands";
const commandsShown = document.getElementById("commands-shown");
function showCommands(areShown) {
  document.documentElement.toggleAttribute("data-commands", areShown);
  commandsShown?.setAttribute("aria-pressed", areShown);
}
showCommands(localStorage.getItem(COMMANDS) === "yes");
commandsShown?.addEventListener("click", () => {
  const areShown = commandsShown.getAttribute("aria-pressed") !== "true";
  localStorage.setItem(COMMANDS, areShown ? "yes" : "no");
  showCommands(areShown);
});

// a menu folds when something else is clicked, or by escape
function foldMenus(within) {
  for (const menu of document.querySelectorAll(".menu[open]")) if (!menu.contains(within)) menu.open = false;
}
document.addEventListener("click", (event) => foldMenus(event.target));
document.addEventListener("keydown", (event) => event.key === "Escape" && foldMenus(null));

// the address has the values of a form, so that a user can keep and send it
function nameInAddress(form) {
  if (new URL(form.action).pathname !== location.pathname) return; // it leads to another page
  const filled = [...new FormData(form)].filter(([, value]) => value);
  history.replaceState(history.state, "", `${form.action}${filled.length ? "?" : ""}${new URLSearchParams(filled)}`);
}

if (document.querySelector("[data-live]")) {
  document.addEventListener("visibilitychange", poll);
  poll();
}
// a second click before the answer would start a second job
const sent = new Set();
document.addEventListener("submit", (event) => {
  if (event.target.method !== "post" || event.defaultPrevented) return;
  if (sent.has(event.target)) event.preventDefault();
  sent.add(event.target);
});
window.addEventListener("pageshow", () => sent.clear()); // back from the answer

// a browser restores the fields on the way back, but not which forms were unfolded
const folds = [...document.querySelectorAll("details:has(input)")];
document.addEventListener("toggle", () => history.replaceState({ unfolded: folds.map((fold) => fold.open) }, ""), true);
const unfolded = history.state?.unfolded ?? [];
window.addEventListener("load", () => folds.forEach((fold, at) => (fold.open ||= Boolean(unfolded[at]))));

for (const form of document.querySelectorAll("form.filters")) {
  form.addEventListener("input", () => nameInAddress(form));
}
document.addEventListener("htmx:response:error", ({ detail: { ctx } }) => showStatus(reasonIn(ctx.text, ctx.response.status)));
