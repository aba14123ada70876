// The curves over the rows of a session, in two plots that zoom and point together. The horizontal axis has rows, not
// seconds, so that long pauses take no room. Its labels are times.

import uPlot from "../../vendor/uPlot.esm.js";
import { angle, clock, colourReader, make } from "../dom.js";
import { drawBands } from "./bands.js";

const MIN_WINDOW = 800; // pixels
const MIN_ROWS = 10; // in view
const AXIS_WIDTH = 46;
const MIN_TICK = 90; // pixels between two times
const STEPS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200];
const ANGLES_DEG = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
const BLANK = { values: () => [], ticks: { show: false } }; // as wide as the axis of the other plot
const PLOTS = [
  { share: 0.24, scales: { y: [-1.05, 1.05] }, lines: [
    ["steering", "y", "--series-0"], ["sent", "y", "--series-2"], ["expert", "y", "--series-3"], ["network", "y", "--series-1"],
    ["predicted", "y", "--predicted"],
  ] },
  {
    share: 0.16,
    scales: { pedal: [0, 1.05], mph: null },
    lines: [["throttle", "pedal", "--series-2"], ["brake", "pedal", "--series-4"], ["speed_mph", "mph", "--series-3"]],
  },
];
const NAMES = {
  steering: "steering (right is up)", sent: "sent", expert: "the expert's", network: "the network's", predicted: "predicted",
  throttle: "throttle", brake: "brake", speed_mph: "speed, mph",
};

export class Curves {
  /** `onMove(position)`: the mouse points there. `onSelect({first, last})`: the mouse was dragged over a stretch.
   * `onClick(position, event)`. */
  constructor(element, data, { onMove, onSelect, onClick }) {
    Object.assign(this, { element, data, onMove, onSelect, onClick });
    this.plots = [];
    this.odd = [];
    this.selection = [];
    this.view = null;
    this.position = 0;
    this.watchers = [];
    new ResizeObserver(() => this.resize()).observe(element);
    addEventListener("resize", () => this.resize());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.build());
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  /** Call `call` whenever the visible rows, the width or the bands change. */
  watch(call) {
    this.watchers.push(call);
  }

  changed() {
    for (const call of this.watchers) call();
  }

  /** Draw the present data. The view stays. */
  build() {
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    if (!this.data.length) return;
    const color = colourReader(this.element);
    this.colors = {
      notLearnt: color("--dim"), odd: color("--odd-band"), oddBack: color("--odd-band-back"), tag: color("--tag-band"),
      break: color("--dim"), exclude: color("--exclude-band"), excludeBack: color("--exclude-band-back"), selection: color("--selection"),
      outside: color("--outside"), steering: color("--series-0"),
    };
    const x = Float64Array.from({ length: this.data.length }, (_, at) => at);
    this.plots = PLOTS.map((plot) => this.makePlot(plot, x, color));
    this.markers = this.plots.map((plot) => plot.over.appendChild(make("div", { className: "now-line" })));
    const view = this.view ?? { min: 0, max: this.data.length - 1 };
    this.show(view.min, view.max);
    this.point(this.position);
  }

  makePlot({ share, scales, lines: all }, x, color) {
    const columns = this.data.columns;
    const lines = all.filter(([name]) => columns[name]); // nothing is predicted without a run
    const text = color("--text");
    const grid = { stroke: color("--line"), width: 1 };
    const axis = (more) => ({ stroke: text, grid, ticks: grid, size: AXIS_WIDTH, font: "11px system-ui", ...more });
    const names = Object.keys(scales);
    const values = lines.map(([name]) => Array.from(columns[name], (value) => (Number.isFinite(value) ? value : null)));
    const plot = new uPlot(
      {
        width: this.element.clientWidth,
        height: this.heightOf(share),
        legend: { show: false },
        cursor: {
          x: false, y: false, points: { show: false }, sync: { key: "session" },
          drag: { x: true, y: false, setScale: false, dist: 4 },
          bind: { dblclick: () => () => this.show(0, this.data.length - 1) },
        },
        scales: {
          x: { time: false, range: (_, min, max) => [min, max] },
          ...Object.fromEntries(
            Object.entries(scales).map(([name, range]) => [name, { range: range ?? [0, highest(columns.speed_mph)] }]),
          ),
        },
        axes: [
          axis({
            size: 24,
            splits: (drawn, _, min, max) => this.roundTimes(min, max, drawn.bbox.width / devicePixelRatio / MIN_TICK),
            values: (_, splits) => splits.map((at) => this.roundTime(at)),
          }),
          axis(names[0] === "y" ? { scale: "y", ...this.roundAngles() } : { scale: names[0] }),
          axis({ scale: names[1] ?? names[0], side: 1, grid: { show: false }, ...(names[1] ? {} : BLANK) }),
        ],
        series: [{}, ...lines.map(([name, scale, variable]) => ({
          label: NAMES[name], scale, stroke: color(variable), width: 1.5, points: { show: false }, spanGaps: false,
        }))],
        hooks: {
          drawClear: [(drawn) => drawBands(drawn, this.data, this.odd, this.selection, this.colors)],
          setCursor: [(moved) => this.moved(moved)],
          setSelect: [(dragged) => this.selected(dragged)],
        },
      },
      [x, ...values],
      this.element,
    );
    plot.over.append(make("div", { className: "key" }, ...lines.map(([name]) => make("span", { className: name }, NAMES[name]))));
    // uPlot suppresses the click after a drag
    plot.over.addEventListener("click", (event) => this.onClick(this.clamped(Math.round(plot.posToVal(event.offsetX, "x"))), event));
    return plot;
  }

  /** Grid lines at round angles, in degrees or in shares of full lock. */
  roundAngles() {
    const maxDeg = this.data.state.max_steering_deg;
    const step = maxDeg === null ? 0.5 : ANGLES_DEG.find((angle_deg) => maxDeg / angle_deg < 3) / maxDeg;
    const lines = Math.floor(1 / step + 1e-6); // to each side
    return {
      splits: () => Array.from({ length: 2 * lines + 1 }, (_, at) => (at - lines) * step),
      values: (_, splits) => splits.map((at) => angle(at, maxDeg, 0)),
    };
  }

  /** At most `maxCount` positions at round times of driving. */
  roundTimes(min, max, maxCount) {
    const times = this.data.columns.driven_s;
    const [begin, end] = [Math.ceil(min), Math.floor(max)].map((at) => times[this.clamped(at)]);
    const step = (this.tickS = STEPS_S.find((step_s) => (end - begin) / step_s <= maxCount) ?? STEPS_S.at(-1));
    const positions = [];
    for (let at = this.clamped(Math.ceil(min)), next = Math.ceil(begin / step); at <= max && at < times.length; at += 1) {
      if (times[at] < next * step - 1e-6) continue;
      positions.push(at);
      next = Math.floor(times[at] / step + 1e-6) + 1;
    }
    return positions;
  }

  roundTime(at) {
    const seconds = Math.floor(this.data.columns.driven_s[at] / this.tickS + 1e-6) * this.tickS;
    return this.tickS < 1 ? clock(seconds) : clock(seconds).replace(/\.0$/, "");
  }

  moved(plot) {
    const { left } = plot.cursor;
    if (left < 0 || !plot.over.matches(":hover")) return; // the mouse is over the other plot
    this.onMove(this.clamped(Math.round(plot.posToVal(left, "x"))));
  }

  selected(plot) {
    const { left, width } = plot.select;
    if (!width) return;
    const isHere = plot.over.matches(":hover, :active"); // else the mouse was dragged over the other plot
    for (const drawn of isHere ? this.plots : [plot]) drawn.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    const [first, last] = [left, left + width].map((at) => this.clamped(Math.round(plot.posToVal(at, "x"))));
    if (isHere) this.onSelect({ first, last });
  }

  clamped(position) {
    return Math.max(0, Math.min(this.data.length - 1, position));
  }

  wheel(event) {
    if (!this.plots.length) return;
    event.preventDefault();
    const { min, max } = this.plots[0].scales.x;
    const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
    if (Math.abs(sideways) > Math.abs(event.shiftKey ? 0 : event.deltaY)) {
      this.pan((sideways / 1000) * (max - min));
      return;
    }
    const box = this.plots[0].over.getBoundingClientRect();
    this.zoom(Math.exp(event.deltaY / 500), min + ((event.clientX - box.left) / box.width) * (max - min));
  }

  /** Show `factor` times as many rows; `center` stays in place. */
  zoom(factor, center = this.position) {
    if (!this.plots.length) return; // a log without rows
    const { min, max } = this.plots[0].scales.x;
    const size = Math.min(Math.max((max - min) * factor, MIN_ROWS), this.data.length - 1);
    const share = max > min ? (center - min) / (max - min) : 0.5;
    this.show(center - share * size, center - share * size + size);
  }

  pan(rows) {
    if (!this.plots.length) return; // a log without rows
    const { min, max } = this.plots[0].scales.x;
    this.show(min + rows, max + rows);
  }

  /** Show these rows, or as many rows at the nearer end. */
  show(min, max) {
    if (!this.plots.length) return; // a log without rows
    const end = Math.max(this.data.length - 1, 1);
    const size = Math.min(max - min, end) || 1;
    const from = Math.max(0, Math.min(min, end - size));
    this.view = size < end ? { min: from, max: from + size } : null; // the whole log, also when it grows
    const visible = { min: from, max: from + size };
    for (const plot of this.plots) plot.batch(() => plot.setScale("x", visible)); // at once, for the markers
    this.placeMarkers();
    this.changed();
  }

  /** Bring a position into view. The zoom stays. */
  follow(position) {
    const { min, max } = this.view ?? { min: 0, max: Infinity };
    if (position < min || position > max) this.pan(position - (min + max) / 2);
  }

  /** Bring a stretch into view, with as many rows on either side. */
  reveal({ first, last }) {
    if (!this.plots.length) return; // a log without rows
    const { min, max } = this.plots[0].scales.x;
    const length = last - first + 1;
    if (first >= min && last <= max && length > (max - min) / 60) return;
    const size = Math.max(length * 3, Math.min(300, this.data.length - 1));
    const middle = (first + last) / 2;
    this.show(middle - size / 2, middle + size / 2);
  }

  point(position) {
    this.position = this.clamped(position);
    this.placeMarkers();
  }

  placeMarkers() {
    this.plots.forEach((plot, at) => {
      const left = plot.valToPos(this.position, "x");
      this.markers[at].style.transform = `translateX(${left}px)`;
      this.markers[at].hidden = left < 0 || left > plot.bbox.width / devicePixelRatio;
    });
  }

  mark({ odd = this.odd, selection = this.selection }) {
    this.odd = odd;
    this.selection = selection;
    for (const plot of this.plots) plot.redraw(false);
    this.changed();
  }

  /** A plot's height in pixels, by the window's height; small while Rerun is open. */
  heightOf(share) {
    const isSmall = this.element.closest(".in-rerun");
    return Math.round(share * (isSmall ? MIN_WINDOW : Math.max(innerHeight, MIN_WINDOW)));
  }

  resize() {
    this.plots.forEach((plot, at) => plot.setSize({ width: this.element.clientWidth, height: this.heightOf(PLOTS[at].share) }));
    this.placeMarkers();
    this.changed();
  }
}

function highest(speeds) {
  let top = 1;
  for (const speed of speeds) if (speed > top && speed < 1000) top = speed;
  return top * 1.05;
}
