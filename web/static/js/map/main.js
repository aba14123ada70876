// The page of a map: the picture under the mouse, the chosen pictures, and their tags.

import { angle, button, by, clock, listen, make, number, showProblem } from "../dom.js";
import { showStatus } from "../live.js";
import { PointCloud } from "../point_cloud.js";
import { EXCLUDE, FINE, TagChanges } from "../tag_changes.js";
import { colouringsOf, paletteOf } from "./colourings.js";
import { PictureMap } from "./map_data.js";

const MAX_SHOWN = 60; // pictures of a large choice
const SIMILAR = 24; // pictures that "n" chooses
const LONELY_SHARE = 0.01;
const DOUBLE = 0.05; // of the median distance to the most similar picture

const page = by("map");
const logs = page.dataset.logs.split(" ").filter(Boolean).map((address) => address.slice(1));
const map = new PictureMap(logs, { onChange: show });
const changes = new TagChanges({ change: (...change) => map.change(...change), tag, describe, onChange: showTags });
const cloud = new PointCloud(by("cloud"), {
  onPoint: showUnder,
  onPick: pick,
  onSelect: (points, isMore) => choose(isMore ? [...cloud.selected, ...points] : points),
  onOpen: (at) => at >= 0 && location.assign(map.page(at)),
});
let colourings = {};
let colouring = null;
let nextPicture = null; // shown when the previous picture is loaded

function show() {
  const { progress, problem } = map;
  showProblem(problem);
  by("again").hidden = !problem;
  by("progress").hidden = !map.isWaiting;
  by("stop").disabled = !map.key; // not known before the work has begun
  if (map.isWaiting) showProgress(progress);
  for (const id of ["lonely", "doubles", "whole", "by"]) by(id).disabled = !map.about;
  page.dataset.shown = map.about ? map.run : ""; // for scripts that wait for it
  if (!map.about) {
    cloud.show(new Float32Array(0), new Float32Array(0));
    choose([]);
    by("groups").replaceChildren();
    by("legend").replaceChildren();
    return;
  }
  colourings = colouringsOf(map);
  const before = new URLSearchParams(location.search).get("by") ?? by("by").value;
  by("by").replaceChildren(...Object.keys(colourings).map((name) => new Option(name, name, false, name === before)));
  cloud.show(map.columns.x, map.columns.y);
  colour();
  choose([]);
  showGroups();
  const { step, notes } = map.about;
  const skipped = step > 1 ? [`One of ${step} pictures is shown; a tag includes the pictures in between.`] : [];
  showStatus([`${number(map.length)} pictures.`, ...skipped, ...notes].join(" "));
}

function showProgress(progress) {
  const [bar, words] = by("progress").children;
  const { pictures = 0, total = 0, stage = "", left_s: leftS, is_begun: isBegun } = progress ?? {};
  bar.value = total ? pictures / total : 0;
  by("stop").disabled = !progress; // the server has not named the work yet
  const left = leftS == null ? "" : `, ${clock(leftS)} left`;
  if (progress && !isBegun) words.textContent = "waiting for another map";
  else if (!pictures) words.textContent = "starting";
  else if (stage) words.textContent = `${stage}: ${Math.round((100 * pictures) / total)} %${left}`;
  else words.textContent = `${number(pictures)} of ${number(total)} pictures${left}`;
}

function colour() {
  colouring = colourings[by("by").value]();
  const { names, colours, buckets } = colouring;
  cloud.colour(paletteOf(colouring, by("cloud")), buckets);
  const counts = new Uint32Array(names.length);
  for (const bucket of buckets) counts[bucket] += 1;
  by("legend").replaceChildren(
    ...names.flatMap((name, bucket) => {
      if (!counts[bucket]) return [];
      const item = button(make("i"), () => choose(map.order.filter((at) => buckets[at] === bucket)));
      item.firstChild.style.color = `var(${colours[bucket]})`;
      item.append(`${name} `, make("span", { className: "dim" }, number(counts[bucket])));
      return [make("li", {}, item)];
    }),
  );
}

function words(at) {
  const { row, steering, predicted } = map.columns;
  const deg = (value) => angle(value, map.about.max_deg, map.about.max_deg === null ? 0 : 1);
  const steered = Number.isFinite(steering[at]) ? ` · steering ${deg(steering[at])}` : "";
  const run = Number.isFinite(predicted[at]) ? `, predicted ${deg(predicted[at])}` : "";
  const tags = map.tagsOf(at);
  return `${map.logOf(at).name}, row ${row[at]}${steered}${run}${tags.length ? ` · ${tags.join(", ")}` : ""}`;
}

function showUnder(at) {
  const shown = at < 0 ? cloud.pinned : at;
  if (shown < 0) return;
  by("under-words").replaceChildren(`${words(shown)} · `, make("a", { href: map.page(shown) }, "open"));
  const [picture] = by("under").children;
  picture.hidden = false;
  const address = map.picture(shown);
  if (picture.complete || !picture.src) picture.src = address;
  else nextPicture = address;
}
for (const event of ["load", "error"]) {
  by("under").children[0].addEventListener(event, ({ target }) => {
    if (nextPicture) target.src = nextPicture;
    nextPicture = null;
  });
}

/** A click keeps the picture shown. With shift, or by the space bar, it adds the picture to the choice or removes it. */
function pick(at, isMore) {
  if (at < 0) {
    if (!isMore) choose([]);
    return;
  }
  cloud.pin(at);
  showUnder(at);
  if (!isMore) return;
  const chosen = new Set(cloud.selected);
  if (!chosen.delete(at)) chosen.add(at);
  choose(chosen);
}

function choose(points, isWhole = false) {
  cloud.select(points);
  const chosen = map.about ? map.inOrder(cloud.selected) : [];
  by("changes").hidden = !chosen.length;
  by("groups").hidden = by("groups-title").hidden = chosen.length > 0 || !map.about;
  const sessions = new Set(chosen.map((at) => map.columns.log[at])).size;
  const counted = (count, noun) => `${number(count)} ${noun}${count === 1 ? "" : "s"}`;
  by("count").textContent = `${counted(chosen.length, "picture")}${sessions > 1 ? ` of ${counted(sessions, "recording")}` : ""}`;
  const step = isWhole ? 1 : Math.max(1, chosen.length / MAX_SHOWN);
  const shown = step === 1 ? chosen : Array.from({ length: MAX_SHOWN }, (_, at) => chosen[Math.floor(at * step)]);
  by("pictures").replaceChildren(...shown.map(thumbnail));
  by("more").hidden = shown.length === chosen.length;
  by("more").textContent = `Show all ${number(chosen.length)}`;
  page.dataset.chosen = chosen.length; // for scripts that wait for it
}

function thumbnail(at) {
  const tags = map.tagsOf(at);
  const point = () => cloud.point(at);
  const link = make("a", { href: map.page(at), title: words(at), onmouseenter: point, onfocus: point }, image(at));
  return make("li", { className: tags.includes(EXCLUDE) ? "excluded" : tags.includes(FINE) ? "fine" : "" }, link);
}

function image(at) {
  return make("img", { loading: "lazy", decoding: "async", alt: words(at), src: map.picture(at) });
}

/** A list of groups, for users who do not see the map, or do not want to drag. */
function showGroups() {
  const members = map.about.groups.map(() => []);
  for (const at of map.order) members[map.columns.group[at]].push(at);
  by("groups").replaceChildren(
    ...map.about.groups.map((middle, at) => {
      const group = button(image(middle), () => choose(members[at]));
      group.append(`${number(members[at].length)} like this`);
      return make("li", {}, group);
    }),
  );
}

async function showTags() {
  if (!map.about) return; // it gets them with its points
  await map.loadTags();
  const before = [...cloud.selected];
  colour();
  choose(before);
}

function describe(logs) {
  const rows = logs.flatMap((log) => log.rows).reduce((sum, [first, last]) => sum + last - first + 1, 0);
  return `${number(rows)} rows`;
}

function tag(name) {
  if (!cloud.selected.size) return showStatus("choose pictures first: drag around their dots, or press a group");
  const stretches = map.stretches(cloud.selected);
  changes.inOrder(async () => {
    const { changed, notice } = await changes.make("add", name, stretches);
    showStatus([`${name}: ${changed.length ? describe(changed) : "no change"}`, notice].filter(Boolean).join("; "));
  });
}

function chooseSimilar() {
  const at = cloud.pointed < 0 ? cloud.pinned : cloud.pointed;
  if (at < 0) showStatus("point at a picture first");
  else choose(map.nearest(at, SIMILAR));
}

function useTool(name) {
  cloud.tool = by("cloud").dataset.tool = name;
  for (const button of document.querySelectorAll("button[data-tool]")) {
    button.setAttribute("aria-pressed", button.dataset.tool === name);
  }
}

function nameInAddress() {
  const query = new URLSearchParams([...logs.map((log) => ["of", log]), ["run", by("run").value], ["by", by("by").value]]);
  history.replaceState(null, "", `/map?${query}`);
}

for (const button of document.querySelectorAll("button[data-tool]")) {
  button.addEventListener("click", () => useTool(button.dataset.tool));
}
by("run").addEventListener("change", () => {
  nameInAddress();
  map.make(by("run").value);
});
by("by").addEventListener("change", () => {
  nameInAddress();
  colour();
});
by("again").addEventListener("click", () => map.make(by("run").value));
by("stop").addEventListener("click", () => map.stop().catch((error) => showStatus(error.message)));
by("whole").addEventListener("click", () => cloud.reset());
by("lonely").addEventListener("click", () => {
  const { alone } = map.columns;
  const count = Math.max(1, Math.round(LONELY_SHARE * map.length));
  choose([...map.order].sort((a, b) => alone[b] - alone[a]).slice(0, count));
});
by("doubles").addEventListener("click", () => {
  const doubles = map.order.filter((at) => map.columns.nearest[at] < DOUBLE);
  choose(doubles);
  if (!doubles.length) showStatus("there are no doubles: every picture differs from the others");
});
by("none").addEventListener("click", () => choose([]));
by("more").addEventListener("click", () => choose([...cloud.selected], true));
listen({ ...changes.keys, n: chooseSimilar, Escape: () => choose([]) });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => map.about && colour());

changes.restore("the map");
map.make(by("run").value);
