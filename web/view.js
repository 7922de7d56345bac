// view: the image on the canvas: where it lies (zoom, pan), how its numbers become colours, and what is under the probe.
// All tiles are slices of one texture array; a frame is one draw call.

import { SIDE, halfToNumber, levelCount, levelSide } from "./tiles.js";

const SLOTS = 1024, MOST_TILES = 480, MAX_SCALE = 64;
export const TONES = ["srgb", "filmic", "false", "relative"];

const VERTEX = `#version 300 es
uniform vec2 viewport; uniform vec3 place; // of the image: its left and top, and its scale, in pixels of the canvas
in vec4 area; in vec2 size; in float slot; // in pixels of the image: left, top, right, bottom; texels of the tile
out vec3 texel;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  vec2 at = place.xy + place.z * mix(area.xy, area.zw, corner);
  texel = vec3(corner * size / ${SIDE}.0, slot);
  gl_Position = vec4(at / viewport * vec2(2, -2) + vec2(-1, 1), 0, 1);
}`;

// Filmic: Narkowicz (2015), "ACES Filmic Tone Mapping Curve". False colour: ten stops of luminance around middle grey, or
// the relative error from 0.1 % to 100 %, on a ramp of five colours.
const FRAGMENT = `#version 300 es
precision highp float; precision highp sampler2DArray;
uniform sampler2DArray tiles; uniform float gain, offset; uniform int tone; uniform bool signedLayer;
in vec3 texel; out vec4 colour;
vec3 srgb(vec3 c) {
  return mix(12.92 * c, 1.055 * pow(max(c, vec3(0)), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}
vec3 filmic(vec3 c) { c = max(c, vec3(0)); return c * (2.51 * c + 0.03) / (c * (2.43 * c + 0.59) + 0.14); }
vec3 ramp(float t) {
  vec3 c[5] = vec3[5](vec3(0.05, 0.05, 0.3), vec3(0.0, 0.45, 0.75), vec3(0.1, 0.7, 0.35), vec3(0.95, 0.85, 0.2), vec3(0.85, 0.1, 0.1));
  t = clamp(t, 0.0, 1.0) * 4.0;
  int i = min(int(t), 3);
  return mix(c[i], c[i + 1], t - float(i));
}
float luminance(vec3 c) { return dot(c, vec3(0.2126, 0.7152, 0.0722)); }
void main() {
  vec4 t = texture(tiles, texel);
  vec3 c = t.rgb * gain + offset;
  if (tone == 3) c = ramp(1.0 + log(max(t.a / max(luminance(t.rgb), 1e-6), 1e-6)) / log(1000.0));
  else if (signedLayer) c = clamp(0.5 * t.rgb + 0.5, 0.0, 1.0);
  else if (tone == 2) c = ramp(0.5 + log2(max(luminance(c), 1e-9) / 0.18) / 10.0);
  else c = srgb(clamp(tone == 1 ? filmic(c) : c, 0.0, 1.0));
  colour = vec4(c, 1);
}`;

function compile(gl) {
  const program = gl.createProgram();
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(type);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
  return program;
}

export class View {
  /** `onMove` is called when other tiles are wanted, `onProbe` when what is under the probe may have changed. */
  constructor(canvas, onMove, onProbe) {
    Object.assign(this, { canvas, onMove, onProbe, width: 0, height: 0, scale: 1, x: 0, y: 0, fitted: true, layer: null, frame: 0 });
    Object.assign(this, { exposure: 0, offset: 0, tone: "srgb", autoGain: 1, signedLayer: false, probe: null });
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.start());
    new ResizeObserver(() => this.resize()).observe(canvas);
    this.start();
    this.listen();
  }

  // ---- WebGL

  start() {
    const gl = (this.gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false }));
    if (!gl) return;
    this.program = compile(gl);
    gl.useProgram(this.program);
    this.at = Object.fromEntries(["viewport", "place", "gain", "offset", "tone", "signedLayer"].map((n) => [n, gl.getUniformLocation(this.program, n)]));
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
    this.slots = Math.min(SLOTS, gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS));
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, SIDE, SIDE, this.slots);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, filter, gl.NEAREST);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    this.attribute("area", 4, 0);
    this.attribute("size", 2, 16);
    this.attribute("slot", 1, 24);
    this.holders = new Array(this.slots).fill(null); // the tile of each slot
    this.slotOf = new Map();
    this.next = 0;
    this.draw();
  }
  attribute(name, count, offset) {
    const { gl } = this, place = gl.getAttribLocation(this.program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, gl.FLOAT, false, 28, offset);
    gl.vertexAttribDivisor(place, 1);
  }
  /** The slot of a tile, which is uploaded if need be; slots are used again in turn, but none twice in one frame. */
  place(tile, needed) {
    if (this.slotOf.has(tile)) return this.slotOf.get(tile);
    const { gl } = this;
    while (needed.has(this.holders[this.next])) this.next = (this.next + 1) % this.slots;
    const slot = this.next;
    this.next = (this.next + 1) % this.slots;
    this.slotOf.delete(this.holders[slot]);
    this.holders[slot] = tile;
    this.slotOf.set(tile, slot);
    gl.texSubImage3D(gl.TEXTURE_2D_ARRAY, 0, 0, 0, slot, tile.w, tile.h, 1, gl.RGBA, gl.HALF_FLOAT, tile.texels);
    return slot;
  }
  draw() {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.paint();
    });
  }
  /** The tiles to draw, coarse ones first: finer ones cover them. */
  drawn() {
    if (!this.layer || !this.width) return [];
    const tiles = [], finest = this.level();
    for (let level = levelCount(this.width, this.height) - 1; level >= finest; level--) {
      const rect = this.visible(level);
      if ((rect.tx1 - rect.tx0) * (rect.ty1 - rect.ty0) <= MOST_TILES) tiles.push(...this.layer.within(level, rect));
    }
    return tiles.slice(-this.slots);
  }
  paint() {
    const { gl, canvas } = this;
    if (!gl || gl.isContextLost()) return;
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.13, 0.13, 0.13, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const tiles = this.drawn(), needed = new Set(tiles);
    const instances = tiles.flatMap((tile) => {
      const unit = 2 ** tile.level, x = tile.tx * SIDE, y = tile.ty * SIDE;
      return [x * unit, y * unit, Math.min((x + tile.w) * unit, this.width), Math.min((y + tile.h) * unit, this.height), tile.w, tile.h, this.place(tile, needed)];
    });
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(instances), gl.STREAM_DRAW);
    gl.uniform2f(this.at.viewport, canvas.width, canvas.height);
    gl.uniform3f(this.at.place, this.x, this.y, this.scale);
    gl.uniform1f(this.at.gain, this.autoGain * 2 ** this.exposure);
    gl.uniform1f(this.at.offset, this.offset);
    gl.uniform1i(this.at.tone, TONES.indexOf(this.tone));
    gl.uniform1i(this.at.signedLayer, this.signedLayer);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, tiles.length);
  }
  /** The canvas as RGBA bytes, bottom row first. */
  pixels() {
    this.paint();
    const { gl, canvas } = this, bytes = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes;
  }

  // ---- tiles

  /** The level whose texels are nearest to the canvas's pixels, of those that few enough tiles show. */
  level() {
    const last = levelCount(this.width, this.height) - 1;
    let level = Math.min(last, Math.max(0, Math.round(-Math.log2(this.scale))));
    for (; level < last; level++) {
      const rect = this.visible(level);
      if ((rect.tx1 - rect.tx0) * (rect.ty1 - rect.ty0) <= MOST_TILES) break;
    }
    return level;
  }
  /** The tiles of a level that are on the canvas. */
  visible(level) {
    const unit = SIDE * 2 ** level * this.scale, { canvas } = this;
    const clip = (value, side) => Math.min(Math.max(value, 0), Math.ceil(levelSide(side, level) / SIDE));
    return {
      tx0: clip(Math.floor(-this.x / unit), this.width),
      ty0: clip(Math.floor(-this.y / unit), this.height),
      tx1: clip(Math.ceil((canvas.width - this.x) / unit), this.width),
      ty1: clip(Math.ceil((canvas.height - this.y) / unit), this.height),
    };
  }
  wanted() {
    if (!this.width || !this.canvas.width) return null;
    const level = this.level(), rect = this.visible(level);
    return rect.tx0 < rect.tx1 && rect.ty0 < rect.ty1 ? { level, rect } : null;
  }
  taken(layer, fresh) {
    this.layer = layer;
    const finest = this.level(), rect = this.visible(finest);
    layer.forget(4 * MOST_TILES, ({ level, tx, ty }) => level > finest || (level === finest && tx >= rect.tx0 && tx < rect.tx1 && ty >= rect.ty0 && ty < rect.ty1));
    if (this.measured) this.measure(fresh);
    this.draw();
    this.onProbe();
  }
  /** Layers of counts and distances are shown from black to white: the largest value seen is white. */
  measure(fresh) {
    let most = this.most;
    for (const tile of fresh) for (let i = 0; i < tile.texels.length; i += 4) most = Math.max(most, halfToNumber(tile.texels[i]));
    this.most = most;
    this.autoGain = most > 0 ? 1 / most : 1;
  }
  /** How a layer's numbers are meant. */
  show(layer, name) {
    Object.assign(this, { layer, signedLayer: name === "normal", measured: name === "samples" || name === "depth", most: 0, autoGain: 1 });
    if (this.measured) this.measure([...layer.tiles.values()]);
    this.draw();
    this.onProbe();
  }

  // ---- zoom and pan

  setImage(width, height) {
    if (width === this.width && height === this.height) return;
    Object.assign(this, { width, height, probe: null });
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
    const { canvas } = this;
    if (!this.width) return;
    this.scale = Math.min(canvas.width / this.width, canvas.height / this.height) || 1;
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
    this.x = Math.round((this.canvas.width - this.width * this.scale) / 2);
    this.y = Math.round((this.canvas.height - this.height * this.scale) / 2);
    this.moved();
  }
  /** Zooms about a point of the canvas, by default its middle; whole multiples of pixels stay whole. */
  zoom(factor, x = this.canvas.width / 2, y = this.canvas.height / 2) {
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
    this.x = keep(this.x, this.width * this.scale, this.canvas.width);
    this.y = keep(this.y, this.height * this.scale, this.canvas.height);
    this.draw();
    this.onMove();
  }

  // ---- the probe: the pixel under the pointer, or the one that arrow keys chose

  setProbe(x, y) {
    const inside = x >= 0 && y >= 0 && x < this.width && y < this.height;
    this.probe = inside ? { x, y } : null;
    this.onProbe();
  }
  moveProbe(dx, dy) {
    const middle = { x: Math.floor(this.width / 2), y: Math.floor(this.height / 2) }, from = this.probe;
    const to = from ? { x: from.x + dx, y: from.y + dy } : middle;
    this.setProbe(Math.min(Math.max(to.x, 0), this.width - 1), Math.min(Math.max(to.y, 0), this.height - 1));
  }
  /** { x, y, side, rgb, error }: the finest that is there, means over side by side pixels; null when there is nothing. */
  probed() {
    if (!this.probe || !this.layer || !this.width) return null;
    const { x, y } = this.probe;
    for (let level = 0; level < levelCount(this.width, this.height); level++) {
      const u = x >> level, v = y >> level, tile = this.layer.get(level, Math.floor(u / SIDE), Math.floor(v / SIDE));
      if (!tile) continue;
      const i = 4 * ((v % SIDE) * tile.w + (u % SIDE)), value = (k) => halfToNumber(tile.texels[i + k]);
      return { x, y, side: 2 ** level, rgb: [value(0), value(1), value(2)], error: value(3) };
    }
    return null;
  }
  point(event) {
    const box = this.canvas.getBoundingClientRect(), ratio = this.canvas.width / box.width;
    return { x: (event.clientX - box.left) * ratio, y: (event.clientY - box.top) * ratio };
  }
  listen() {
    const { canvas } = this, held = new Map();
    const spread = () => {
      const [a, b] = [...held.values()];
      return { x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, d: Math.hypot(a.x - b.x, a.y - b.y) };
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      held.set(event.pointerId, this.point(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      const to = this.point(event), from = held.get(event.pointerId);
      if (from && held.size === 1) this.pan(to.x - from.x, to.y - from.y);
      if (from && held.size === 2) {
        const before = spread();
        held.set(event.pointerId, to);
        const after = spread();
        this.pan(after.x - before.x, after.y - before.y);
        if (before.d > 0) this.zoom(after.d / before.d, after.x, after.y);
      }
      if (from) held.set(event.pointerId, to);
      this.setProbe(Math.floor((to.x - this.x) / this.scale), Math.floor((to.y - this.y) / this.scale));
    });
    for (const type of ["pointerup", "pointercancel"]) canvas.addEventListener(type, (event) => held.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => {
      if (!event.ctrlKey && document.activeElement !== canvas) return; // the page scrolls
      event.preventDefault();
      const at = this.point(event);
      this.zoom(2 ** (-event.deltaY / 200), at.x, at.y);
    }, { passive: false });
    canvas.addEventListener("dblclick", (event) => {
      const at = this.point(event);
      this.zoom(2, at.x, at.y);
    });
  }
}
