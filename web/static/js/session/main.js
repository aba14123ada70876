// The page of a session: the actions of its mouse and keys.

import { angle, by, clock, listen, make, number, showProblem, toggleHelp } from "../dom.js";
import { showStatus } from "../live.js";
import { changeTags, EXCLUDE, TagChanges } from "../tag_changes.js";
import { Course, DriverBand } from "./course.js";
import { CourseMap } from "./course_map.js";
import { Curves } from "./curves.js";
import { Filter } from "./filter.js";
import { listEvents, listOdd, listTags } from "./lists.js";
import { ask, awaited, LogData } from "./log_data.js";
import { left, Round, words } from "./odd.js";
import { Overview } from "./overview.js";
import { Pictures } from "./pictures.js";
import { Player } from "./player.js";
import { RerunFrame } from "./rerun.js";
import { RunTools } from "./run_tools.js";
import { Selected } from "./selected.js";
import { counted } from "./selection.js";

const COURSE = { sent: "sent", expert: "the expert's", network: "the network's", predicted: "predicted" };
const LOOK = "Look at all pictures";
const page = by("session");
const data = new LogData(page.dataset.log);
const pictures = new Pictures(document.querySelectorAll("figure[data-camera]"), data);
const curves = new Curves(by("curves"), data, {
  onMove: point,
  onSelect: (stretch) => selected.select([stretch]),
  onClick: (position, event) => selected.click(position, event),
});
const filter = new Filter(data, { onChange: showFiltered, showStatus });
const selected = new Selected(page, data, curves, filter, { onPick: goToPosition });
const overview = new Overview(by("overview"), data, curves, { onMove: scrub });
const player = new Player(data, { onMove: move, onChange: () => by("play").setAttribute("aria-pressed", player.isPlaying) });
const changes = new TagChanges({ change: changeRows, tag, describe });
const rerun = new RerunFrame(by("rerun"), data, { onChange: showRerun, onProblem: showStatus });
const runs = new RunTools(page, data, curves, { onPick: goToPosition, onChange: redraw });
const course = by("course-map") && new Course(data); // null for a log without commands and poses
const drivers = course && new DriverBand(by("drivers"), course, curves);
const map = course && new CourseMap(by("course-map"), course, {
  picture: document.querySelector("figure[data-camera=center] img"), onPoint: point, onPick: goTo,
});
const round = new Round();

/** The mouse points at a moment. While the log plays, the mouse does not count. */
function point(position) {
  if (!player.isPlaying) move(position);
}

function move(position) {
  if (!data.length) return;
  curves.point(position);
  const at = curves.position;
  overview.point(at);
  for (const shown of [pictures, runs.attention]) shown.show(at);
  rerun.moveTo(at);
  map?.move(at);
  const { row, driven_s, steering, throttle, brake, speed_mph } = data.columns;
  const fixed = (value) => (Number.isFinite(value) ? value.toFixed(2) : "-");
  const turned = (value) => (Number.isFinite(value) ? angle(value, data.state.max_steering_deg) : "-");
  const more = Object.entries(COURSE).filter(([name]) => data.columns[name]);
  const text = [
    `row ${row[at]}`, clock(driven_s[at]), `steering ${turned(steering[at])}`, `throttle ${fixed(throttle[at])}`,
    `brake ${fixed(brake[at])}`, `${fixed(speed_mph[at])} mph`, ...more.map(([name, whose]) => `${whose} ${turned(data.columns[name][at])}`),
  ].join(" · ");
  by("now").textContent = text;
  by("curves").setAttribute("aria-valuenow", at);
  by("curves").setAttribute("aria-valuetext", text);
}

function redraw() {
  curves.build();
  move(curves.position);
}

function goToPosition(position) {
  player.pause();
  curves.reveal({ first: position, last: position });
  move(position);
}

function goTo(stretch) {
  player.pause();
  curves.reveal(stretch);
  selected.select([stretch]);
  move(stretch.first);
}

/** Waits until earlier changes are written, so that one can press x and j quickly. */
function goToOdd(step) {
  changes.inOrder(() => {
    const [only] = selected.stretches.length === 1 ? selected.stretches : [{ first: curves.position - 1, last: curves.position }];
    const { toDo, groups } = filter;
    const interventions = left(course?.interventions ?? [], data.tags);
    const stretch = round.next([interventions, toDo], step > 0 ? only.first : only.last, step);
    if (!stretch) return showStatus(groups.length ? "all odd stretches are excluded or fine" : "nothing odd here");
    goTo(stretch);
    const number = interventions.indexOf(stretch) + 1;
    const place = number ? `${number} of ${interventions.length} interventions` : `${toDo.length} of ${groups.length} stretches are left`;
    showStatus([words(stretch), place].filter(Boolean).join("; "));
  });
}

/** Add a name to stretches of rows, or remove it. Return what the server has changed. */
async function changeRows(action, name, rows) {
  const done = await changeTags(`${data.address}/tags`, { action, name, rows, log: data.state.fingerprint });
  await data.loadTags();
  return done;
}

function describe(rows) {
  return rows.length === 1 ? `rows ${rows[0].join(" to ")}` : counted(rows.map(([first, last]) => ({ first, last })));
}

function tag(name) {
  selected.take((stretches) => changes.inOrder(() => tagAll(name, stretches)));
}

async function tagAll(name, stretches) {
  if (data.state.problem) throw new Error(data.state.problem);
  if (!stretches.length) throw new Error("nothing is left: all of it is excluded or fine");
  const rows = stretches.map((stretch) => data.rowsOf(stretch));
  const { notice, changed } = await changes.make("add", name, rows);
  showStatus(notice || `${name}: ${describe(rows)}${changed.length ? "" : ", as before"}`);
}

function excludeSure() {
  changes.inOrder(() => tagAll(EXCLUDE, filter.sure)); // evaluated after earlier changes
}

async function offerNames() {
  const names = await (await ask(`${data.address}/names`)).json();
  by("names").replaceChildren(...names.map((value) => make("option", { value })));
}

async function copyCommands() {
  try {
    await navigator.clipboard.writeText(`${changes.commands.join("\n")}\n`);
    showStatus("copied");
  } catch {
    getSelection().selectAllChildren(by("commands")); // unencrypted pages have no clipboard
    showStatus("selected: copy with ctrl c");
  }
}

function showCourse() {
  course.update();
  by("events-part").hidden = !course.events.length;
  listEvents(by("events"), course.events, ({ position }) => goToPosition(position));
  drivers.show();
  map.show();
  page.dataset.course = data.length; // for scripts that wait for it
}

function toggleRerun() {
  if (rerun.isOpen) rerun.close();
  else rerun.open(curves.position);
}

/** While Rerun is open, it shows the cameras, and the page hides them. */
function showRerun() {
  by("rerun-button").setAttribute("aria-pressed", rerun.isOpen);
  page.classList.toggle("in-rerun", rerun.isOpen);
  curves.resize();
}

function showOdd() {
  filter.show();
  const toDo = new Set(filter.toDo);
  listOdd(by("odd"), filter.groups, data, { isLeft: (group) => toDo.has(group), onPick: goTo });
  by("exclude-odd").disabled = Boolean(data.state.problem) || !filter.sure.length;
}

/** Other stretches are listed. If they are selected, the curves show all of them. */
function showFiltered(isSelected) {
  curves.odd = filter.groups;
  showOdd();
  selected.select(isSelected ? filter.toDo : []);
  if (!isSelected) return;
  curves.show(0, data.length - 1);
  if (!filter.groups.length) showStatus("this log has no such rows");
  else showStatus(filter.toDo.length ? `${counted(filter.toDo)} selected` : "nothing is left: all of it is excluded or fine");
}

function showTags() {
  const leftOut = data.state.not_learnt.reduce((sum, [first, last]) => sum + last - first + 1, 0);
  by("not-learnt").hidden = !leftOut;
  by("not-learnt").textContent = `hatched: ${number(leftOut)} rows that training leaves out by default`;
  showOdd();
  listTags(by("tags"), data, {
    canChange: !data.state.problem,
    onPick: goTo,
    onRemove: ({ name, rows }) => changes.inOrder(() => changes.make("remove", name, [rows])),
  });
  curves.mark({});
  by("look").hidden = data.state.pictures_checked || !data.state.cameras.length;
  page.dataset.tags = data.tags.length; // for scripts that wait for it
}

function showRows() {
  page.classList.toggle("unfinished", Boolean(data.state.problem));
  changes.restore(`${data.address} ${data.state.fingerprint}`);
  filter.refresh();
  pictures.useCameras();
  curves.odd = filter.groups;
  if (course) showCourse();
  runs.refresh();
  selected.select(selected.stretches);
  by("curves").setAttribute("aria-valuemax", Math.max(data.length - 1, 0));
  move(curves.position);
}

/** Look for frozen and broken pictures, which decodes all pictures. */
async function checkPictures() {
  const button = by("look");
  const onProgress = ({ pictures, total, is_begun: isBegun }) => {
    const progress = pictures < total ? `looking: ${number(pictures)} of ${number(total)} pictures` : "comparing steering with pictures";
    button.textContent = isBegun ? progress : "waiting for another check";
  };
  button.disabled = true;
  try {
    await awaited(`${data.address}/look`, { isWanted: () => true, onProgress });
    filter.use("");
    const before = filter.groups.length;
    await data.load();
    const more = filter.groups.length - before;
    const result = more > 0 ? `${more} more odd ${more === 1 ? "stretch" : "stretches"}` : "nothing more is odd";
    showStatus(`looked at all pictures: ${result}`);
  } catch (error) {
    showStatus(error.message);
  }
  button.textContent = LOOK;
  button.disabled = false;
}

function setSpeed(speed) {
  player.speed = by("speed").value = speed;
}

function scrub(position) {
  player.pause();
  move(position);
  curves.follow(curves.position);
}

/** Show the row, the kind of odd stretches and the run that the address names. */
function followAddress() {
  const query = new URLSearchParams(location.hash.slice(1));
  if (query.has("row") && data.length) goToPosition(data.position(Number(query.get("row")), false));
  if (query.get("kind")) filter.use(query.get("kind"));
  if (query.has("run")) runs.choose(query.get("run"));
}

data.addEventListener("rows", showRows);
data.addEventListener("tags", showTags);
data.addEventListener("lag", () => by("about").dispatchEvent(new Event("lag-changed")));
data.addEventListener("problem", ({ detail }) => showProblem(page.querySelector(".rescue") && detail === data.state?.problem ? "" : detail));
by("speed").addEventListener("change", () => setSpeed(Number(by("speed").value)));
by("name").addEventListener("focus", () => offerNames().catch(() => {})); // names can be typed without it
const clicks = {
  play: () => player.toggle(curves.position), next: () => goToOdd(1), before: () => goToOdd(-1), look: checkPictures, copy: copyCommands,
  "exclude-odd": excludeSure, "rerun-button": toggleRerun, "rerun-close": toggleRerun, "help-button": toggleHelp,
};
for (const [id, call] of Object.entries(clicks)) by(id).addEventListener("click", call);
const steps = (event) => (event.shiftKey ? 10 : 1);
listen({
  ...changes.keys,
  ArrowLeft: (event) => scrub(curves.position - steps(event)),
  ArrowRight: (event) => scrub(curves.position + steps(event)),
  Home: () => scrub(-Infinity),
  End: () => scrub(Infinity),
  " ": clicks.play,
  ...Object.fromEntries([1, 2, 4, 8].map((speed, at) => [at + 1, () => setSpeed(speed)])),
  j: clicks.next,
  k: clicks.before,
  "[": () => selected.begin("first"),
  "]": () => selected.begin("last"),
  Escape: () => selected.clear(),
  ",": () => selected.grow({ earlierS: 1 }),
  ".": () => selected.grow({ laterS: 1 }),
  "<": () => selected.grow({ earlierS: -1 }),
  ">": () => selected.grow({ laterS: -1 }),
  g: () => selected.togglePictures(),
  X: excludeSure,
  "+": () => curves.zoom(0.5),
  "-": () => curves.zoom(2),
  0: () => curves.show(0, data.length - 1),
  o: toggleRerun,
  a: () => runs.toggleAttention(),
  w: () => runs.goToWorst(1),
  W: () => runs.goToWorst(-1),
  "?": toggleHelp,
});

try {
  await data.load();
  addEventListener("hashchange", followAddress);
  data.follow();
  followAddress();
} catch (error) {
  data.report(error.message);
}
page.dataset.ready = "true";
