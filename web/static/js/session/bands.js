// The bands behind the curves: excluded rows over the full height, other tags at the top, odd stretches at the bottom,
// the selection over everything, dashed lines where drives begin, hatching where training leaves rows out by default.
// Only visible bands are drawn, and one of many in the same column of pixels.

const LANE = 8;
const HATCH = 6; // pixels between its lines

export function drawBands(plot, data, odd, selection, colors) {
  const { ctx, bbox } = plot;
  const { min, max } = plot.scales.x;
  const lane = LANE * devicePixelRatio;
  const box = { top: bbox.top, height: bbox.height, min, max, across: (at) => plot.valToPos(at, "x", true) };
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  drawTracks(ctx, data, odd, colors, box, lane);
  drawHatched(plot, data.state.not_learnt, colors.notLearnt);
  drawBreaks(plot, data.breaks, colors.break);
  drawAll(ctx, selection, box, [[colors.selection, bbox.top, bbox.height]]);
  ctx.restore();
}

/** Draw odd and tagged stretches in a box of pixels. `across` gives the pixel of a position from `min` to `max`. */
export function drawTracks(ctx, data, odd, colors, box, lane) {
  const whole = [box.top, box.height];
  const excluded = data.tags.filter((tag) => tag.name === "exclude");
  const named = data.tags.filter((tag) => tag.name !== "exclude");
  drawAll(ctx, odd, box, [[colors.oddBack, ...whole], [colors.odd, box.top + box.height - lane, lane]]);
  drawAll(ctx, named, box, [[colors.tag, box.top, lane]]);
  drawAll(ctx, excluded, box, [[colors.excludeBack, ...whole], [colors.exclude, box.top, lane]]);
}

export function drawAll(ctx, stretches, { min, max, across }, rectangles) {
  let reached = -Infinity;
  for (const { first, last } of stretches) {
    if (last < min - 1 || first > max + 1) continue;
    const left = across(first - 0.5);
    const right = Math.max(across(last + 0.5), left + 1);
    if (right <= reached + 0.5) continue;
    for (const [color, top, height] of rectangles) {
      ctx.fillStyle = color;
      ctx.fillRect(Math.max(left, reached), top, right - Math.max(left, reached), height);
    }
    reached = right;
  }
}

function drawHatched(plot, stretches, color) {
  const { ctx, bbox } = plot;
  const step = HATCH * devicePixelRatio;
  ctx.strokeStyle = color;
  ctx.lineWidth = devicePixelRatio;
  for (const [first, last] of stretches) {
    const left = Math.max(plot.valToPos(first - 0.5, "x", true), bbox.left);
    const right = Math.min(plot.valToPos(last + 0.5, "x", true), bbox.left + bbox.width);
    if (right <= left) continue;
    ctx.save();
    ctx.beginPath();
    ctx.rect(left, bbox.top, Math.max(right - left, devicePixelRatio), bbox.height);
    ctx.clip();
    ctx.beginPath();
    for (let at = left - (left % step) - bbox.height; at < right; at += step) {
      ctx.moveTo(at, bbox.top + bbox.height);
      ctx.lineTo(at + bbox.height, bbox.top);
    }
    ctx.stroke();
    ctx.restore();
  }
}

/** A dashed line where another drive begins: after a pause, or where time goes back. */
function drawBreaks(plot, breaks, color) {
  const { ctx, bbox } = plot;
  const { min, max } = plot.scales.x;
  ctx.strokeStyle = color;
  ctx.setLineDash([3 * devicePixelRatio, 3 * devicePixelRatio]);
  ctx.beginPath();
  let reached = -Infinity;
  for (const at of breaks) {
    if (at < min || at > max) continue;
    const left = Math.round(plot.valToPos(at - 0.5, "x", true)) + 0.5;
    if (left < reached + 2) continue;
    ctx.moveTo(left, bbox.top);
    ctx.lineTo(left, bbox.top + bbox.height);
    reached = left;
  }
  ctx.stroke();
  ctx.setLineDash([]);
}

/** Fit a canvas to the width of a plot. Return its cleared context. */
export function fittedContext(canvas, plot) {
  const scale = devicePixelRatio;
  canvas.style.marginLeft = `${plot.bbox.left / scale}px`;
  canvas.style.width = `${plot.bbox.width / scale}px`;
  canvas.width = plot.bbox.width;
  canvas.height = canvas.clientHeight * scale;
  return canvas.getContext("2d");
}
