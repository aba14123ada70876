// The road from above, and the car on it. North is up.

const EDGE = 0.06; // of the longer side
const NAMESPACE = "http://www.w3.org/2000/svg";

export class RoadMap {
  #svg;
  #car = null;

  constructor(svg) {
    this.#svg = svg;
  }

  /** Show a road by its edges (lists of [x, y] in metres), or null. The map also has room for these places. */
  show(road, places = []) {
    this.#svg.replaceChildren();
    const points = [...places, ...(road ? [...road.left, ...road.right] : [])];
    this.#svg.closest("figure").hidden = !points.length;
    this.#car = null;
    if (!points.length) return;
    const [left, right] = range(points.map(([x]) => x));
    const [bottom, top] = range(points.map(([, y]) => y));
    this.size = Math.max(right - left, top - bottom, 1);
    const edge = EDGE * this.size;
    this.box = { x: left - edge, y: -top - edge, width: right - left + 2 * edge, height: top - bottom + 2 * edge };
    this.#svg.setAttribute("viewBox", Object.values(this.box).join(" "));
    if (road) {
      const ring = (line) => `M${line.map(([x, y]) => `${x},${-y}`).join("L")}${road.closed ? "Z" : ""}`;
      const surface = road.closed ? ring(road.left) + ring(road.right) : ring([...road.left, ...road.right.toReversed()]) + "Z";
      this.add("path", { class: "road", d: surface, "fill-rule": "evenodd" });
    }
    this.#car = this.add("path", { class: "car", d: "M4,0L-3,-2.6L-1.6,0L-3,2.6Z", visibility: "hidden" });
  }

  /** Move the car to a place and heading (counter-clockwise from +x); hide it if they are unknown. */
  move({ x, y, heading_rad }) {
    const isKnown = [x, y, heading_rad].every(Number.isFinite);
    this.#car?.setAttribute("visibility", isKnown ? "visible" : "hidden");
    if (isKnown) this.#car?.setAttribute("transform", this.placed(x, y, heading_rad));
  }

  /** The transform of a mark with a size of about ten units. */
  placed(x, y, heading_rad) {
    return `translate(${x},${-y}) rotate(${(-heading_rad * 180) / Math.PI}) scale(${this.size / 75})`;
  }

  add(name, attributes, parent = this.#svg) {
    const element = document.createElementNS(NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    parent.insertBefore(element, parent === this.#svg ? this.#car : null);
    return element;
  }
}

function range(values) {
  return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
}
