// A canvas that is as wide as a plot, and lies under or over it.

/** Fit the canvas to the plot; its context, cleared. */
export function contextBeside(canvas, plot) {
  const scale = devicePixelRatio;
  canvas.style.marginLeft = `${plot.bbox.left / scale}px`;
  canvas.style.width = `${plot.bbox.width / scale}px`;
  canvas.width = plot.bbox.width;
  canvas.height = canvas.clientHeight * scale;
  return canvas.getContext("2d");
}
