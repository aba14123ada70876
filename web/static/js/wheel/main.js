// The page at the wheel: devices, the socket, the picture, and the keys and buttons of the page.

import { by, make, showProblem, toggleHelp } from "../dom.js";
import { showStatus } from "../live.js";
import { Delays } from "./delays.js";
import { Drag } from "./drag.js";
import { Gamepads } from "./gamepads.js";
import { Hands } from "./hands.js";
import { Keys } from "./keys.js";
import { Link } from "./link.js";
import { Panel, write } from "./panel.js";
import { Picture } from "./picture.js";
import { loadSettings, saveSetting } from "./settings.js";

const SEND_MS = 100; // at most, between two controls
const MAX_STEP_S = 0.1; // the steering does not jump after a pause
const FRAME_MS = 1000 / 60;
const MAX_EVENTS = 30;
const BAD_S = 5;
const STALE_MS = 100; // after this, an event that has changed nothing does not count
const ASK_AGAIN = { times: 4, ms: 2000 }; // a broken connection may hold the wheel for some seconds
const page = by("wheel");

export const settings = loadSettings();
export const delays = new Delays();
const keys = new Keys();
const mouse = new Drag(by("cockpit"), "mouse", touched);
const finger = new Drag(by("cockpit"), "touch", touched);
const pads = new Gamepads(settings, report, pressed);
export const hands = new Hands([keys, mouse, finger, pads], settings);
const panel = new Panel();
const picture = new Picture(by("picture"));

let number = 0;
let sent = {};
let sent_ms = -Infinity;
let before_ms = performance.now();
let event_ms = null; // time of the first event that is not sent yet
let isHolder = false;
let wasHolder = false; // before the connection was lost
let asksLeft = 0;
let isAsked = false;
let isFree = false; // nobody holds the wheel
let isOver = false;
let isRecording = false;
let hasRecorded = false;
let learner = null; // a button of the page that waits for a button of a gamepad
const learners = document.querySelectorAll("[data-learns]");

const link = new Link(`${page.dataset.at}/socket`, { onText: hear, onFrame: show, onChange: connected });

function touched(event) {
  event_ms ??= event.timeStamp;
  steer();
}

/** A key goes down or up. Until now, the steering went on as before. Its effect within a frame is sent at once. */
function turn(event, change) {
  steer();
  change();
  event_ms ??= event.timeStamp;
  steer(FRAME_MS);
}

/** Send the control of now, or of `ahead_ms` later, if it has changed or the last one was long ago. */
function steer(ahead_ms = 0) {
  const now = performance.now();
  const passed_ms = Math.max(now + ahead_ms - before_ms, 0);
  const control = hands.control(Math.min(passed_ms, 1000 * MAX_STEP_S) / 1000);
  before_ms += passed_ms;
  by("stick").value = pads.steering;
  const hasChanged = Object.entries(control).some(([name, value]) => sent[name] !== value);
  if (isHolder && isAwake() && (hasChanged || now - sent_ms >= SEND_MS)) send(control, now);
  else if (isFree && isAwake() && control.touching) askOrGive(); // the first touch takes the wheel
}

function send(control, now) {
  if (!link.send({ type: "control", number: number + 1, time_ms: now, ...control })) return;
  number += 1;
  if (event_ms !== null && now - event_ms > STALE_MS) event_ms = null;
  if (event_ms !== null && (control.steering !== sent.steering || control.throttle !== sent.throttle)) {
    delays.sent(number, event_ms);
    event_ms = null;
  }
  sent = control;
  sent_ms = now;
  page.dataset.sent = JSON.stringify({ number, ...control }); // for scripts that wait for it
}

const isAwake = () => !document.hidden && document.hasFocus() && !by("confirm").open;

/** Release all controls, and send that at once. */
function letGo() {
  const { device } = hands.control(0);
  hands.release();
  delays.forget();
  event_ms = null;
  if (!isHolder) return;
  send({ steering: 0, throttle: 0, hold_mph: settings.holds && !hands.isWaiting ? settings.hold_mph : null, device, touching: false }, performance.now());
}

function connected(isOpen) {
  if (isOpen) {
    picture.restart();
    link.send({ type: "view", recorded: settings.recorded });
    showProblem("");
    return;
  }
  wasHolder ||= isHolder;
  isHolder = isFree = false;
  hands.release();
  delays.forget();
  if (isOver) return;
  by("cockpit").classList.add("stalled");
  panel.showRecording("not connected");
  showProblem("The connection is lost, and all keys are released. What is recorded is kept. The page connects again by itself.");
  findOut();
}

/** Whether the drive goes on. */
async function findOut() {
  try {
    const answer = await fetch(page.dataset.at, { method: "HEAD" });
    if (answer.status === 404 || answer.redirected) ended({ why: "its process has ended" });
    if (answer.status === 401) showProblem("bc-web was started again, and all keys are released. The drive goes on. Open the address that bc-web printed: it has a new token.");
  } catch {
    showProblem("bc-web does not answer, and all keys are released. The drive goes on without you, and what is recorded is kept. The page connects again by itself.");
  }
}

function hear(message) {
  if (message.type === "hello") {
    panel.greet(message);
    if (settings.hold_of !== page.dataset.at && message.hold_mph) change("hold_mph", message.hold_mph);
  } else if (message.type === "wheel") seat(message);
  else if (message.type === "event") report(message.text, message.level);
  else if (message.type === "ended") ended(message);
}

/** Show who has the wheel: this page, or another one. */
function seat({ holder, asked, free }) {
  isHolder = holder;
  isAsked = asked;
  isFree = free;
  sent = {};
  page.dataset.holder = holder;
  if (holder) asksLeft = 0;
  else if (wasHolder) {
    asksLeft = ASK_AGAIN.times; // this page had it before the connection was lost
    link.send({ type: "ask" });
  }
  wasHolder = false;
  let [text, action] = ["Another page has the wheel.", "Ask for it"];
  if (free) [text, action] = ["Nobody has the wheel. Steer to take it.", "Take the wheel"];
  if (asked) [text, action] = ["Another page asks for the wheel.", "Give it"];
  by("seat").hidden = holder && !asked;
  by("seat").firstElementChild.textContent = text;
  by("seat").lastElementChild.innerHTML = `${action} <kbd>T</kbd>`;
  for (const button of document.querySelectorAll(".tools[role=toolbar] button:not(#recorded)")) button.disabled = !holder;
}

function askOrGive() {
  if (isAsked) link.send({ type: "give" });
  else if (!isHolder && link.send({ type: "ask" }) && !isFree) showStatus("You have asked for the wheel. If nobody steers, you get it at once.");
  isFree = false; // asked once
}

async function show(frame, jpeg) {
  const isPainted = await picture.paint(frame.frame, jpeg);
  link.send({ type: "got", frame: frame.frame });
  if (!isPainted || isOver) return;
  if (isHolder) delays.painted(frame.control);
  isRecording = frame.is_recording;
  panel.show(frame, isHolder, delays.median);
  stalled(frame);
  hint(frame);
  page.dataset.frame = frame.frame;
}

/** One hint at a time, until the person has done it. */
function hint(frame) {
  const isTouch = matchMedia("(hover: none)").matches;
  hasRecorded ||= frame.is_recording;
  let text = "";
  if (isHolder && hands.isWaiting && frame.drives !== "pilot") text = isTouch ? "Drag to start" : "Steer, or press ↑, to start";
  else if (isHolder && !hasRecorded && !by("record").hidden) text = isTouch ? "Tap Record: a network learns from it" : "Press R to record: a network learns from it";
  by("hint").hidden = !text;
  write("hint", text);
}

/** Dim the picture of a simulator that sends no new one, and say why. */
function stalled({ stalled: why = "", stalled_since_s: since_s }) {
  by("cockpit").classList.toggle("stalled", why !== "");
  by("stalled").hidden = !why;
  if (!why) return;
  const at = new Date(1000 * since_s).toTimeString().slice(0, 8);
  write("stalled", why === "gone"
    ? `The simulator has gone. Its last picture is of ${at}. Start it again: the drive waits for it.`
    : `The simulator has been silent since ${at}. Its car keeps its last command.`);
}

function report(text, level = "warning") {
  showStatus(text);
  by("events").prepend(make("li", { className: level }, `${new Date().toTimeString().slice(0, 8)} ${text}`));
  while (by("events").children.length > MAX_EVENTS) by("events").lastChild.remove();
}

function ended({ why }) {
  if (isOver) return;
  isOver = true;
  isHolder = isFree = false;
  link.close();
  showProblem("");
  for (const id of ["drive", "seat", "help", "stalled"]) by(id).hidden = true;
  for (const element of page.querySelectorAll(".tools, details, #driver, #help-button, #full-screen")) element.hidden = true;
  panel.showRecording("ended");
  write("ended-title", why ? `${why[0].toUpperCase()}${why.slice(1)}` : "The drive has ended");
  by("ended").hidden = false;
  if (by("confirm").open) by("confirm").close();
  if (page.dataset.after) htmx.ajax("GET", page.dataset.after, { target: "#after", select: "#after", swap: "outerHTML" });
}

const request = (message) => isHolder && link.send(message);
function confirmEnd() {
  if (!isHolder || by("confirm").open) return;
  letGo();
  by("confirm").returnValue = "";
  by("confirm").showModal();
}
by("confirm").addEventListener("close", () => by("confirm").returnValue === "end" && request({ type: "end" }));

function change(name, value) {
  saveSetting(settings, name, value);
  if (name === "hold_mph") saveSetting(settings, "hold_of", page.dataset.at);
  showSettings();
}

function showSettings() {
  by("holds").checked = settings.holds;
  for (const name of ["hold_mph", "dead_zone", "curve", "steer_axis", "throttle_axis", "brake_axis"]) by(name).value = settings[name];
  by("recorded").setAttribute("aria-pressed", settings.recorded);
  for (const button of learners) {
    const at = settings[`button_${button.dataset.learns}`];
    button.setAttribute("aria-pressed", button === learner);
    button.lastElementChild.textContent = button === learner ? "press a button of it" : at < 0 ? "as above" : `button ${at + 1}`;
  }
}

/** The next button of a gamepad or wheel does the same as this button's key; a second click forgets what was learnt. */
function learn(button) {
  const name = `button_${button.dataset.learns}`;
  const isSecond = learner === button;
  learner = isSecond ? null : button;
  pads.learn(isSecond ? null : (at) => {
    for (const other of learners) if (settings[`button_${other.dataset.learns}`] === at) saveSetting(settings, `button_${other.dataset.learns}`, -1);
    learner = null;
    change(name, at);
  });
  if (isSecond) change(name, -1);
  showSettings();
}

function toggleRecorded() {
  change("recorded", !settings.recorded);
  link.send({ type: "view", recorded: settings.recorded });
}

/** A gamepad's button does what this key does; in the question whether to end, it answers. */
function pressed(key) {
  if (by("confirm").open) return by("confirm").close(key === "escape" || key === "r" ? "end" : "");
  if (!isOver) actions[key]();
}

const actions = {
  r: () => request({ type: isRecording ? "pause" : "record" }),
  x: () => request({ type: "bad", seconds: BAD_S }),
  h: () => request({ type: "hand_back" }),
  b: () => request({ type: "put_back" }),
  v: toggleRecorded,
  p: () => (hands.begin(), change("holds", !settings.holds)),
  t: askOrGive,
  escape: confirmEnd,
  f: () => (document.fullscreenElement ? document.exitFullscreen() : page.requestFullscreen?.()),
  "?": toggleHelp,
};
const buttons = { record: "r", bad: "x", "hand-back": "h", "put-back-button": "b", recorded: "v", end: "escape", "help-button": "?", "full-screen": "f" };
for (const [id, key] of Object.entries(buttons)) {
  by(id).addEventListener("click", (event) => {
    actions[key]();
    if (event.detail) by(id).blur(); // after a click, keys are for driving again
  });
}
by("seat").lastElementChild.addEventListener("click", askOrGive);
for (const button of learners) button.addEventListener("click", () => learn(button));
by("holds").addEventListener("change", () => change("holds", by("holds").checked));
for (const name of ["hold_mph", "dead_zone", "curve", "steer_axis", "throttle_axis", "brake_axis"]) {
  by(name).addEventListener("change", () => change(name, by(name).valueAsNumber));
}

const isTyping = ({ target }) => target.matches?.("input:not([type=checkbox]), select, textarea");
document.addEventListener("keydown", (event) => {
  if (isOver || by("confirm").open) return;
  if (event.ctrlKey || event.altKey || event.metaKey) return letGo(); // a browser shortcut: the page may miss its keyup
  if (isTyping(event)) return event.key === "Escape" && event.target.blur();
  if (Keys.drives(event.code)) {
    event.preventDefault(); // the page does not scroll
    if (!event.repeat) turn(event, () => keys.down(event.code));
    return;
  }
  if (event.key === "Escape" && !by("help").hidden) return toggleHelp();
  const action = actions[event.key.toLowerCase()];
  if (!action || event.repeat) return;
  event.preventDefault();
  action();
});
document.addEventListener("keyup", (event) => Keys.drives(event.code) && turn(event, () => keys.up(event.code)));
document.addEventListener("focusin", (event) => isTyping(event) && letGo());
addEventListener("blur", letGo);
addEventListener("pagehide", letGo);
document.addEventListener("visibilitychange", () => document.hidden && letGo());
for (const name of ["gamepadconnected", "gamepaddisconnected"]) {
  addEventListener(name, () => {
    steer();
    write("pads", pads.names.join(" · ") || "None is connected: press one of its buttons.");
  });
}

showSettings();
setInterval(steer, SEND_MS);
setInterval(() => asksLeft-- > 0 && link.send({ type: "ask" }), ASK_AGAIN.ms);
(function eachFrame() {
  if (isOver) return;
  steer();
  requestAnimationFrame(eachFrame);
})();
page.dataset.ready = "true";
