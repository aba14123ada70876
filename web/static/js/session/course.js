// The course of a drive: who drove, the predicted and the sent steering, the car's places, and the events.

const LINES = ["network", "sent", "expert"];
const BEFORE_S = 2; // of an intervention: what led to it
const LATE_ROWS = 5;
/** By their numbers in a log: the class of the style sheet, the name that is read, and the colour. */
export const DRIVERS = [
  ["unknown", "unknown", "--series-5"], ["pilot", "network", "--series-1"], ["human", "person", "--series-0"],
  ["expert", "expert", "--series-3"], ["brake", "braked", "--series-4"],
];

export class Course {
  constructor(data) {
    Object.assign(this, { data, columns: null, road: null, events: [], interventions: [], stretches: [] });
  }

  /** The page's data has other rows. */
  update() {
    const { columns, state } = this.data;
    this.columns = columns;
    for (const name of LINES) if (!columns[name].some(Number.isFinite)) delete columns[name];
    this.road = state.course.road;
    this.events = state.course.events.map((event) => ({ ...event, position: this.data.position(event.row, false) }));
    this.interventions = this.events.filter((event) => event.is_intervention).map((event) => this.stretchOf(event));
    this.stretches = stretchesOf(columns.driver);
  }

  /** What led to an intervention, as an odd stretch: the seconds before it that the same one drove. */
  stretchOf({ position, text }) {
    const { driven_s: time } = this.data.columns;
    const { driver } = this.columns;
    const isNear = (at) => time[at] <= time[at + 1] && time[position] - time[at] <= BEFORE_S;
    let last = position; // an event may be a few rows behind the first that somebody else drove
    while (last > 0 && position - last < LATE_ROWS && Object.is(driver[last - 1], driver[position])) last -= 1;
    if (Object.is(driver[last - 1], driver[position])) last = position;
    let first = last;
    while (first > 0 && isNear(first - 1) && Object.is(driver[first - 1], driver[last - 1])) first -= 1;
    return { first, last, flags: new Set([text]), causes: [] };
  }

  /** The share of the rows that each drove: [[name of the style, words, share], ...], the most first. */
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

  /** The place at a position, and the heading: where the car came from, a metre before at least. */
  placeAt(at) {
    const { x_m: x, y_m: y } = this.columns;
    const turn = (from, to) => Math.atan2(y[to] - y[from], x[to] - x[from]);
    const isFar = (other) => Math.hypot(x[at] - x[other], y[at] - y[other]) >= 1;
    let before = at;
    while (before > 0 && at - before < 500 && this.hasPlace(before - 1) && !isFar(before)) before -= 1;
    if (isFar(before)) return { x: x[at], y: y[at], heading_rad: turn(before, at) };
    let after = at; // it has not moved yet: where it goes
    while (after < x.length - 1 && after - at < 500 && this.hasPlace(after + 1) && !isFar(after)) after += 1;
    return { x: x[at], y: y[at], heading_rad: turn(at, after) };
  }
}

/** Rows one after the other that the same one drove; rows without a command are nobody's. */
function stretchesOf(driver) {
  const found = [];
  for (let at = 0; at < driver.length; at += 1) {
    if (!Number.isFinite(driver[at])) continue;
    const number = DRIVERS[driver[at]] ? driver[at] : 0; // a later version may know more
    const before = found.at(-1);
    if (before?.driver === number && before.last === at - 1) before.last = at;
    else found.push({ driver: number, first: at, last: at });
  }
  return found;
}
