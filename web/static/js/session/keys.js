// The keys of a page. In a text field, they are letters.

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
