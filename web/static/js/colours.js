// The colours of the style sheet as a canvas understands them: a property may hold `light-dark(...)`.

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
