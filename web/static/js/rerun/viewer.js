// Rerun's viewer in this frame. The page around it sends the moment to show, {at_s}. This frame answers {shown_s} when
// it shows that moment, or {problem}.

const TIMELINE = "since start"; // as bc-play names it
const AGAIN_MS = 200; // while the moment's data has not arrived
const POLL_MS = 1000;
const { recording, program } = document.body.dataset;
const status = document.getElementById("status");
console.debug = () => {}; // it prints tens of thousands of lines about its shaders
const fetchAnything = globalThis.fetch.bind(globalThis);
// requests for Rerun's fonts, news and usage statistics end here; the Content-Security-Policy would report errors
globalThis.fetch = async (resource, options) => {
  const request = new Request(resource, options);
  if (new URL(request.url).origin !== location.origin) return new Response(null, { status: 204 });
  return fetchAnything(request, { credentials: "same-origin" }); // sends the token's cookie
};
let wanted = null;
let isBusy = false;

function send(message) {
  parent.postMessage(message, location.origin);
}

/** Show the newest wanted moment. Moments that came while Rerun was busy are skipped. */
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
  for (const field of document.querySelectorAll("input")) field.setAttribute("aria-label", "Text for Rerun");
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

// The message that moves Rerun's time cursor to a moment and pauses it: a ViewerControlRequest of Rerun's Viewer
// Control API (rerun/v1alpha1/viewer_control.proto of 0.41), as `rerun.experimental.ViewerClient.set_time` sends it:
// field 6, set_time_cursor, with timeline (2: its name 1), time (3: nanoseconds 1) and play_state (5: paused 1).
function moment(timeline, seconds) {
  const name = [...new TextEncoder().encode(timeline)];
  const time_ns = BigInt(Math.round(seconds * 1e9));
  const cursor = [...part(2, part(1, name)), ...part(3, number(1, time_ns)), ...number(5, 1n)];
  return Uint8Array.from(part(6, cursor));
}

/** A field that holds bytes: https://protobuf.dev/programming-guides/encoding/. */
function part(field, bytes) {
  return [...varint(BigInt((field << 3) | 2)), ...varint(BigInt(bytes.length)), ...bytes];
}

function number(field, value) {
  return [...varint(BigInt(field << 3)), ...varint(BigInt.asUintN(64, value))];
}

function varint(value) {
  const bytes = [];
  for (; value > 127n; value >>= 7n) bytes.push(Number(value & 127n) | 128);
  return [...bytes, Number(value)];
}
