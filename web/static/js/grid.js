// Pictures of many stretches, to look at before all stretches are tagged. Unticking a stretch leaves it out.

import { make, number } from "./dom.js";

const MAX_STRETCHES = 200;
const PICTURES = 96; // of all stretches
const PER_STRETCH = [3, 48]; // at least, at most

/** The numbers of the pictures to show, evenly spread from `first` to `last`, of one of so many stretches. */
export function spread(first, last, stretches) {
  const limit = Math.min(Math.max(Math.floor(PICTURES / stretches), PER_STRETCH[0]), PER_STRETCH[1]);
  const count = Math.min(last - first + 1, limit);
  return Array.from({ length: count }, (_, at) => Math.round(first + ((last - first) * at) / Math.max(count - 1, 1)));
}

/** `stretches`: [{ title, href, pictures: [{ address, title, pick }] }]; `onChange` gets whether each is ticked. */
export function fillGrid(element, stretches, onChange) {
  const lines = stretches.slice(0, MAX_STRETCHES).map(({ title, href, pictures }) => {
    const line = make("li", {}, make("label", {}, make("input", { type: "checkbox", checked: true }), ` ${title}`));
    if (href) line.append(" ", make("a", { href }, "show"));
    line.append(make("div", { className: "shots" }, ...pictures.map(shot)));
    return line;
  });
  element.onchange = () => onChange([...element.querySelectorAll("input")].map((box) => box.checked));
  if (stretches.length > MAX_STRETCHES) lines.push(make("li", {}, `and ${number(stretches.length - MAX_STRETCHES)} more, also selected`));
  element.replaceChildren(...lines);
}

function shot({ address, title, pick }) {
  const image = make("img", { src: address, alt: title, title, loading: "lazy", width: 160, height: 80, onclick: pick ?? null });
  image.addEventListener("error", () => image.classList.add("missing"));
  return image;
}
