// Pictures of many stretches below each other, to be looked at before all of them are tagged. A stretch whose box is
// unticked is no longer among them.

import { make, number } from "./dom.js";

const MOST = 200; // stretches
const PICTURES = 96; // of all of them, and of one
const OF_ONE = [3, 48];

/** The numbers from `first` to `last`, or as many of them, evenly spread, as one of so many stretches has pictures. */
export function spread(first, last, stretches) {
  const most = Math.min(Math.max(Math.floor(PICTURES / stretches), OF_ONE[0]), OF_ONE[1]);
  const count = Math.min(last - first + 1, most);
  return Array.from({ length: count }, (_, at) => Math.round(first + ((last - first) * at) / Math.max(count - 1, 1)));
}

/** `stretches`: [{ title, href, pictures: [{ address, title, pick }] }]; `onChange(numbers)`: those that are ticked. */
export function fillGrid(element, stretches, onChange) {
  const lines = stretches.slice(0, MOST).map(({ title, href, pictures }) => {
    const line = make("li", {}, make("label", {}, make("input", { type: "checkbox", checked: true }), ` ${title}`));
    if (href) line.append(" ", make("a", { href }, "show"));
    line.append(make("div", { className: "shots" }, ...pictures.map(shot)));
    return line;
  });
  element.onchange = () => onChange([...element.querySelectorAll("input")].map((box) => box.checked));
  if (stretches.length > MOST) lines.push(make("li", {}, `and ${number(stretches.length - MOST)} more, also selected`));
  element.replaceChildren(...lines);
}

function shot({ address, title, pick }) {
  const image = make("img", { src: address, alt: title, title, loading: "lazy", width: 160, height: 80, onclick: pick ?? null });
  image.addEventListener("error", () => image.classList.add("missing"));
  return image;
}
