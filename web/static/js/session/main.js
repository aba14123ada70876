// The page of a session: the actions of mouse and keys on its curves, pictures and tags.

import { showStatus } from "../live.js";
import { Attention } from "./attention.js";
import { angle, clock } from "./clock.js";
import { Course } from "./course.js";
import { CourseMap } from "./course_map.js";
import { Curves } from "./curves.js";
import { DriverBand } from "./drivers.js";
import { listen } from "./keys.js";
import { listEvents, listOdd, listTags, listWorst } from "./lists.js";
import { ask, LogData } from "./log_data.js";
import { Edges } from "./edges.js";
import { Filter } from "./filter.js";
import { Looking } from "./looking.js";
import { Makers } from "./make.js";
import { left, Round, words } from "./odd.js";
import { Overview } from "./overview.js";
import { Pictures } from "./pictures.js";
import { Player } from "./player.js";
import { Predictions } from "./predictions.js";
import { RerunFrame } from "./rerun.js";
import * as selecting from "./selection.js";
import { Tagging } from "./tagging.js";

const EXCLUDE = "exclude";
const FINE = "fine";
const by = (id) => document.getElementById(id);
const page = by("session");
const data = new LogData(page.dataset.log);
const pictures = new Pictures(document.querySelectorAll("figure[data-camera]"), data);
const curves = new Curves(by("curves"), data, { onMove: point, onSelect: (stretch) => select([stretch]), onClick: click });
new Edges(curves, { onChange: (stretches) => select(stretches) });
new Overview(by("overview"), data, curves);
const looking = new Looking(by("looking"), data, { onPick: goToPosition, onChange: (stretches) => select(stretches, true) });
const player = new Player(data, { onMove: move, onChange: showPlaying });
const tagging = new Tagging(data, { selected: () => selection, showStatus });
const filter = new Filter(data, { onChange: showFiltered, showStatus });
const makers = new Makers(by("make"), data);
const rerun = new RerunFrame(by("rerun"), data, { onChange: showRerun, onProblem: showStatus });
const predictions = new Predictions(data, { onChange: showPredicted });
const attention = new Attention(document.querySelector("figure[data-camera=center]"), data, { onChange: showAttention });
const course = by("course-map") && new Course(data, { onChange: showCourse }); // of a log that was driven
const drivers = course && new DriverBand(by("drivers"), course, curves);
const map = course && new CourseMap(by("course-map"), course, {
  picture: document.querySelector("figure[data-camera=center] img"), onPoint: point, onPick: goTo,
});
const round = new Round();
let selection = []; // stretches

/** The mouse points at a moment. While it plays, it does not: the mouse lies where it was left. */
function point(position) {
  if (!player.isPlaying) move(position);
}

function move(position) {
  if (!data.length) return;
  curves.point(position);
  pictures.show(curves.position);
  attention.show(curves.position);
  rerun.moveTo(curves.position);
  map?.move(curves.position);
  const at = curves.position;
  const { row, driven_s, steering, throttle, brake, speed_mph } = data.columns;
  const more = [["sent", "sent"], ["expert", "the expert's"], ["network", "the network's"], ["predicted", "predicted"]];
  const fixed = (value) => (Number.isFinite(value) ? value.toFixed(2) : "-");
  const turned = (value) => (Number.isFinite(value) ? angle(value, data.state.max_steering_deg) : "-");
  const text =
    `row ${row[at]} · ${clock(driven_s[at])} · steering ${turned(steering[at])} · throttle ${fixed(throttle[at])}` +
    ` · brake ${fixed(brake[at])} · ${fixed(speed_mph[at])} mph` +
    more.filter(([name]) => data.columns[name]).map(([name, words]) => ` · ${words} ${turned(data.columns[name][at])}`).join("");
  by("now").textContent = text;
  by("curves").setAttribute("aria-valuenow", at);
  by("curves").setAttribute("aria-valuetext", text);
}

/** Select stretches; the grid of pictures shows them, too, unless it is where they were chosen. */
function select(stretches, isByGrid = false) {
  selection = selecting.merged(stretches);
  curves.mark({ selection });
  const canTag = Boolean(selection.length) && !data.state.problem;
  by("exclude").disabled = by("fine").disabled = by("tag").disabled = !canTag;
  by("look-at").disabled = !selection.length || !data.state.cameras.length;
  makers.select(selection.length ? data.rowsOf({ first: selection[0].first, last: selection.at(-1).last }) : null);
  by("selected").textContent = selecting.words(selection, data);
  if (looking.isOpen && !isByGrid) showPictures(selection.length > 0);
}

/** A click selects the stretch that is there as a whole; with shift, or control, next to what is selected. */
function click(position, { shiftKey, ctrlKey, metaKey }) {
  const found = selecting.at([...filter.groups, ...data.tags], position);
  if (!shiftKey && !ctrlKey && !metaKey) select(found ? [found] : []);
  else if (selecting.at(selection, position)) select(selection.filter((each) => each !== selecting.at(selection, position)));
  else if (found) select([...selection, found]);
}

function grow(seconds) {
  if (selection.length) select(selecting.grown(selection, data, seconds));
  else showStatus("select a stretch first: drag over the curves, or press j");
}

/** The selected stretches as pictures, instead of the cameras at one moment. */
function showPictures(isShown) {
  if (isShown) looking.open(selection, filter.groups);
  else looking.close();
  page.classList.toggle("in-grid", looking.isOpen);
  by("look-at").setAttribute("aria-pressed", looking.isOpen);
}

function togglePictures() {
  if (looking.isOpen || selection.length) showPictures(!looking.isOpen);
  else showStatus("select stretches first: drag over the curves, press j, or choose a kind");
}

function excludeSure() {
  tagging.inOrder(() => tagging.make(EXCLUDE, filter.sure)); // those that are left when its turn comes
}

function goTo(stretch) {
  player.pause();
  curves.reveal(stretch);
  select([stretch]);
  move(stretch.first);
}

/** After earlier changes are written: pressing x and j at once does both. */
function goToOdd(step) {
  tagging.inOrder(() => {
    const from = selection.length === 1 ? selection[0] : { first: curves.position - 1, last: curves.position };
    const { toDo, groups } = filter;
    const interventions = left(course?.interventions ?? [], data.tags);
    const found = round.next([interventions, toDo], step > 0 ? from.first : from.last, step);
    if (!found) {
      showStatus(groups.length ? "all odd stretches are excluded or fine" : "nothing odd in this log");
      return;
    }
    goTo(found);
    const number = interventions.indexOf(found) + 1;
    if (number) showStatus(`${words(found)}; ${number} of ${interventions.length} interventions`);
    else showStatus(`${words(found) || "found"}; ${toDo.length} of ${groups.length} ${filter.kind || filter.found ? "" : "odd "}stretches are left`);
  });
}

function begin(edge) {
  if (!data.length) return;
  const at = curves.position;
  if (edge === "first") select([{ first: at, last: Math.max(at, selection.at(-1)?.last ?? at) }]);
  else select([{ first: Math.min(at, selection[0]?.first ?? at), last: at }]);
}

function showPlaying() {
  by("play").setAttribute("aria-pressed", player.isPlaying);
}

function setSpeed(speed) {
  player.speed = speed;
  by("speed").value = speed;
}

/** Its line stays while other runs are chosen; with none chosen, all that were kept go. */
function keepRun() {
  if (predictions.about) predictions.keep();
  else predictions.forgetKept();
  showPredicted();
}

/** What the log has of a drive. */
function showCourse() {
  by("events-part").hidden = !course.events.length;
  listEvents(by("events"), course.events, goToMoment);
  curves.build();
  drivers.show();
  map.show();
  move(curves.position);
  page.dataset.course = data.length; // what is shown now, for scripts that wait for it
}

/** The prediction of the chosen run, as far as it is there. */
function showPredicted() {
  by("predicted").textContent = predictions.summary;
  by("predicted").className = predictions.problem ? "problem" : "dim";
  const run = predictions.problem ? "" : predictions.run; // then it can be chosen again
  by("run").value = run;
  by("keep-run").disabled = !predictions.canKeep && (predictions.about || !predictions.kept.length);
  by("keep-run").textContent = predictions.about || !predictions.kept.length ? "Keep its line" : "Remove kept lines";
  by("kept").replaceChildren(
    ...predictions.kept.map(({ column, summary }) => Object.assign(document.createElement("span"), { className: column, textContent: `${summary} ` })),
  );
  for (const { column, name } of predictions.kept) curves.names[column] = name;
  curves.names.predicted = predictions.kept.length && predictions.about ? predictions.name : "predicted";
  by("predict-stop").hidden = !predictions.isWaiting;
  attention.use(run);
  by("attention").disabled = !run;
  by("worst-next").disabled = !predictions.worst.length;
  by("worst-part").hidden = !predictions.about;
  listWorst(by("worst"), predictions.worst, goToMoment);
  curves.build();
  move(curves.position);
  page.dataset.run = predictions.about ? predictions.run : ""; // what is shown now, for scripts that wait for it
}

function showAttention(why) {
  by("attention").setAttribute("aria-pressed", attention.isOn);
  if (why) showStatus(why);
}

function toggleAttention() {
  if (predictions.run) attention.toggle();
  else showStatus("choose a run first, whose network looks at this picture");
}

function goToMoment(moment) {
  goToPosition(moment.position);
}

function goToPosition(position) {
  player.pause();
  curves.reveal({ first: position, last: position });
  move(position);
}

function goToWorst(step) {
  const moment = predictions.next(step);
  if (!moment) {
    showStatus(predictions.about ? "nothing was recorded to compare with" : "choose a run first, whose network looks at this log");
    return;
  }
  goToMoment(moment);
  showStatus(`${predictions.at + 1} of ${predictions.worst.length}: ${moment.words}`);
}

function toggleRerun() {
  if (rerun.isOpen) rerun.close();
  else rerun.open(curves.position);
}

/** Rerun shows the cameras, too: theirs make room for it. */
function showRerun() {
  by("rerun-button").setAttribute("aria-pressed", rerun.isOpen);
  page.classList.toggle("in-rerun", rerun.isOpen);
  curves.resize();
}

/** The kinds of odd stretches, and those of the chosen kind. */
function showOdd() {
  filter.show();
  const undone = new Set(filter.toDo);
  listOdd(by("odd"), filter.groups, data, { isLeft: (group) => undone.has(group), onPick: goTo });
  by("exclude-odd").disabled = Boolean(data.state.problem) || !filter.sure.length;
}

/** Other stretches are listed: they are selected at once, and the curves show all of them. */
function showFiltered(isSelected) {
  curves.odd = filter.groups;
  showOdd();
  select(isSelected ? filter.toDo : []);
  if (!isSelected) return;
  curves.show(0, data.length - 1);
  showStatus(filter.toDo.length ? selecting.words(filter.toDo, data) : "nothing of it is left");
}

function showTags() {
  const leftOut = data.state.not_learnt.reduce((sum, [first, last]) => sum + last - first + 1, 0);
  by("not-learnt").hidden = !leftOut;
  by("not-learnt").textContent = `hatched: ${leftOut.toLocaleString("en")} rows that training leaves out by default`;
  showOdd();
  listTags(by("tags"), data, {
    canChange: !data.state.problem,
    onPick: goTo,
    onRemove: (taken) => tagging.remove(taken.name, taken.rows),
  });
  curves.mark({});
  by("look").hidden = data.state.pictures_checked || !data.state.cameras.length;
  page.dataset.tags = data.tags.length; // what is shown now, for scripts that wait for it
}

data.addEventListener("rows", () => {
  tagging.restore();
  filter.refresh();
  pictures.useCameras();
  curves.odd = filter.groups;
  predictions.forgetKept(); // they were of the log as it was
  if (predictions.run) predictions.choose(predictions.run); // it was of the log as it was
  else curves.build();
  course?.load().catch((error) => showStatus(error.message));
  select(selection);
  by("curves").setAttribute("aria-valuemax", Math.max(data.length - 1, 0));
  move(curves.position);
});
/** Frozen and broken pictures are found by decoding all of them, which is done on request. */
async function checkPictures() {
  by("look").disabled = true;
  try {
    let found = await (await ask(`${data.address}/look`, { method: "POST" })).json();
    const total = data.state.pictures;
    while (!found.is_done) {
      const isDecoded = found.pictures >= total;
      by("look").textContent = isDecoded
        ? "comparing steering with pictures"
        : `looking: ${found.pictures.toLocaleString("en")} of ${total.toLocaleString("en")} pictures`;
      await new Promise((resolve) => setTimeout(resolve, 300));
      found = await (await ask(`${data.address}/look`)).json();
    }
    if (found.problem) {
      showStatus(found.problem);
    } else {
      filter.use("");
      const before = filter.groups.length;
      await data.load();
      const more = filter.groups.length - before;
      const result = more > 0 ? `${more} more odd ${more === 1 ? "stretch" : "stretches"}` : "nothing more is odd";
      showStatus(`looked at ${total.toLocaleString("en")} pictures: ${result}`);
    }
  } catch (error) {
    showStatus(error.message);
  }
  by("look").textContent = "Look at all pictures";
  by("look").disabled = false;
}

data.addEventListener("tags", showTags);
data.addEventListener("lag", () => by("about").dispatchEvent(new Event("lag-changed")));
data.addEventListener("problem", (event) => {
  by("problem").textContent = event.detail;
  by("problem").hidden = !event.detail;
});

by("play").addEventListener("click", () => player.toggle(curves.position));
by("speed").addEventListener("change", () => setSpeed(Number(by("speed").value)));
by("next").addEventListener("click", () => goToOdd(1));
by("before").addEventListener("click", () => goToOdd(-1));
by("exclude").addEventListener("click", () => tagging.tag(EXCLUDE));
by("fine").addEventListener("click", () => tagging.tag(FINE));
by("exclude-odd").addEventListener("click", excludeSure);
by("look-at").addEventListener("click", togglePictures);
by("look").addEventListener("click", checkPictures);
by("run").addEventListener("change", () => {
  predictions.choose(by("run").value);
  by("run").blur(); // its keys are the page's again
});
by("predict-stop").addEventListener("click", async () => {
  try {
    await predictions.stop();
    showStatus("stopped: the network looks at no more pictures");
  } catch (error) {
    showStatus(error.message);
  }
});
by("keep-run").addEventListener("click", keepRun);
by("attention").addEventListener("click", toggleAttention);
by("worst-next").addEventListener("click", () => goToWorst(1));
by("rerun-button").addEventListener("click", toggleRerun);
by("rerun-close").addEventListener("click", toggleRerun);
function toggleHelp() {
  const isHidden = (by("help").hidden = !by("help").hidden);
  by("help-button").setAttribute("aria-expanded", !isHidden);
}
by("help-button").addEventListener("click", toggleHelp);

const steps = (event) => (event.shiftKey ? 10 : 1);
const stepBy = (rows) => {
  player.pause();
  move(curves.position + rows);
  curves.follow(curves.position);
};
listen({
  ArrowLeft: (event) => stepBy(-steps(event)),
  ArrowRight: (event) => stepBy(steps(event)),
  Home: () => stepBy(-Infinity),
  End: () => stepBy(Infinity),
  " ": () => player.toggle(curves.position),
  1: () => setSpeed(1),
  2: () => setSpeed(2),
  3: () => setSpeed(4),
  4: () => setSpeed(8),
  j: () => goToOdd(1),
  k: () => goToOdd(-1),
  x: () => tagging.tag(EXCLUDE),
  f: () => tagging.tag(FINE),
  t: () => by("name").focus(),
  u: () => tagging.undo(),
  r: () => tagging.redo(),
  undo: () => tagging.undo(),
  redo: () => tagging.redo(),
  "[": () => begin("first"),
  "]": () => begin("last"),
  Escape: () => (looking.isOpen ? showPictures(false) : select([])),
  ",": () => grow({ earlierS: 1 }),
  ".": () => grow({ laterS: 1 }),
  "<": () => grow({ earlierS: -1 }),
  ">": () => grow({ laterS: -1 }),
  g: togglePictures,
  X: excludeSure,
  "+": () => curves.zoom(0.5),
  "-": () => curves.zoom(2),
  0: () => curves.show(0, data.length - 1),
  o: toggleRerun,
  a: toggleAttention,
  w: () => goToWorst(1),
  W: () => goToWorst(-1),
  "?": toggleHelp,
});

/** The address names a row, a kind of odd stretches, and runs: when the page is opened, and when a link leads to another row of the same page. */
async function followAddress() {
  const named = new URLSearchParams(location.hash.slice(1));
  const row = named.get("row");
  if (row !== null && data.length) {
    const at = data.position(Number(row), false);
    player.pause();
    curves.reveal({ first: at, last: at }); // before the move: the mouse, if it is over the curves, points as well
    move(at);
  }
  if (named.get("kind")) filter.use(named.get("kind"));
  const runs = named.getAll("run");
  for (const run of runs) {
    by("run").value = run;
    await predictions.choose(by("run").value);
    if (run !== runs.at(-1)) keepRun();
  }
}

try {
  await data.load();
  addEventListener("hashchange", followAddress);
  data.follow();
  followAddress();
} catch (error) {
  data.report(error.message);
}
page.dataset.ready = "true";
