// Predicted against driven steering: a point for each picture of a session.

import { by, colourReader, make } from "../dom.js";
import { showStatus } from "../live.js";
import { PointCloud } from "../point_cloud.js";
import { ask, LogData } from "../session/log_data.js";
import { Predictions } from "../session/predictions.js";

const TICKS = 4; // to each side, at most
const ROUND = [0.5, 1, 2, 5, 10, 20, 25]; // units between two ticks
const section = by("scatter");
const cloud = new PointCloud(by("scatter-cloud"), {
  onPoint: show,
  onPick: (at) => {
    cloud.pin(at);
    show(at);
  },
  onOpen: (at) => at >= 0 && location.assign(page(at)),
  drawBelow: drawAxes,
  radius: 2.5,
});
cloud.tool = "move";
let data = null;
let predictions = null;
let positions = []; // in the session, of the points
let limit = 1; // of the steering that is shown

async function load() {
  const { value: address } = by("scatter-log");
  const isChosen = () => by("scatter-log").value === address;
  try {
    data = new LogData(address);
    predictions = new Predictions(data, { onChange: () => isChosen() && showProgress() });
    await data.load();
    const [, heldOut] = await Promise.all([predictions.choose(section.dataset.run), heldOutRows()]);
    if (isChosen() && predictions.about) draw(heldOut);
  } catch (error) {
    if (isChosen()) by("scatter-words").textContent = error.message;
  }
}

/** The stretches of held-out rows; null if they are unknown. */
async function heldOutRows() {
  const { heldOut } = by("scatter-log").selectedOptions[0].dataset;
  return heldOut ? (await ask(heldOut)).json() : null;
}

function showProgress() {
  by("scatter-words").textContent = predictions.summary;
  by("scatter-stop").hidden = !predictions.isWaiting;
}

function draw(heldOut) {
  const { steering, predicted, row } = data.columns;
  positions = Array.from(steering.keys()).filter((at) => Number.isFinite(steering[at]) && Number.isFinite(predicted[at]));
  const isHeldOut = (at) => heldOut?.some(([first, last]) => first <= row[at] && row[at] <= last) ?? false;
  const colourOf = Uint8Array.from(positions, (at) => (!heldOut || isHeldOut(at) ? 1 : 0));
  limit = positions.reduce((most, at) => Math.max(most, Math.abs(steering[at]), Math.abs(predicted[at])), 0.1);
  cloud.show(Float32Array.from(positions, (at) => steering[at]), Float32Array.from(positions, (at) => -predicted[at]));
  cloud.limit(-limit, limit, -limit, limit);
  cloud.colour(["--series-0", "--series-1"].map(colourReader(section)), colourOf);
  by("scatter-legend").hidden = !heldOut;
  by("scatter-and-picture").hidden = false;
  section.dataset.shown = positions.length; // for scripts that wait for it
}

const angle = (share, digits = 1) => {
  const { max_deg: maxDeg } = predictions.about;
  const text = maxDeg === null ? `${Math.round(100 * share)} %` : `${(share * maxDeg).toFixed(digits)}°`;
  return text.replace(/^-(0\.?0*[° ])/, "$1");
};

/** Both axes, and the line on which predicted and driven steering are equal. */
function drawAxes(context, place, { width, height }) {
  if (!predictions?.about) return;
  const colour = colourReader(section);
  context.font = getComputedStyle(section).font;
  const line = (from, to, stroke) => {
    context.strokeStyle = colour(stroke);
    context.beginPath();
    context.moveTo(...place(...from));
    context.lineTo(...place(...to));
    context.stroke();
  };
  line([-limit, 0], [limit, 0], "--line");
  line([0, -limit], [0, limit], "--line");
  line([-limit, limit], [limit, -limit], "--dim");
  context.fillStyle = colour("--dim");
  const [zeroX, zeroY] = place(0, 0);
  const unit = predictions.about.max_deg ?? 100;
  const step = (ROUND.find((units) => units * TICKS >= limit * unit) ?? ROUND.at(-1)) / unit;
  for (let share = -step * TICKS; share <= limit; share += step) {
    if (Math.abs(share) < step / 2 || share < -limit) continue;
    const [x, y] = place(share, -share);
    context.fillText(angle(share, 0), x - 10, Math.min(Math.max(zeroY + 14, 14), height - 4));
    context.fillText(angle(share, 0), Math.min(Math.max(zeroX + 4, 4), width - 40), y + 4);
  }
  context.fillText("driven →", width - 64, Math.min(Math.max(zeroY - 6, 14), height - 4));
  context.fillText("predicted ↑", Math.min(Math.max(zeroX + 4, 4), width - 70), 14);
}

function page(at) {
  return `${data.address}#row=${data.columns.row[positions[at]]}&run=${section.dataset.run}`;
}

function show(at) {
  const shown = at < 0 ? cloud.pinned : at;
  if (shown < 0) return;
  const { row, steering, predicted } = data.columns;
  const position = positions[shown];
  const [picture] = by("scatter-under").children;
  picture.hidden = false;
  picture.src = `${data.address}/pictures/center/${row[position]}?v=${data.state.version}`;
  const words = `row ${row[position]}: ${angle(predicted[position])} predicted, ${angle(steering[position])} driven · `;
  by("scatter-under-words").replaceChildren(words, make("a", { href: page(shown) }, "open"));
}

by("scatter-show").addEventListener("click", load);
by("scatter-log").addEventListener("change", () => predictions && load());
by("scatter-stop").addEventListener("click", () =>
  predictions.stop().then(showProgress, (error) => showStatus(error.message)),
);
