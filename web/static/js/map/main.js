// The page of a map: what lies under the mouse, what a drag chooses, and the tags of what is chosen.

import { button, by, make, number, showProblem } from "../dom.js";
import { showStatus } from "../live.js";
import { PointCloud } from "../point_cloud.js";
import { angle, clock } from "../session/clock.js";
import { listen } from "../session/keys.js";
import { EXCLUDE, FINE, TagChanges } from "../tag_changes.js";
import { paletteOf, waysOf } from "./colourings.js";
import { PictureMap } from "./map_data.js";

const FEW = 60; // pictures that are shown of a large choice
const LIKE = 24;
const LONELY_SHARE = 0.01;
const DOUBLE = 0.05; // of the usual distance to the most alike picture

const page = by("map");
const of = page.dataset.of.split(" ").filter(Boolean).map((address) => address.slice(1));
const map = new PictureMap(of, { onChange: show });
const changes = new TagChanges({ change: (...change) => map.change(...change), tag, said, onChange: showTags });
const cloud = new PointCloud(by("cloud"), {
  onPoint: showUnder,
  onPick: pick,
  onSelect: (points, isMore) => choose(isMore ? [...cloud.selected, ...points] : points),
  onOpen: (at) => at >= 0 && location.assign(map.page(at)),
});
let ways = {};
let way = null;
let awaited = null; // the picture that is shown once the one before it is there

function show() {
  const { progress, problem } = map;
  showProblem(problem);
  by("again").hidden = !problem;
  by("progress").hidden = !map.isWaiting;
  if (map.isWaiting) showProgress(progress);
  page.dataset.shown = map.about ? map.run : ""; // for scripts that wait for it
  if (!map.about) {
    cloud.show(new Float32Array(0), new Float32Array(0));
    choose([]);
    by("groups").replaceChildren();
    by("legend").replaceChildren();
    return;
  }
  ways = waysOf(map);
  const before = new URLSearchParams(location.search).get("by") ?? by("by").value;
  by("by").replaceChildren(...Object.keys(ways).map((name) => new Option(name, name, false, name === before)));
  cloud.show(map.columns.x, map.columns.y);
  colour();
  choose([]);
  showGroups();
  const { step, notes } = map.about;
  const left = step > 1 ? [`Of ${step} pictures, one is shown; a change counts for those after it, too.`] : [];
  showStatus([`${number(map.length)} pictures.`, ...left, ...notes].join(" "));
}

function showProgress(progress) {
  const [bar, words] = by("progress").children;
  const { pictures = 0, total = 0, stage = "", left_s: leftS, is_begun: isBegun } = progress ?? {};
  bar.value = total ? pictures / total : 0;
  const left = leftS == null ? "" : `, ${clock(leftS)} left`;
  const parts = `${number(pictures)} of ${number(total)} pictures`;
  if (progress && !isBegun) words.textContent = "waits until the map before it has ended";
  else if (!pictures) words.textContent = "begins";
  else words.textContent = stage ? `${stage}: ${Math.round((100 * pictures) / total)} %${left}` : `${parts}${left}`;
}

function colour() {
  way = ways[by("by").value]();
  cloud.colour(paletteOf(way, by("cloud")), way.of);
  const counts = new Uint32Array(way.names.length);
  for (const bucket of way.of) counts[bucket] += 1;
  by("legend").replaceChildren(
    ...way.names.flatMap((name, bucket) => {
      if (!counts[bucket]) return [];
      const item = button(make("i"), () => choose(map.order.filter((at) => way.of[at] === bucket)));
      item.firstChild.style.color = `var(${way.colours[bucket]})`;
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
  const next = map.picture(shown);
  if (picture.complete || !picture.src) picture.src = next;
  else awaited = next;
}
for (const event of ["load", "error"]) {
  by("under").children[0].addEventListener(event, ({ target }) => {
    if (awaited) target.src = awaited;
    awaited = null;
  });
}

/** A click holds the picture; with shift, or by the space bar, it is chosen or no more. */
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
  const logs = new Set(chosen.map((at) => map.columns.log[at])).size;
  const counted = (count, noun) => `${number(count)} ${noun}${count === 1 ? "" : "s"}`;
  by("count").textContent = `${counted(chosen.length, "picture")}${logs > 1 ? ` of ${counted(logs, "session")}` : ""}`;
  const step = isWhole ? 1 : Math.max(1, chosen.length / FEW);
  const some = step === 1 ? chosen : Array.from({ length: FEW }, (_, at) => chosen[Math.floor(at * step)]);
  by("pictures").replaceChildren(...some.map(thumbnail));
  by("more").hidden = some.length === chosen.length;
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

/** The list that is there for those who do not see the map, or do not want to drag. */
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

/** The tags are other ones. */
async function showTags() {
  await map.loadTags();
  const before = [...cloud.selected];
  colour();
  choose(before);
}

function said(logs) {
  return `${number(logs.reduce((sum, { rows }) => sum + rows.reduce((more, [first, last]) => more + last - first + 1, 0), 0))} rows`;
}

function tag(name) {
  if (!cloud.selected.size) return showStatus("choose pictures first: drag around their dots, or take a group");
  const logs = map.stretches(cloud.selected);
  changes.inOrder(async () => {
    const { changed, notice } = await changes.make("add", name, logs);
    showStatus([`${name}: ${changed.length ? said(changed) : "nothing new"}`, notice].filter(Boolean).join("; "));
  });
}

function like() {
  const at = cloud.pointed < 0 ? cloud.pinned : cloud.pointed;
  if (at < 0) showStatus("point at a picture first");
  else choose(map.like(at, LIKE));
}

function useTool(name) {
  cloud.tool = by("cloud").dataset.tool = name;
  for (const button of document.querySelectorAll("[data-tool]")) {
    if (button.type === "button") button.setAttribute("aria-pressed", button.dataset.tool === name);
  }
}

function nameInAddress() {
  const query = new URLSearchParams([...of.map((each) => ["of", each]), ["run", by("run").value], ["by", by("by").value]]);
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
  const found = map.order.filter((at) => map.columns.nearest[at] < DOUBLE);
  choose(found);
  if (!found.length) showStatus("no picture hardly differs from another one");
});
by("none").addEventListener("click", () => choose([]));
by("more").addEventListener("click", () => choose([...cloud.selected], true));
listen({ ...changes.keys, n: like, Escape: () => choose([]) });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => map.about && colour());

changes.restore("the map");
map.make(by("run").value);
