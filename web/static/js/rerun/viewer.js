// Rerun's viewer in this frame. The page around it sends the moment to show, as a message {at_s}; this frame answers
// {shown_s} when that is shown, and {problem} when something goes wrong.

import { moment } from "./time_cursor.js";

const TIMELINE = "since start"; // as bc-play names it
const AGAIN_MS = 200; // the moment's data is still on its way
const POLL_MS = 1000;
const { recording, program } = document.body.dataset;
const status = document.getElementById("status");
console.debug = () => {}; // it prints tens of thousands of lines about its shaders
const fetchAnything = globalThis.fetch.bind(globalThis);
// not its fonts, its news and its telemetry: the Content-Security-Policy refuses them, with an error in the console
globalThis.fetch = async (resource, options) => {
  const request = new Request(resource, options);
  if (new URL(request.url).origin !== location.origin) return new Response(null, { status: 204 });
  return fetchAnything(request, { credentials: "same-origin" }); // with the cookie that has the token
};
let wanted = null;
let isBusy = false;

function send(message) {
  parent.postMessage(message, location.origin);
}

/** Rerun shows the newest moment that is wanted; those wanted while it was busy with another one, never. */
async function follow(viewer) {
  if (isBusy) return;
  isBusy = true;
  while (wanted !== null) {
    const at = wanted;
    try {
      await viewer.viewer_control(moment(TIMELINE, at));
      send({ shown_s: at });
      if (wanted === at) wanted = null;
    } catch {
      await new Promise((resolve) => setTimeout(resolve, AGAIN_MS));
    }
  }
  isBusy = false;
}

function fail(why) {
  document.getElementById("viewer").remove();
  status.textContent = `Rerun's viewer does not run in this browser: ${why}`;
  send({ problem: status.textContent });
}

async function start() {
  await wasm_bindgen({ module_or_path: fetch(program) });
  const viewer = new wasm_bindgen.WebHandle({
    url: [new URL(recording, location.origin).href],
    hide_welcome_screen: true,
    enable_history: false,
    notebook: false,
    persist: false,
    theme: matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light",
  });
  await viewer.start(document.getElementById("viewer"));
  status.hidden = true;
  for (const field of document.querySelectorAll("input")) field.setAttribute("aria-label", "What is typed into Rerun");
  addEventListener("message", (event) => {
    if (event.origin !== location.origin || typeof event.data?.at_s !== "number") return;
    wanted = event.data.at_s;
    follow(viewer);
  });
  const polling = setInterval(() => {
    if (!viewer.has_panicked()) return;
    clearInterval(polling);
    fail(viewer.panic_message());
  }, POLL_MS);
  send({ is_ready: true });
}

try {
  await start();
} catch (error) {
  fail(error?.message ?? error);
}
