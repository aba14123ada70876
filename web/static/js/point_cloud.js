// Points on a canvas. It is fast enough for ten thousand points at every move of the mouse.

const NEAR_PX = 14;
const MARGIN_PX = 14;
const KEY_ZOOM = 1.5;
const MAX_ZOOM = 60;
const OTHERS_ALPHA = 56; // of 255, for points that are not chosen while others are
const CLICK_PX = 4; // a shorter drag is a click
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export class PointCloud {
  /**
   * In `box`, whose size the style sheet sets. `onPoint(index)`: the mouse or a key points at a point (-1: at none).
   * `onPick(index)`: a click on a point. `onSelect(indices, isMore)`: a drag around points, with shift in addition.
   * `drawBelow(context, place)` draws below the points; `place(x, y)` gives pixels.
   */
  constructor(box, { onPoint, onPick, onSelect, onOpen, drawBelow, radius = 3 }) {
    Object.assign(this, { box, onPoint, onPick, onSelect, onOpen, drawBelow, radius });
    this.x = this.y = new Float32Array(0);
    this.colourOf = new Uint8Array(0);
    this.palette = [];
    this.selected = new Set();
    this.pointed = this.pinned = -1;
    this.tool = "lasso";
    const [below, dots, over] = [0, 1, 2].map(() => box.appendChild(document.createElement("canvas")));
    Object.assign(this, { below, dots, over });
    this.path = null; // of the drag, in pixels
    this.reset();
    box.addEventListener("pointerdown", (event) => this.begin(event));
    box.addEventListener("pointermove", (event) => this.move(event));
    box.addEventListener("pointerup", (event) => this.end(event));
    box.addEventListener("pointercancel", () => this.drop());
    box.addEventListener("pointerleave", () => this.path || this.point(-1));
    box.addEventListener("dblclick", () => this.reset());
    box.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    box.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.draw()).observe(box);
  }

  show(x, y) {
    Object.assign(this, { x, y, pointed: -1, pinned: -1 });
    this.left = this.top = Infinity;
    this.right = this.bottom = -Infinity;
    for (let at = 0; at < x.length; at += 1) {
      this.left = Math.min(this.left, x[at]);
      this.right = Math.max(this.right, x[at]);
      this.top = Math.min(this.top, y[at]);
      this.bottom = Math.max(this.bottom, y[at]);
    }
    this.reset();
  }

  /** Show these limits instead of the points' own. */
  limit(left, right, top, bottom) {
    Object.assign(this, { left, right, top, bottom });
    this.draw();
  }

  /** `colourOf` has the number of each point's colour in the palette. */
  colour(palette, colourOf) {
    Object.assign(this, { palette, colourOf, colours: null });
    this.draw();
  }

  select(indices) {
    this.selected = new Set(indices);
    this.draw();
  }

  pin(index) {
    this.pinned = index;
    this.draw();
  }

  reset() {
    Object.assign(this, { zoom: 1, atX: 0, atY: 0 });
    this.draw();
  }

  setSize() {
    const { clientWidth: width, clientHeight: height } = this.box;
    const ratio = devicePixelRatio;
    if (this.width !== width || this.height !== height || this.ratio !== ratio) {
      Object.assign(this, { width, height, ratio, disc: null, image: null });
      for (const canvas of [this.below, this.dots, this.over]) {
        canvas.width = Math.round(width * ratio);
        canvas.height = Math.round(height * ratio);
      }
    }
    const across = (width - 2 * MARGIN_PX) / (this.right - this.left || 1);
    const down = (height - 2 * MARGIN_PX) / (this.bottom - this.top || 1);
    this.scale = Math.min(across, down) * this.zoom; // pixels for 1
    this.shiftX = width / 2 + this.atX - ((this.left + this.right) / 2) * this.scale;
    this.shiftY = height / 2 + this.atY - ((this.top + this.bottom) / 2) * this.scale;
  }

  place(x, y) {
    return [x * this.scale + this.shiftX, y * this.scale + this.shiftY];
  }

  draw() {
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.drawNow();
    });
  }

  drawNow() {
    this.setSize();
    const context = this.below.getContext("2d");
    context.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    this.drawBelow?.(context, (px, py) => this.place(px, py), this);
    this.drawDots();
    this.drawOver();
  }

  /** Pixel by pixel: this takes a twentieth of the time of ten thousand drawing calls. */
  drawDots() {
    const { dots, ratio, x, y, colourOf, selected } = this;
    if (!dots.width || !dots.height) return;
    this.colours ??= this.palette.map(numbersOf);
    this.disc ??= discOf(this.radius * ratio);
    this.image ??= new ImageData(dots.width, dots.height);
    const pixels = new Uint32Array(this.image.data.buffer);
    const { width, height } = dots;
    const edge = Math.ceil(this.radius * ratio) + 1;
    pixels.fill(0);
    const put = (at, alpha) => {
      const px = Math.round((x[at] * this.scale + this.shiftX) * ratio);
      const py = Math.round((y[at] * this.scale + this.shiftY) * ratio);
      if (px < edge || py < edge || px >= width - edge || py >= height - edge) return;
      const colour = this.colours[colourOf[at]];
      const middle = py * width + px;
      for (const [right, down, covered] of this.disc) {
        const pixel = middle + down * width + right;
        if (covered === 1) pixels[pixel] = colour | (alpha << 24);
        else if (!pixels[pixel]) pixels[pixel] = colour | ((alpha * covered) << 24);
      }
    };
    const other = selected.size ? OTHERS_ALPHA : 255;
    if (this.colours.length) for (let at = 0; at < x.length; at += 1) put(at, other);
    if (this.colours.length) for (const at of selected) put(at, 255);
    dots.getContext("2d").putImageData(this.image, 0, 0);
  }

  drawOver() {
    const { over, ratio } = this;
    const context = over.getContext("2d");
    const ink = getComputedStyle(this.box).color;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    context.strokeStyle = ink;
    context.lineWidth = 2;
    for (const at of [this.pinned, this.pointed]) {
      if (at < 0 || at >= this.x.length) continue;
      context.beginPath();
      context.arc(...this.place(this.x[at], this.y[at]), this.radius + 4, 0, 7);
      context.stroke();
    }
    if (!this.path || this.tool === "move") return;
    context.beginPath();
    for (const [px, py] of this.path) context.lineTo(px, py);
    context.closePath();
    context.setLineDash([5, 4]);
    context.stroke();
    context.setLineDash([]);
    context.globalAlpha = 0.12;
    context.fillStyle = ink;
    context.fill();
    context.globalAlpha = 1;
  }

  begin(event) {
    if (event.button > 1) return;
    this.box.setPointerCapture(event.pointerId);
    this.box.focus({ preventScroll: true });
    this.isPan = event.button === 1 || this.tool === "move";
    this.path = [this.at(event)];
    event.preventDefault();
  }

  move(event) {
    const at = this.at(event);
    if (!this.path) {
      this.point(this.nearest(at, NEAR_PX));
      return;
    }
    const before = this.path.at(-1);
    this.path.push(at);
    if (this.isPan) {
      this.atX += at[0] - before[0];
      this.atY += at[1] - before[1];
      this.draw();
    } else {
      this.drawOver();
    }
  }

  end(event) {
    const { path } = this;
    if (!path) return;
    const far = path.some(([px, py]) => Math.hypot(px - path[0][0], py - path[0][1]) > CLICK_PX);
    this.drop();
    if (far && !this.isPan) this.onSelect?.(this.inside(path), event.shiftKey);
    else if (!far) this.onPick?.(this.nearest(this.at(event), NEAR_PX), event.shiftKey);
  }

  drop() {
    this.path = null;
    this.drawOver();
  }

  inside(outline) {
    const context = this.over.getContext("2d");
    const polygon = new Path2D();
    for (const [px, py] of outline) polygon.lineTo(px, py);
    polygon.closePath();
    context.setTransform(1, 0, 0, 1, 0, 0);
    const xs = outline.map(([px]) => px);
    const ys = outline.map(([, py]) => py);
    const [left, right, top, bottom] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
    const points = [];
    for (let at = 0; at < this.x.length; at += 1) {
      const [px, py] = this.place(this.x[at], this.y[at]);
      if (px < left || px > right || py < top || py > bottom) continue;
      if (context.isPointInPath(polygon, px, py)) points.push(at);
    }
    return points;
  }

  nearest([px, py], within) {
    let nearest = -1;
    let least = within * within;
    for (let at = 0; at < this.x.length; at += 1) {
      const apartX = this.x[at] * this.scale + this.shiftX - px;
      const apartY = this.y[at] * this.scale + this.shiftY - py;
      const apart = apartX * apartX + apartY * apartY;
      if (apart < least) [least, nearest] = [apart, at];
    }
    return nearest;
  }

  point(index) {
    if (index === this.pointed) return;
    this.pointed = index;
    this.drawOver();
    this.onPoint?.(index);
  }

  at(event) {
    const box = this.box.getBoundingClientRect();
    return [event.clientX - box.left - this.box.clientLeft, event.clientY - box.top - this.box.clientTop];
  }

  wheel(event) {
    event.preventDefault();
    this.zoomBy(Math.exp(-event.deltaY / 400), this.at(event));
  }

  zoomBy(factor, [px, py] = [this.width / 2, this.height / 2]) {
    const zoom = Math.min(MAX_ZOOM, Math.max(1, this.zoom * factor));
    const by = zoom / this.zoom;
    this.atX = (this.atX + this.width / 2 - px) * by - this.width / 2 + px;
    this.atY = (this.atY + this.height / 2 - py) * by - this.height / 2 + py;
    if (zoom === 1) this.atX = this.atY = 0;
    this.zoom = zoom;
    this.draw();
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const keys = {
      "+": () => this.zoomBy(KEY_ZOOM, this.middle()),
      "-": () => this.zoomBy(1 / KEY_ZOOM, this.middle()),
      0: () => this.reset(),
      Enter: () => this.onOpen?.(this.pointed),
      " ": () => this.onPick?.(this.pointed, true),
    };
    const direction = DIRECTIONS[event.key];
    if (!direction && !keys[event.key]) return;
    event.preventDefault();
    if (direction) this.step(direction);
    else keys[event.key]();
  }

  middle() {
    return this.pointed < 0 ? undefined : this.place(this.x[this.pointed], this.y[this.pointed]);
  }

  /** Point at the nearest point in a direction; the first step goes to the point in the middle. */
  step([right, down]) {
    if (this.pointed < 0) {
      this.point(this.nearest([this.width / 2, this.height / 2], Infinity));
      return;
    }
    const [px, py] = this.middle();
    let next = -1;
    let least = Infinity;
    for (let at = 0; at < this.x.length; at += 1) {
      const apartX = this.x[at] * this.scale + this.shiftX - px;
      const apartY = this.y[at] * this.scale + this.shiftY - py;
      const along = apartX * right + apartY * down;
      const aside = Math.abs(apartX * down) + Math.abs(apartY * right);
      if (along <= 0.5 || aside > along) continue;
      if (along + 2 * aside < least) [least, next] = [along + 2 * aside, at];
    }
    if (next >= 0) this.point(next);
  }
}

/** A colour as its red, green and blue in the lower bytes of a number. */
function numbersOf(colour) {
  const context = Object.assign(document.createElement("canvas"), { width: 1, height: 1 }).getContext("2d");
  context.fillStyle = colour;
  context.fillRect(0, 0, 1, 1);
  const [red, green, blue] = context.getImageData(0, 0, 1, 1).data;
  return red | (green << 8) | (blue << 16);
}

/** The pixels of a disc, from its middle: [right, down, covered share]. */
function discOf(radius) {
  const reach = Math.ceil(radius);
  const across = Array.from({ length: 2 * reach + 1 }, (_, at) => at - reach);
  return across
    .flatMap((down) => across.map((right) => [right, down, Math.min(1, radius + 0.5 - Math.hypot(right, down))]))
    .filter(([, , covered]) => covered > 0);
}
