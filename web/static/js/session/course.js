// The course of a drive: who drove, predicted and sent steering, the car's places, and the events.

import { colourReader, make } from "../dom.js";
import { fittedContext } from "./bands.js";

const LINES = ["network", "sent", "expert"];
const BEFORE_S = 2; // of an intervention
const LATE_ROWS = 5;
/** By their numbers in a log: class in the style sheet, name, and colour. */
export const DRIVERS = [
  ["unknown", "unknown", "--series-5"], ["pilot", "network", "--series-1"], ["human", "person", "--series-0"],
  ["expert", "expert", "--series-3"], ["brake", "braked", "--series-4"],
];

export class Course {
  constructor(data) {
    Object.assign(this, { data, columns: null, road: null, events: [], interventions: [], stretches: [] });
  }

  update() {
    const { columns, state } = this.data;
    this.columns = columns;
    for (const name of LINES) if (!columns[name].some(Number.isFinite)) delete columns[name];
    this.road = state.course.road;
    this.events = state.course.events.map((event) => ({ ...event, position: this.data.position(event.row, false) }));
    this.interventions = this.events.filter((event) => event.is_intervention).map((event) => this.stretchOf(event));
    this.stretches = stretchesOf(columns.driver);
  }

  /** The seconds before an intervention in which the same driver drove, as an odd stretch. */
  stretchOf({ position, text }) {
    const { driven_s: time } = this.data.columns;
    const { driver } = this.columns;
    const isNear = (at) => time[at] <= time[at + 1] && time[position] - time[at] <= BEFORE_S;
    let last = position; // an event may come a few rows after the new driver's first row
    while (last > 0 && position - last < LATE_ROWS && Object.is(driver[last - 1], driver[position])) last -= 1;
    if (Object.is(driver[last - 1], driver[position])) last = position;
    let first = last;
    while (first > 0 && isNear(first - 1) && Object.is(driver[first - 1], driver[last - 1])) first -= 1;
    return { first, last, flags: new Set([text]), causes: [] };
  }

  /** Each driver's share of the rows: [[class, name, share], ...], the largest share first. */
  get shares() {
    const rows = DRIVERS.map(() => 0);
    for (const { driver, first, last } of this.stretches) rows[driver] += last - first + 1;
    const total = rows.reduce((a, b) => a + b, 0);
    return DRIVERS.map(([style, words], at) => [style, words, rows[at] / total])
      .filter(([, , share]) => share > 0)
      .sort((a, b) => b[2] - a[2]);
  }

  hasPlace(at) {
    return Boolean(this.columns) && Number.isFinite(this.columns.x_m[at]);
  }

  /** The place at a position. The heading comes from a place at least a metre before. */
  placeAt(at) {
    const { x_m: x, y_m: y } = this.columns;
    const turn = (from, to) => Math.atan2(y[to] - y[from], x[to] - x[from]);
    const isFar = (other) => Math.hypot(x[at] - x[other], y[at] - y[other]) >= 1;
    let before = at;
    while (before > 0 && at - before < 500 && this.hasPlace(before - 1) && !isFar(before)) before -= 1;
    if (isFar(before)) return { x: x[at], y: y[at], heading_rad: turn(before, at) };
    let after = at; // the car has not moved yet: look ahead
    while (after < x.length - 1 && after - at < 500 && this.hasPlace(after + 1) && !isFar(after)) after += 1;
    return { x: x[at], y: y[at], heading_rad: turn(at, after) };
  }
}

/** The stretches of rows with the same driver. Rows without a command are left out. */
function stretchesOf(driver) {
  const stretches = [];
  for (let at = 0; at < driver.length; at += 1) {
    if (!Number.isFinite(driver[at])) continue;
    const number = DRIVERS[driver[at]] ? driver[at] : 0; // a later version may have more drivers
    const before = stretches.at(-1);
    if (before?.driver === number && before.last === at - 1) before.last = at;
    else stretches.push({ driver: number, first: at, last: at });
  }
  return stretches;
}

/** A band below the curves that shows who drove. */
export class DriverBand {
  constructor(figure, course, curves) {
    Object.assign(this, { figure, course, curves, canvas: figure.querySelector("canvas") });
    curves.watch(() => this.draw());
  }

  show() {
    const { shares } = this.course;
    this.figure.hidden = !shares.length;
    const words = shares.map(([style, name, share]) => make("span", { className: `by-${style}` }, `${name} ${percent(share)}`));
    this.figure.querySelector("figcaption").replaceChildren("who drove: ", ...words);
    this.draw();
  }

  draw() {
    const { canvas } = this;
    const [plot] = this.curves.plots;
    if (this.figure.hidden || !plot) return;
    const context = fittedContext(canvas, plot);
    const color = colourReader(canvas);
    const { min, max } = plot.scales.x;
    const across = (at) => ((at - min) / (max - min)) * canvas.width;
    for (const { driver, first, last } of this.course.stretches) {
      if (last < min - 1 || first > max + 1) continue;
      const left = across(first - 0.5);
      context.fillStyle = color(DRIVERS[driver][2]);
      context.fillRect(left, 0, Math.max(across(last + 0.5) - left, devicePixelRatio), canvas.height);
    }
  }
}

function percent(share) {
  const whole = Math.round(share * 100);
  return whole > 0 && (whole < 100 || share === 1) ? `${whole} %` : `${(share * 100).toFixed(1)} %`;
}
