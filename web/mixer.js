// mixer: the picture anew from its light groups, each times a factor and a tint. Its tiles are made here, from those of the
// groups, so that whatever draws, probes or keeps tiles takes a mix for a layer.

import { $ } from "./dom.js";
import { make } from "./tables.js";
import { Layer, SIDE, Tiles, halfToNumber, holds } from "./tiles.js";

const MOST = 4; // the largest factor
const KEPT = 1000; // tiles of a group, at most, beside those in sight
const NUMBERS = Float32Array.from({ length: 65536 }, (_, half) => halfToNumber(half));
const SLICE = 20; // ms of mixing between two frames
const sums = new Float32Array(4 * SIDE * SIDE), bits = new Uint32Array(sums.buffer); // of the tile at hand

/** The half float that is nearest to a float, which is given by its bits; beyond the largest, that. */
export function halfOf(float) {
  const sign = (float >>> 16) & 0x8000, exponent = (float >>> 23) & 255, fraction = float & 0x7fffff, shift = 126 - exponent;
  if (exponent < 102) return sign;
  if (exponent < 113) return sign | (((fraction | 0x800000) + (1 << (shift - 1))) >>> shift);
  return sign | Math.min(0x7bff, (((exponent - 112) << 23) + fraction + 0x1000) >>> 13);
}

/** Adds the colours of texels, each times its factor, to the sums. */
function addTexels(texels, [r, g, b]) {
  for (let i = 0; i < texels.length; i += 4) {
    sums[i] += r * NUMBERS[texels[i]];
    sums[i + 1] += g * NUMBERS[texels[i + 1]];
    sums[i + 2] += b * NUMBERS[texels[i + 2]];
  }
}

/** "#rrggbb" as linear factors. */
const tintOf = (colour) =>
  [1, 3, 5].map((at) => {
    const v = parseInt(colour.slice(at, at + 2), 16) / 255;
    return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
  });

/** The names in a job's light_groups: "key=3+4,sky=infinite,rest". */
const namesOf = (text) => (text ? text.split(",").map((one) => one.split("=")[0]) : []);

export class Mixer {
  /** `view` shows the mix; `first` are the tiles of the image without it; on.problem as Tiles has it; on.change() when a mix begins or ends. */
  constructor(view, first, on) {
    Object.assign(this, { view, first, on, job: null, text: "", weights: [], parts: [], layers: [], mixed: new Layer(), turn: 0, active: false, frame: 0 });
  }

  // ---- the controls

  /** Lists the groups of the job that is shown. */
  setJob(job) {
    const text = job?.light_groups ?? "";
    if ((job?.job ?? null) === this.job && text === this.text) return;
    this.stop();
    Object.assign(this, { job: job?.job ?? null, text, weights: [] });
    $("groups").replaceChildren(...namesOf(text).map((name, g) => this.control(name, g)));
    $("mixer").hidden = text === "";
  }
  control(name, g) {
    const factor = make("input", { type: "range", min: 0, max: MOST, step: 0.05, value: 1, id: `factor-${g}` });
    const tint = make("input", { type: "color", value: "#ffffff", id: `tint-${g}`, title: `tint of ${name}` });
    tint.setAttribute("aria-label", `tint of ${name}`);
    const shown = make("output", { textContent: "1" });
    const change = () => {
      shown.textContent = String(Number(factor.value));
      this.weights[g] = tintOf(tint.value).map((v) => v * factor.value);
      this.start();
    };
    for (const input of [factor, tint]) input.addEventListener("input", change);
    this.weights[g] = [1, 1, 1];
    return make("span", {}, make("label", {}, `${name} `, factor, " ", shown), " ", tint);
  }

  // ---- beginning and ending

  start() {
    if (!this.active) {
      this.active = true;
      namesOf(this.text).forEach((_, g) => this.fetch(g));
      this.layers = this.parts.slice(0, namesOf(this.text).length).map((part) => part.layer);
      this.on.change();
    }
    this.turn++;
    this.refresh();
  }
  /** Has the tiles of a group fetched. */
  fetch(g) {
    const view = { wanted: () => this.view.wanted(), taken: (layer, fresh) => this.taken(layer, fresh) };
    this.parts[g] ??= new Tiles(view, { problem: (text) => this.on.problem(text) });
    this.parts[g].show(this.job, `group${g}`);
    if (this.first.busyNow) this.parts[g].wake();
  }
  /** Back to the picture; all factors are 1 again. */
  stop() {
    if (!this.active) return;
    this.active = false;
    for (const part of this.parts) part.show(null, "picture");
    this.mixed = new Layer();
    for (const control of $("groups").children) {
      control.querySelector("input[type=range]").value = 1;
      control.querySelector("input[type=color]").value = "#ffffff";
      control.querySelector("output").textContent = "1";
    }
    this.weights.fill([1, 1, 1]);
    this.on.problem("");
    this.view.show(this.first.layer, this.first.name);
    this.on.change();
  }

  // ---- tiles

  /** Has what is in sight mixed by the factors of now, some of it in each frame. What is not in sight waits until it is. */
  refresh() {
    if (this.active && !this.frame) this.frame = requestAnimationFrame(() => this.slice());
  }
  slice() {
    const wanted = this.view.wanted(), made = [], end = performance.now() + SLICE;
    this.frame = 0;
    if (!this.active || !wanted) return;
    for (const tile of this.layers[0].within(wanted.level, wanted.rect)) {
      if (this.mixed.get(tile.level, tile.tx, tile.ty)?.turn === this.turn) continue;
      if (performance.now() > end) {
        this.refresh();
        break;
      }
      made.push(...this.mix(tile));
    }
    this.put(made);
  }
  /** Shows the mix as soon as there is some of it. */
  put(made) {
    if (!made.length) return;
    if (this.view.layer !== this.mixed) this.view.show(this.mixed, "mix");
    this.view.taken(this.mixed, made);
  }
  taken(layer, fresh) {
    if (!this.active) return;
    const wanted = this.view.wanted();
    layer.forget(KEPT, (tile) => tile.level === wanted?.level && holds(wanted.rect, tile));
    this.put(fresh.flatMap((tile) => this.mix(tile)));
  }
  /** The mix of the groups' tiles at the place of a tile; none as long as one is missing. */
  mix({ level, tx, ty, w, h }) {
    const tiles = this.layers.map((layer) => layer.get(level, tx, ty));
    if (tiles.includes(undefined)) return [];
    const texels = new Uint16Array(4 * w * h), version = Math.min(...tiles.map((tile) => tile.asOf));
    sums.fill(0);
    tiles.forEach((tile, g) => addTexels(tile.texels, this.weights[g]));
    for (let i = 0; i < texels.length; i++) texels[i] = halfOf(bits[i]);
    return this.mixed.take({ version, level, tiles: [{ tx, ty, w, h, texels, turn: this.turn }] }, { tx0: tx, ty0: ty, tx1: tx + 1, ty1: ty + 1 });
  }
}
