// The curves of runs over each other. They are drawn again when another run is chosen, or a training goes on.

import { by, colourReader, make } from "../dom.js";
import { showStatus } from "../live.js";
import uPlot from "../../vendor/uPlot.esm.js";

const HEIGHT = 240;
const EPOCHS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000]; // between two ticks
const COLORS = 8;
const DASHES = [[], [6, 4], [2, 3]];
const LEGEND_DASHES = ["solid", "dashed", "dotted"];
const PLOTS = [
  ["Loss", (line) => line.endsWith("loss")],
  ["Errors, as shares of the mean's errors", (line) => line.includes("RMSE")],
  ["Correlation with recorded steering", (line) => line === "correlation"],
];
const section = by("plots");
let plots = [];
let shown = "";

function query() {
  if (section.dataset.run) return new URLSearchParams({ run: section.dataset.run });
  const chosen = new FormData(by(section.dataset.form)).getAll("run");
  return new URLSearchParams(chosen.map((key) => ["run", key]));
}

async function load() {
  const chosen = query();
  const answer = await fetch(`/runs.curves?${chosen}`);
  if (!answer.ok) {
    showStatus(`no curves: the server answers ${answer.status}`);
    return;
  }
  const runs = await answer.json();
  const text = JSON.stringify(runs);
  if (text === shown) return;
  shown = text;
  draw(runs);
}

function draw(runs) {
  for (const plot of plots) plot.destroy();
  plots = [];
  const color = colourReader(section);
  section.replaceChildren();
  for (const [title, isOf] of PLOTS) {
    const tables = [];
    const series = [{ label: "epoch", value: (_, value) => (value === null ? "" : value.toFixed(2)) }];
    runs.forEach((run) => {
      const names = Object.keys(run.lines).filter(isOf);
      names.forEach((name, at) => {
        const [x, y] = run.lines[name];
        if (!y.some((value) => value !== null)) return;
        tables.push([x, y]);
        series.push({
          label: [runs.length > 1 && run.name, names.length > 1 && name].filter(Boolean).join(": ") || name,
          // one run: a colour for each line; several runs: a colour for each run
          stroke: color(`--series-${runs.length > 1 ? run.colour : at % COLORS}`),
          dash: runs.length > 1 ? DASHES[at % DASHES.length] : [],
          width: 1.5,
          spanGaps: true,
          points: { show: x.length < 2 },
          value: (_, value) => (value === null || value === undefined ? "" : value.toPrecision(3)),
        });
      });
    });
    if (!tables.some(([x]) => x.length > 1)) continue; // a single epoch is no curve
    const figure = section.appendChild(make("div", {}, make("h2", {}, title)));
    const axis = { stroke: color("--text"), grid: { stroke: color("--line"), width: 1 }, ticks: { stroke: color("--line") } };
    plots.push(
      new uPlot(
        {
          width: figure.clientWidth,
          height: HEIGHT,
          scales: { x: { time: false } },
          axes: [{ ...axis, incrs: EPOCHS, label: "epoch", labelSize: 18, size: 32 }, { ...axis, size: 56 }],
          series,
          legend: { markers: { dash: (plot, at) => LEGEND_DASHES[DASHES.findIndex((dash) => `${dash}` === `${plot.series[at].dash ?? []}`)] ?? "solid" } },
          cursor: { sync: { key: "runs" } },
        },
        uPlot.join(tables),
        figure,
      ),
    );
  }
  section.dataset.shown = runs.map((run) => run.key).join(" "); // for scripts that wait for it
}

new ResizeObserver(() => {
  for (const plot of plots) plot.setSize({ width: plot.root.parentElement.clientWidth, height: HEIGHT });
}).observe(section);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
  shown = "";
  load();
});
document.body.addEventListener("folders-changed", load);
by(section.dataset.form)?.addEventListener("input", load);
load();
