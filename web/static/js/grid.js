// Pictures of many stretches below each other, to be looked at before all of them are tagged. A stretch whose box is
// unticked is no longer among them.

const MOST = 200; // stretches
const PICTURES = 96; // of all of them, and of one
const OF_ONE = [3, 48];

/** Numbers of pictures for stretches of these lengths in rows: a row's is shown at most once. */
export function picturesOf(rows, stretches) {
  const most = Math.min(Math.max(Math.floor(PICTURES / stretches), OF_ONE[0]), OF_ONE[1]);
  return Math.min(rows, most);
}

/** `stretches`: [{ title, href, pictures: [{ address, title, pick }] }]; `onChange(numbers)`: those that are ticked. */
export function fillGrid(element, stretches, onChange) {
  const boxes = [];
  const lines = stretches.slice(0, MOST).map(({ title, href, pictures }) => {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: true });
    box.addEventListener("change", () => onChange(boxes.map((each) => each.checked)));
    boxes.push(box);
    const label = document.createElement("label");
    label.append(box, ` ${title}`);
    const line = document.createElement("li");
    line.append(label);
    if (href) line.append(" ", Object.assign(document.createElement("a"), { href, textContent: "show" }));
    const shots = document.createElement("div");
    shots.className = "shots";
    shots.append(...pictures.map(shot));
    line.append(shots);
    return line;
  });
  if (stretches.length > MOST) {
    const rest = document.createElement("li");
    rest.textContent = `and ${(stretches.length - MOST).toLocaleString("en")} more, also selected`;
    lines.push(rest);
  }
  element.replaceChildren(...lines);
}

function shot({ address, title, pick }) {
  const image = Object.assign(document.createElement("img"), { src: address, alt: title, title, loading: "lazy", width: 160, height: 80 });
  image.addEventListener("error", () => image.classList.add("missing"));
  if (pick) image.addEventListener("click", pick);
  return image;
}
