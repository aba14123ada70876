// The road from above, and the car on it. North is up.

const EDGE = 0.06; // of the longer side
const NAMESPACE = "http://www.w3.org/2000/svg";

export class RoadMap {
  #svg;
  #car = null;
  #scale = 1;

  constructor(svg) {
    this.#svg = svg;
  }

  /** The edges of a road, lists of [x, y] in metres; null for none. */
  show(road) {
    this.#svg.replaceChildren();
    this.#svg.closest("figure").hidden = !road;
    this.#car = null;
    if (!road) return;
    const points = [...road.left, ...road.right];
    const [left, right] = range(points.map(([x]) => x));
    const [bottom, top] = range(points.map(([, y]) => y));
    const size = Math.max(right - left, top - bottom, 1);
    const edge = EDGE * size;
    this.#svg.setAttribute("viewBox", [left - edge, -top - edge, right - left + 2 * edge, top - bottom + 2 * edge].join(" "));
    const ring = (line) => `M${line.map(([x, y]) => `${x},${-y}`).join("L")}${road.closed ? "Z" : ""}`;
    const surface = road.closed ? ring(road.left) + ring(road.right) : ring([...road.left, ...road.right.toReversed()]) + "Z";
    this.#add("path", { class: "road", d: surface, "fill-rule": "evenodd" });
    this.#car = this.#add("path", { class: "car", d: "M4,0L-3,-2.6L-1.6,0L-3,2.6Z", visibility: "hidden" });
    this.#scale = size / 75;
  }

  /** The car's place and heading, counter-clockwise from +x; hidden where they are unknown. */
  move({ x, y, heading_rad }) {
    const isThere = [x, y, heading_rad].every(Number.isFinite);
    this.#car?.setAttribute("visibility", isThere ? "visible" : "hidden");
    if (!isThere) return;
    const turn = (-heading_rad * 180) / Math.PI;
    this.#car?.setAttribute("transform", `translate(${x},${-y}) rotate(${turn}) scale(${this.#scale})`);
  }

  #add(name, attributes) {
    const element = document.createElementNS(NAMESPACE, name);
    for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
    this.#svg.append(element);
    return element;
  }
}

function range(values) {
  return [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
}
