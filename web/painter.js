// painter: draws tiles with WebGL2. All tiles are slices of one texture array; a pass over some of them is one draw call.

import { SINGLE, TONES, compile } from "./shader.js";
import { SIDE } from "./tiles.js";

const SLOTS = 1024, FLOATS = 8; // of an instance: its area, its size, two slots
const UNIFORMS = ["viewport", "place", "gain", "offset", "tone", "mode", "kind"];

export class Painter {
  constructor(canvas, onRestored) {
    this.canvas = canvas;
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      this.start();
      onRestored();
    });
    this.start();
  }
  start() {
    const gl = (this.gl = this.canvas.getContext("webgl2", { alpha: false, antialias: false }));
    if (!gl) return;
    this.program = compile(gl);
    gl.useProgram(this.program);
    this.at = Object.fromEntries(UNIFORMS.map((n) => [n, gl.getUniformLocation(this.program, n)]));
    gl.enable(gl.SCISSOR_TEST);
    gl.bindTexture(gl.TEXTURE_2D_ARRAY, gl.createTexture());
    this.slots = Math.min(SLOTS, gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS));
    gl.texStorage3D(gl.TEXTURE_2D_ARRAY, 1, gl.RGBA16F, SIDE, SIDE, this.slots);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D_ARRAY, filter, gl.NEAREST);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    this.attribute("area", 4, 0);
    this.attribute("size", 2, 4);
    this.attribute("slots", 2, 6);
    this.holders = new Array(this.slots).fill(null); // the tile of each slot
    this.slotOf = new Map();
    this.next = 0;
  }
  attribute(name, count, offset) {
    const { gl } = this, place = gl.getAttribLocation(this.program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, gl.FLOAT, false, 4 * FLOATS, 4 * offset);
    gl.vertexAttribDivisor(place, 1);
  }
  get ready() {
    return !!this.gl && !this.gl.isContextLost();
  }
  /** The tiles that one pass may have; two passes of them stay in the slots. */
  get most() {
    return this.slots >> 1;
  }
  /** The slot of a tile, which is uploaded if need be; slots are used again in turn, but none twice in one pass. */
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
  /** Fills a rectangle of the canvas (top down) with a colour. */
  fill(x, y, w, h, colour) {
    const { gl, canvas } = this;
    gl.scissor(x, canvas.height - y - h, Math.max(0, w), Math.max(0, h));
    gl.clearColor(...colour, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }
  /**
   * Draws `pairs` of tiles, [one, other], coarse ones first. `pass` has pane and clip (rectangles of the canvas, top
   * down), place (the image's left and top in the pane, and its scale), width and height (of the image), mode, gain,
   * offset, tone, kind.
   */
  draw(pairs, pass) {
    const { gl, canvas, at } = this, { pane, clip } = pass;
    const some = pairs.slice(-(pass.mode === SINGLE ? this.most : this.most >> 1)), needed = new Set(some.flat());
    const instances = some.flatMap(([tile, other]) => {
      const unit = 2 ** tile.level, x = tile.tx * SIDE, y = tile.ty * SIDE;
      const area = [x * unit, y * unit, Math.min((x + tile.w) * unit, pass.width), Math.min((y + tile.h) * unit, pass.height)];
      return [...area, tile.w, tile.h, this.place(tile, needed), this.place(other, needed)];
    });
    gl.viewport(pane.x, canvas.height - pane.y - pane.h, pane.w, pane.h);
    gl.scissor(clip.x, canvas.height - clip.y - clip.h, Math.max(0, clip.w), Math.max(0, clip.h));
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(instances), gl.STREAM_DRAW);
    gl.uniform2f(at.viewport, pane.w, pane.h);
    gl.uniform3f(at.place, ...pass.place);
    gl.uniform1f(at.gain, pass.gain);
    gl.uniform1f(at.offset, pass.offset);
    gl.uniform1i(at.tone, TONES.indexOf(pass.tone));
    gl.uniform1i(at.mode, pass.mode);
    gl.uniform1i(at.kind, pass.kind);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, some.length);
  }
  /** The canvas as RGBA bytes, bottom row first. */
  pixels() {
    const { gl, canvas } = this, bytes = new Uint8Array(4 * canvas.width * canvas.height);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    return bytes;
  }
}
