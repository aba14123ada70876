// What commands change appears without a reload: folders are asked for their versions, and who shows one of them
// (data-live="NAME") gets the event `folders-changed` when it has another one.
// Polling, not server-sent events: a browser keeps six connections to a server, so that a seventh tab would hang.

const EVERY_MS = 2000;
const said = document.getElementById("said");
let versions = null;
let unanswered = 0;

export function say(text) {
  said.textContent = text;
}

async function look() {
  if (document.hidden) return; // nobody looks: nothing is asked
  try {
    const answer = await fetch("/changes");
    if (!answer.ok) throw new Error(answer.statusText);
    const found = await answer.json();
    if (unanswered) say("");
    unanswered = 0;
    for (const element of document.querySelectorAll("[data-live]")) {
      const name = element.dataset.live;
      if (versions && found[name] !== versions[name]) {
        element.dispatchEvent(new CustomEvent("folders-changed", { bubbles: true }));
      }
    }
    versions = found;
  } catch {
    unanswered += 1;
    if (unanswered > 1) say("bc-web does not answer: it was ended, or is restarted");
  }
}

// the address names what is shown, so that it can be kept and sent
function nameInAddress(form) {
  const asked = [...new FormData(form)].filter(([, value]) => value);
  history.replaceState(null, "", `${form.action}${asked.length ? "?" : ""}${new URLSearchParams(asked)}`);
}

if (document.querySelector("[data-live]")) {
  setInterval(look, EVERY_MS);
  document.addEventListener("visibilitychange", look);
  look();
}
for (const form of document.querySelectorAll("form.asked")) {
  form.addEventListener("input", () => nameInAddress(form));
}
document.addEventListener("htmx:response:error", async (event) => {
  const { ctx } = event.detail;
  let why = `the server answers ${ctx.response.status}`;
  try {
    why = JSON.parse(ctx.text).error ?? why;
  } catch {
    // not of the workbench
  }
  say(why);
});
