// Elements: those of a page by their ids, and new ones.

export const by = (id) => document.getElementById(id);
export const number = (value) => value.toLocaleString("en");

/** A new element with these properties and children. */
export function make(kind, properties = {}, ...children) {
  const made = Object.assign(document.createElement(kind), properties);
  made.append(...children);
  return made;
}

export function button(text, onClick, properties = {}) {
  const made = make("button", { type: "button", ...properties }, text);
  made.addEventListener("click", onClick);
  return made;
}

/** Show a text in an element that is hidden without one. */
export function showProblem(text) {
  by("problem").textContent = text;
  by("problem").hidden = !text;
}

/** Why the server refuses, in its own words; of an answer that is not the workbench's, its status. */
export function reasonIn(text, status) {
  try {
    return JSON.parse(text).error ?? `the server answers ${status}`;
  } catch {
    return `the server answers ${status}`;
  }
}

export function toggleHelp() {
  const isHidden = (by("help").hidden = !by("help").hidden);
  by("help-button").setAttribute("aria-expanded", !isHidden);
}

/** The colours of the style sheet as a canvas understands them: a property may hold `light-dark(...)`. */
export function colourReader(element) {
  const style = getComputedStyle(element);
  return (name) => {
    const before = element.style.color;
    element.style.color = `var(${name})`;
    const found = style.color;
    element.style.color = before;
    return found;
  };
}
