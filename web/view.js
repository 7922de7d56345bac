// view: the image on the canvas: where it lies (zoom, pan), which tiles are needed for that, what is under the probe, and
// what is drawn: one image, or two beside or over one another.

import { Painter } from "./painter.js";
import { ABSOLUTE, DIRECTIONS, IDS, LIGHT, SIGNED, SINGLE } from "./shader.js";
import { SIDE, countOf, halfToNumber, holds, intersect, levelCount, levelSide } from "./tiles.js";

const MOST_TILES = 480, MAX_SCALE = 64;
const GREY = [0.13, 0.13, 0.13], WHITE = [1, 1, 1], BLACK = [0, 0, 0];
const BESIDE = 1.5; // side by side is preferred by this factor of the scale
const GAP = 2, NEAR = 12; // pixels: between two panes; from a handle, to hold it

const KINDS = { normal: DIRECTIONS, object: IDS, material: IDS }; // LIGHT by default

/** What a pane shows: the tiles of a layer, and how its numbers are meant. */
class Source {
  constructor(layer, name) {
    Object.assign(this, { layer, name, kind: KINDS[name] ?? LIGHT, measured: name === "samples" || name === "depth", most: 0, gain: 1 });
    if (this.measured) this.measure(layer.tiles.values());
  }
  /** Layers of counts and distances are shown from black to white: the largest value seen is white. */
  measure(tiles) {
    for (const tile of tiles) for (let i = 0; i < tile.texels.length; i += 4) this.most = Math.max(this.most, halfToNumber(tile.texels[i]));
    this.gain = this.most > 0 ? 1 / this.most : 1;
  }
}

export class View {
  /** `onMove` is called when other tiles are wanted, `onProbe` when what is under the probe may have changed, `onMark` when the rectangle or the divider has. */
  constructor(canvas, onMove, onProbe, onMark) {
    Object.assign(this, { canvas, onMove, onProbe, onMark, width: 0, height: 0, scale: 1, x: 0, y: 0, fitted: true, frame: 0 });
    Object.assign(this, { exposure: 0, offset: 0, tone: "srgb", probe: null });
    Object.assign(this, { source: null, other: null, how: "side", divider: 0.5 }); // what is shown, and what it is compared with
    Object.assign(this, { mark: null, marking: false, stretching: false }); // a rectangle of pixels
    this.painter = new Painter(canvas, () => this.draw());
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.listen();
  }
  get layer() {
    return this.source?.layer ?? null;
  }

  // ---- panes

  /** The rectangles of the canvas that show the image: one, or two: side by side, or one above the other if that shows a much larger image. */
  panes() {
    const { width: w, height: h } = this.canvas;
    if (!this.other || this.how !== "side") return [{ x: 0, y: 0, w, h }];
    const half = (side) => Math.max(1, (side - GAP) >> 1), fits = (a, b) => Math.min(a / this.width, b / this.height);
    if (BESIDE * fits(half(w), h) >= fits(w, half(h))) return [{ x: 0, y: 0, w: half(w), h }, { x: w - half(w), y: 0, w: half(w), h }];
    return [{ x: 0, y: 0, w, h: half(h) }, { x: 0, y: h - half(h), w, h: half(h) }];
  }
  get room() {
    return this.panes()[0];
  }
  /** A point of the canvas as one of the pane that it is in. */
  inPane({ x, y }) {
    const pane = this.panes().find((p) => x >= p.x && x < p.x + p.w && y >= p.y && y < p.y + p.h) ?? this.panes()[0];
    return { x: x - pane.x, y: y - pane.y };
  }
  get wipes() {
    return !!this.other && this.how === "wipe";
  }
  get differs() {
    return !!this.other && (this.how === "signed" || this.how === "absolute");
  }
  /** Compares with another source or, with null, with none. */
  compare(layer, name, how) {
    const panes = this.panes().length;
    this.other = layer ? new Source(layer, name) : null;
    this.how = how;
    if (this.panes().length !== panes && this.fitted) this.fit();
    else this.moved();
    this.onProbe();
  }
  setDivider(share) {
    this.divider = Math.min(1, Math.max(0, share));
    this.draw();
    this.onMark();
  }

  // ---- drawing

  draw() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.paint();
    });
  }
  /** The pairs of tiles to draw of a source, coarse ones first: finer ones cover them. `other` is a second source or null. */
  drawn(source, other) {
    if (!source || !this.width) return [];
    const pairs = [], held = source.layer.held ?? other?.layer.held, finest = held ? held.level : this.level();
    for (let level = held ? held.level : levelCount(this.width, this.height) - 1; level >= finest; level--) {
      const rect = held ? intersect(held.rect, this.visible(level)) : this.visible(level);
      if (countOf(rect) > MOST_TILES) continue;
      for (const tile of source.layer.within(level, rect)) {
        const second = other ? other.layer.get(level, tile.tx, tile.ty) : tile;
        if (second) pairs.push([tile, second]);
      }
    }
    return pairs;
  }
  pass(source, mode, pane, clip, other = null) {
    const { width, height, offset, tone } = this, gain = source.gain * 2 ** this.exposure;
    this.painter.draw(this.drawn(source, other), { mode, pane, clip, place: [this.x, this.y, this.scale], width, height, gain, offset, tone, kind: source.kind });
  }
  paint() {
    const { painter, canvas, source, other } = this;
    if (!painter.ready) return;
    painter.fill(0, 0, canvas.width, canvas.height, GREY);
    if (!source) return;
    const [pane, second] = this.panes();
    if (this.differs) this.pass(source, this.how === "signed" ? SIGNED : ABSOLUTE, pane, pane, other);
    else if (this.wipes) {
      const at = Math.round(this.divider * pane.w);
      this.pass(other, SINGLE, pane, { ...pane, w: at });
      this.pass(source, SINGLE, pane, { ...pane, x: at, w: pane.w - at });
      this.line(at - 2, 0, 4, pane.h);
    } else {
      this.pass(source, SINGLE, pane, pane);
      if (second) this.pass(other, SINGLE, second, second);
      if (second) this.line(second.x ? second.x - GAP : 0, second.y ? second.y - GAP : 0, second.x ? GAP : canvas.width, second.y ? GAP : canvas.height, 0);
    }
    this.panes().forEach((p) => this.paintMark(p));
    if (second) [pane, second].forEach((p) => this.paintProbe(p));
  }
  /** A small frame around the probe, to find it in the other pane too. */
  paintProbe(pane) {
    const { probe, scale } = this;
    if (!probe) return;
    const middle = (at, from) => from + (at + 0.5) * scale, half = Math.max(4, scale / 2);
    const x = middle(probe.x, this.x), y = middle(probe.y, this.y);
    if (x < 0 || y < 0 || x >= pane.w || y >= pane.h) return;
    this.frameAround(pane, x - half, y - half, x + half, y + half);
  }
  /** A white line with a dark rim, to be seen on everything. */
  line(x, y, w, h, rim = 1) {
    this.painter.fill(x, y, w, h, BLACK);
    this.painter.fill(x + rim, y, w - 2 * rim, h, WHITE);
  }
  /** The outline of the rectangle, in one pane. */
  paintMark(pane) {
    const { mark, scale, x, y } = this;
    if (mark) this.frameAround(pane, x + mark.x0 * scale - 1, y + mark.y0 * scale - 1, x + mark.x1 * scale + 1, y + mark.y1 * scale + 1);
  }
  /** A white frame with a dark rim around a rectangle of a pane; it stays inside. */
  frameAround(pane, left, top, right, bottom) {
    const clip = (v, most) => Math.round(Math.min(Math.max(v, 1), most - 1));
    const x0 = clip(left, pane.w), x1 = clip(right, pane.w), y0 = clip(top, pane.h), y1 = clip(bottom, pane.h);
    const frame = (d, colour) => {
      const x = pane.x + x0 - d, y = pane.y + y0 - d, w = x1 - x0 + 2 * d, h = y1 - y0 + 2 * d;
      for (const edge of [[x, y, w, 1], [x, y + h - 1, w, 1], [x, y, 1, h], [x + w - 1, y, 1, h]]) this.painter.fill(...edge, colour);
    };
    frame(1, BLACK);
    frame(0, WHITE);
  }
  /** The canvas as RGBA bytes, bottom row first. */
  pixels() {
    this.paint();
    return this.painter.pixels();
  }

  // ---- tiles

  /** The level whose texels are nearest to the canvas's pixels, of those that few enough tiles show. */
  level() {
    const last = levelCount(this.width, this.height) - 1;
    let level = Math.min(last, Math.max(0, Math.round(-Math.log2(this.scale))));
    while (level < last && countOf(this.visible(level)) > MOST_TILES) level++;
    return level;
  }
  /** The tiles of a level that are in sight. */
  visible(level) {
    const unit = SIDE * 2 ** level * this.scale, { room } = this;
    const clip = (value, side) => Math.min(Math.max(value, 0), Math.ceil(levelSide(side, level) / SIDE));
    return {
      tx0: clip(Math.floor(-this.x / unit), this.width),
      ty0: clip(Math.floor(-this.y / unit), this.height),
      tx1: clip(Math.ceil((room.w - this.x) / unit), this.width),
      ty1: clip(Math.ceil((room.h - this.y) / unit), this.height),
    };
  }
  /** What is to be fetched: what is in sight, at its level; for a difference from held tiles, those and at theirs. */
  wanted() {
    if (!this.width || !this.canvas.width) return null;
    const held = this.differs ? this.other.layer.held : null, level = held ? held.level : this.level();
    const rect = held ? intersect(held.rect, this.visible(level)) : this.visible(level);
    return rect.tx0 < rect.tx1 && rect.ty0 < rect.ty1 ? { level, rect } : null;
  }
  taken(layer, fresh) {
    const finest = this.wanted()?.level ?? this.level(), rect = this.visible(finest);
    layer.forget(4 * MOST_TILES, (tile) => tile.level > finest || (tile.level === finest && holds(rect, tile)));
    for (const source of [this.source, this.other]) if (source?.layer === layer && source.measured) source.measure(fresh);
    this.draw();
    this.onProbe();
  }
  /** Shows a layer; its name says how its numbers are meant. */
  show(layer, name) {
    this.source = new Source(layer, name);
    this.draw();
    this.onProbe();
  }
  /** The tiles in sight, to be kept: { level, rect, tiles }; null when none is there. */
  inSight() {
    const wanted = this.source && this.wanted();
    if (!wanted) return null;
    const tiles = [...this.layer.within(wanted.level, wanted.rect)];
    return tiles.length ? { ...wanted, tiles } : null;
  }

  // ---- zoom and pan

  setImage(width, height) {
    if (width === this.width && height === this.height) return;
    Object.assign(this, { width, height, probe: null });
    this.setMark(null);
    this.fit();
    this.draw();
  }
  resize() {
    const box = this.canvas.getBoundingClientRect(), ratio = devicePixelRatio || 1;
    const { width, height } = this.canvas;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    if (this.fitted) return this.fit();
    // What was in the middle stays there.
    this.x += Math.round((this.canvas.width - width) / 2);
    this.y += Math.round((this.canvas.height - height) / 2);
    this.moved();
  }
  fit() {
    const { room } = this;
    if (!this.width) return;
    this.scale = Math.min(room.w / this.width, room.h / this.height) || 1;
    if (this.scale > 1) this.scale = Math.floor(this.scale);
    this.centre();
    this.fitted = true;
  }
  actual() {
    this.scale = 1;
    this.fitted = false;
    this.centre();
  }
  centre() {
    this.x = Math.round((this.room.w - this.width * this.scale) / 2);
    this.y = Math.round((this.room.h - this.height * this.scale) / 2);
    this.moved();
  }
  /** Zooms about a point of a pane, by default its middle; whole multiples of pixels stay whole. */
  zoom(factor, x = this.room.w / 2, y = this.room.h / 2) {
    const least = Math.min(1, 32 / Math.max(this.width, this.height));
    const scale = Math.min(MAX_SCALE, Math.max(least, this.scale * factor));
    this.x = x - ((x - this.x) * scale) / this.scale;
    this.y = y - ((y - this.y) * scale) / this.scale;
    this.scale = scale;
    this.fitted = false;
    this.moved();
  }
  pan(dx, dy) {
    this.x += dx;
    this.y += dy;
    this.fitted = false;
    this.moved();
  }
  moved() {
    // At least a corner of the image stays in sight.
    const keep = (at, side, room) => Math.min(room - 16, Math.max(16 - side, at));
    this.x = keep(this.x, this.width * this.scale, this.room.w);
    this.y = keep(this.y, this.height * this.scale, this.room.h);
    this.draw();
    this.onMove();
  }

  // ---- the probe: the pixel under the pointer, or the one that arrow keys chose

  setProbe(x, y) {
    const inside = x >= 0 && y >= 0 && x < this.width && y < this.height;
    this.probe = inside ? { x, y } : null;
    if (this.stretching && this.probe) this.stretch(x, y);
    if (this.panes().length > 1) this.draw();
    this.onProbe();
  }
  moveProbe(dx, dy) {
    const middle = { x: Math.floor(this.width / 2), y: Math.floor(this.height / 2) }, from = this.probe;
    const to = from ? { x: from.x + dx, y: from.y + dy } : middle;
    this.setProbe(Math.min(Math.max(to.x, 0), this.width - 1), Math.min(Math.max(to.y, 0), this.height - 1));
  }
  /** { x, y, side, rgb, error } of a layer: the finest that is there, means over side by side pixels; null when there is nothing. */
  probed(layer = this.layer) {
    if (!this.probe || !layer || !this.width) return null;
    const { x, y } = this.probe;
    for (let level = 0; level < levelCount(this.width, this.height); level++) {
      const u = x >> level, v = y >> level, tile = layer.get(level, Math.floor(u / SIDE), Math.floor(v / SIDE));
      if (!tile) continue;
      const i = 4 * ((v % SIDE) * tile.w + (u % SIDE)), value = (k) => halfToNumber(tile.texels[i + k]);
      return { x, y, side: 2 ** level, rgb: [value(0), value(1), value(2)], error: value(3) };
    }
    return null;
  }

  // ---- the rectangle: { x0, y0, x1, y1 } in pixels, the last ones beyond it

  setMark(mark) {
    this.mark = mark;
    if (!mark) this.stretching = false;
    this.draw();
    this.onMark();
  }
  /** Begins a rectangle at a pixel, whose opposite corner follows the probe until the next call; that one ends it. */
  pinMark() {
    if (this.stretching) return void (this.stretching = false);
    if (!this.probe) this.moveProbe(0, 0);
    if (!this.probe) return;
    this.begin(this.probe.x, this.probe.y);
  }
  /** The pixel of the image that is nearest to a pixel. */
  nearest(x, y) {
    const inside = (v, side) => Math.min(Math.max(Math.floor(v), 0), side - 1);
    return { x: inside(x, this.width), y: inside(y, this.height) };
  }
  begin(x, y) {
    this.corner = this.nearest(x, y);
    this.stretching = true;
    this.stretch(x, y);
  }
  stretch(x, y) {
    const at = this.nearest(x, y), { corner } = this;
    this.setMark({ x0: Math.min(at.x, corner.x), y0: Math.min(at.y, corner.y), x1: Math.max(at.x, corner.x) + 1, y1: Math.max(at.y, corner.y) + 1 });
  }

  // ---- the pointer

  point(event) {
    const box = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / box.width;
    return { x: (event.clientX - box.left) * ratio, y: (event.clientY - box.top) * ratio };
  }
  /** The pixel of the image under a point of the canvas; it may lie outside. */
  pixelAt(point) {
    const at = this.inPane(point);
    return { x: Math.floor((at.x - this.x) / this.scale), y: Math.floor((at.y - this.y) / this.scale) };
  }
  onDivider(point) {
    return this.wipes && Math.abs(point.x - this.divider * this.canvas.width) <= NEAR * (devicePixelRatio || 1);
  }
  /** What a press of the pointer takes hold of. */
  grip(event, point) {
    if (this.onDivider(point)) return "divider";
    return (event.shiftKey || this.marking) && this.width ? "mark" : "image";
  }
  drag(grip, from, to) {
    if (grip === "divider") return this.setDivider(to.x / this.canvas.width);
    if (grip === "mark") return this.stretch(this.pixelAt(to).x, this.pixelAt(to).y);
    this.pan(to.x - from.x, to.y - from.y);
  }
  listen() {
    const { canvas } = this, held = new Map();
    let grip = "image";
    const spread = () => {
      const [a, b] = [...held.values()];
      return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, d: Math.hypot(a.x - b.x, a.y - b.y) };
    };
    canvas.addEventListener("pointerdown", (event) => {
      const at = this.point(event);
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, at);
      if (held.size === 1) grip = this.grip(event, at);
      if (held.size === 1 && grip === "mark") this.begin(this.pixelAt(at).x, this.pixelAt(at).y);
    });
    canvas.addEventListener("pointermove", (event) => {
      const to = this.point(event), from = held.get(event.pointerId);
      canvas.style.cursor = this.onDivider(to) ? "ew-resize" : "";
      if (from && held.size === 1) this.drag(grip, from, to);
      if (from && held.size === 2) {
        const before = spread();
        held.set(event.pointerId, to);
        const after = spread(), middle = this.inPane(after);
        this.pan(after.x - before.x, after.y - before.y);
        if (before.d > 0) this.zoom(after.d / before.d, middle.x, middle.y);
      }
      if (from) held.set(event.pointerId, to);
      const at = this.pixelAt(to);
      this.setProbe(at.x, at.y);
    });
    for (const type of ["pointerup", "pointercancel"])
      canvas.addEventListener(type, (event) => {
        held.delete(event.pointerId);
        if (grip === "mark") this.stretching = this.marking = false;
        this.onMark();
      });
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      const at = this.inPane(this.point(event));
      this.zoom(2 ** (-event.deltaY / 200), at.x, at.y);
    }, { passive: false });
    canvas.addEventListener("dblclick", (event) => {
      const at = this.inPane(this.point(event));
      this.zoom(2, at.x, at.y);
    });
  }
}
