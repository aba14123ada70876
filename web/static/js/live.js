// Changes by commands appear without a reload: the folders' versions are polled, and each element that shows one of
// them (data-live="NAME" data-version="...") gets the event `folders-changed` when it has another one.
// Polling, not server-sent events: a browser keeps six connections to a server, so that a seventh tab would hang.

import { reasonIn } from "./dom.js";

const EVERY_MS = 2000;
const WHILE_CHANGING_MS = 500; // logs are being read, or a command is at work
const STATUS_FOR_MS = 8000;
const status = document.getElementById("status");
let unanswered = 0;
let next = 0;
let forgetting = 0;

export function showStatus(text) {
  status.textContent = text;
  clearTimeout(forgetting);
  forgetting = setTimeout(() => (status.textContent = ""), STATUS_FOR_MS);
}

async function poll() {
  clearTimeout(next);
  if (document.hidden) return; // nothing is polled for a hidden page
  let hasChanged = false;
  try {
    const answer = await fetch("/changes");
    if (!answer.ok) throw new Error(answer.statusText);
    const found = await answer.json();
    if (unanswered) showStatus("");
    unanswered = 0;
    for (const element of document.querySelectorAll("[data-live]")) {
      const version = found[element.dataset.live];
      if (version === element.dataset.version) continue;
      element.dataset.version = version;
      hasChanged = true;
      element.dispatchEvent(new CustomEvent("folders-changed", { bubbles: true }));
    }
  } catch {
    unanswered += 1;
    if (unanswered > 1) showStatus("bc-web does not answer: it was ended, or is restarted");
  }
  next = setTimeout(poll, hasChanged ? WHILE_CHANGING_MS : EVERY_MS);
}

// the address names what is shown, so that it can be kept and sent
function nameInAddress(form) {
  const filled = [...new FormData(form)].filter(([, value]) => value);
  history.replaceState(null, "", `${form.action}${filled.length ? "?" : ""}${new URLSearchParams(filled)}`);
}

if (document.querySelector("[data-live]")) {
  document.addEventListener("visibilitychange", poll);
  poll();
}
for (const form of document.querySelectorAll("form.filters")) {
  form.addEventListener("input", () => nameInAddress(form));
}
document.addEventListener("htmx:response:error", ({ detail: { ctx } }) => showStatus(reasonIn(ctx.text, ctx.response.status)));
