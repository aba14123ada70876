// Elements and keys of a page; numbers, times and steering as text.

export const by = (id) => document.getElementById(id);
export const number = (value) => value.toLocaleString("en");

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

/** Show a problem; "" hides it. The backticks around its commands are left out. */
export function showProblem(text) {
  by("problem").textContent = text.replaceAll("`", "");
  by("problem").hidden = !text;
}

/** The reason in an error of the server; its status if the answer is not the workbench's. */
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

/** A function that resolves colours of the style sheet for a canvas: a property may be `light-dark(...)`. */
export function colourReader(element) {
  const style = getComputedStyle(element);
  return (name) => {
    const before = element.style.color;
    element.style.color = `var(${name})`;
    const resolved = style.color;
    element.style.color = before;
    return resolved;
  };
}

/** Call the actions of keys. In a text field, keys are letters. */
export function listen(actions) {
  document.addEventListener("keydown", (event) => {
    const isTyping = event.target.matches("input, select, textarea");
    if (event.key === "Escape" && isTyping) {
      event.target.blur();
      return;
    }
    if (isTyping || event.altKey) return;
    const name = event.ctrlKey || event.metaKey ? withControl(event) : event.key;
    if (name === " " && event.target.matches("button, summary, a")) return; // the key presses it
    const action = actions[name];
    if (!action) return;
    event.preventDefault();
    action(event);
  });
}

function withControl(event) {
  const key = event.key.toLowerCase();
  if (key === "z") return event.shiftKey ? "redo" : "undo";
  return key === "y" ? "redo" : "";
}

/** Seconds as 1:02.3, or 1:00:02.3 from an hour on. */
export function clock(seconds) {
  const tenths = Math.round(seconds * 10);
  const minutes = Math.floor(tenths / 600);
  const rest = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return minutes < 60
    ? `${minutes}:${rest}`
    : `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}

/** Steering (-1 to 1) in degrees; in shares of full lock if the angle at 1 is unknown (null). */
export function angle(steering, maxDeg, digits = 1) {
  return maxDeg === null ? `${(steering * 100).toFixed(digits)} %` : `${(steering * maxDeg).toFixed(digits)}°`;
}
