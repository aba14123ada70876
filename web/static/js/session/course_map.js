// The map next to the curves: the road, the path by driver, interventions, start, direction and scale. The mouse points
// at a moment, as over the curves, and shows its picture.

import { clock } from "../dom.js";
import { RoadMap } from "../road_map.js";
import { DRIVERS } from "./course.js";

const MAX_POINTS = 3000;
const ARROWS = 8; // along the path
const MAX_STEP_M = 25; // from one row to the next; farther, the car was put elsewhere
const BAR_SHARE = 1 / 4; // of the map's width, at most
const NEAR = 1 / 25; // of the map's size: within that, the mouse points at the path

export class CourseMap {
  /** `onPoint(position)`: the mouse is near the path there; `onPick(stretch)`: an intervention was chosen. */
  constructor(figure, course, { picture, onPoint, onPick }) {
    Object.assign(this, { figure, course, picture, onPoint, onPick });
    this.svg = figure.querySelector("svg");
    this.hover = figure.querySelector(".under-mouse");
    this.map = new RoadMap(this.svg);
    this.svg.addEventListener("pointermove", (event) => this.point(event));
    this.svg.addEventListener("pointerleave", () => (this.hover.hidden = true));
    picture?.addEventListener("load", () => (this.hover.src = picture.src)); // already loaded
  }

  show() {
    const { course, map } = this;
    const { x_m: x, y_m: y } = course.columns;
    const placed = [];
    const step = Math.ceil(x.length / MAX_POINTS);
    for (let at = 0; at < x.length; at += step) if (course.hasPlace(at)) placed.push(at);
    this.placed = placed; // positions with a place
    const places = placed.map((at) => [x[at], y[at]]);
    map.show(course.road, places);
    if (!places.length) return;
    for (const { driver, first, last } of course.stretches.length ? course.stretches : [{ driver: 0, first: 0, last: x.length - 1 }]) {
      for (const line of this.lines(first, last, step)) {
        map.add("polyline", { class: `path by-${DRIVERS[driver][0]}`, points: line.map((at) => `${x[at]},${-y[at]}`).join(" ") });
      }
    }
    this.showDirection();
    for (const stretch of course.interventions) this.showIntervention(stretch);
    this.showScale();
  }

  /** The positions along a stretch, in lines that end where the car was put elsewhere. */
  lines(first, last, step) {
    const { x_m: x, y_m: y } = this.course.columns;
    const end = Math.min(last + 1, x.length - 1); // where the next stretch begins
    const lines = [[]];
    for (let at = first; at <= end; at = at < end ? Math.min(at + step, end) : end + 1) {
      if (!this.course.hasPlace(at)) continue;
      const before = lines.at(-1).at(-1) ?? at;
      if (Math.hypot(x[at] - x[before], y[at] - y[before]) > MAX_STEP_M * step) lines.push([]);
      lines.at(-1).push(at);
    }
    return lines.filter((line) => line.length > 1);
  }

  showDirection() {
    const { map, placed } = this;
    for (let number = 1; number <= ARROWS; number += 1) {
      const { x, y, heading_rad } = this.course.placeAt(placed[Math.floor(((number - 0.5) / ARROWS) * placed.length)]);
      map.add("path", { class: "direction", d: "M-1.2,-1.4L1.2,0L-1.2,1.4", transform: map.placed(x, y, heading_rad) });
    }
    const { x, y, heading_rad } = this.course.placeAt(placed[0]);
    map.add("path", { class: "start", d: "M0,-3.2L0,3.2", transform: map.placed(x, y, heading_rad) });
    // next to the road, on the inner side of the map
    const { box } = map;
    const toLeft = [-Math.sin(heading_rad) * (map.size / 12), Math.cos(heading_rad) * (map.size / 12)];
    const isInwards = toLeft[0] * (box.x + box.width / 2 - x) + toLeft[1] * (-box.y - box.height / 2 - y) > 0;
    const side = isInwards ? 1 : -1;
    this.text("start", x + side * toLeft[0], -y - side * toLeft[1] + map.size / 60, "start-name");
  }

  showIntervention(stretch) {
    const at = stretch.last;
    if (!this.course.hasPlace(at)) return;
    const { x, y } = this.course.placeAt(at);
    const words = `${clock(this.course.data.columns.driven_s[at])}: ${[...stretch.flags].join(", ")}`;
    const link = this.map.add("a", { href: `#row=${this.course.data.columns.row[at]}`, "aria-label": words });
    link.addEventListener("click", (event) => {
      event.preventDefault();
      this.onPick(stretch);
    });
    const circle = this.map.add("circle", { cx: x, cy: -y, r: this.map.size / 70 }, link);
    this.map.add("title", {}, circle).textContent = words;
  }

  /** A bar of a round length, at the lower left. */
  showScale() {
    const { box } = this.map;
    const most = box.width * BAR_SHARE;
    const power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((times) => times * power).find((metres) => metres <= most);
    const [left, low] = [box.x + box.width * 0.02, box.y + box.height * 0.97];
    this.map.add("path", { class: "scale", d: `M${left},${low}h${length}` });
    this.text(length >= 1 ? `${length} m` : `${length * 100} cm`, left, low - this.map.size / 80, "scale-name");
  }

  text(words, x, y, style) {
    this.map.add("text", { class: style, x, y, "font-size": this.map.size / 24 }).textContent = words;
  }

  move(position) {
    this.position = position;
    if (!this.placed?.length) return;
    this.map.move(this.course.hasPlace(position) ? this.course.placeAt(position) : {});
  }

  point(event) {
    const position = this.nearest(event);
    this.hover.hidden = position === null || !this.hover.src;
    if (position === null) return;
    const box = this.figure.getBoundingClientRect();
    const isRight = event.clientX - box.left > box.width / 2;
    this.hover.style.translate = `calc(${event.clientX - box.left}px ${isRight ? "- 100% - 1rem" : "+ 1rem"}) calc(${event.clientY - box.top}px + 0.5rem)`;
    this.onPoint(position);
  }

  /** The position nearest to the mouse. Of several laps, it is on the lap nearest to the shown moment. */
  nearest(event) {
    const { placed } = this;
    if (!placed?.length) return null;
    const { x_m: x, y_m: y } = this.course.columns;
    const { x: east, y: south } = new DOMPoint(event.clientX, event.clientY).matrixTransform(this.svg.getScreenCTM().inverse());
    const far = (at) => Math.hypot(x[at] - east, y[at] + south);
    const least = placed.reduce((least, at) => Math.min(least, far(at)), Infinity);
    if (least > this.map.size * NEAR) return null;
    const near = placed.filter((at) => far(at) <= least + this.map.size / 150);
    const onLap = near.reduce((best, at) => (Math.abs(at - this.position) < Math.abs(best - this.position) ? at : best));
    let number = placed.indexOf(onLap);
    for (const step of [1, -1]) while (far(placed[number + step]) < far(placed[number])) number += step;
    return placed[number];
  }
}
