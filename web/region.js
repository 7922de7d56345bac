// region: the mean of a rectangle of the image and the standard error of that mean, from its texels at the finest level
// that can be fetched.

import { SIDE, Tiles, countOf, halfToNumber, holds, idOf } from "./tiles.js";

const MOST_TILES = 1024; // that one question may ask for
const LUMINANCE = [0.2126, 0.7152, 0.0722], FIRST = [1, 0, 0];
/** Layers with one number a pixel, which is in the first channel. */
export const SINGLE_NUMBERS = ["samples", "depth"];
/** Layers of ids, of which there is no mean. */
const ID_LAYERS = ["object", "material"];

/** The tiles that hold a rectangle of pixels at a level. */
const tilesOf = (mark, level) => {
  const unit = SIDE * 2 ** level;
  return { tx0: Math.floor(mark.x0 / unit), ty0: Math.floor(mark.y0 / unit), tx1: Math.ceil(mark.x1 / unit), ty1: Math.ceil(mark.y1 / unit) };
};

/** The finest level of which few enough tiles hold the rectangle. */
export function levelOf(mark) {
  for (let level = 0; ; level++) if (countOf(tilesOf(mark, level)) <= MOST_TILES) return level;
}

/** The part of texel `i` of a level, in pixels, that lies between two pixels. */
const overlap = (i, unit, from, to) => Math.max(0, Math.min((i + 1) * unit, to) - Math.max(i * unit, from));

const weighted = (rgb, weights) => rgb.reduce((sum, value, c) => sum + weights[c] * value, 0);

/** Adds the texels of a tile to `sums`, each with as many pixels of the rectangle as it stands for. */
function addTile(sums, tile, mark) {
  const unit = 2 ** tile.level;
  for (let v = 0; v < tile.h; v++) {
    const rows = overlap(SIDE * tile.ty + v, unit, mark.y0, mark.y1);
    for (let u = 0; rows > 0 && u < tile.w; u++) {
      const pixels = rows * overlap(SIDE * tile.tx + u, unit, mark.x0, mark.x1);
      if (pixels > 0) addTexel(sums, tile.texels, 4 * (v * tile.w + u), pixels);
    }
  }
}

function addTexel(sums, texels, at, pixels) {
  const rgb = [0, 1, 2].map((c) => halfToNumber(texels[at + c])), y = weighted(rgb, sums.weights);
  sums.pixels += pixels;
  if (sums.ids && idOf(rgb) !== 0) sums.ids.add(idOf(rgb));
  if (sums.ids) return;
  rgb.forEach((value, c) => (sums.rgb[c] += pixels * value));
  sums.variance += (pixels * halfToNumber(texels[at + 3])) ** 2;
  sums.least = Math.min(sums.least, y);
  sums.most = Math.max(sums.most, y);
}

/**
 * { level, pixels, rgb, mean, error, least, most } of a rectangle of a layer; null while tiles are missing. `mean` is of the
 * luminance, or of the layer's only number; of ids there is only their number, `ids`; `error` is the standard error of that mean, as if pixels were independent.
 */
export function measure(layer, name, mark, level) {
  const r = tilesOf(mark, level), tiles = [...layer.within(level, r)];
  if (tiles.length < countOf(r)) return null;
  const weights = SINGLE_NUMBERS.includes(name) ? FIRST : LUMINANCE;
  const sums = { weights, ids: ID_LAYERS.includes(name) ? new Set() : null, pixels: 0, rgb: [0, 0, 0], variance: 0, least: Infinity, most: -Infinity };
  for (const tile of tiles) addTile(sums, tile, mark);
  if (sums.ids) return { level, pixels: sums.pixels, ids: sums.ids.size };
  const rgb = sums.rgb.map((sum) => sum / sums.pixels);
  return { level, pixels: sums.pixels, rgb, mean: weighted(rgb, weights), error: Math.sqrt(sums.variance) / sums.pixels, least: sums.least, most: sums.most };
}

export class Region {
  /** on.problem as Tiles has it; on.change() is told when `found`, what measure finds, is another. */
  constructor(on) {
    Object.assign(this, { on, mark: null, found: null });
    this.tiles = new Tiles({ wanted: () => this.wanted(), taken: (layer) => this.taken(layer) }, on);
  }
  wanted() {
    const level = this.mark && levelOf(this.mark);
    return this.mark && { level, rect: tilesOf(this.mark, level) };
  }
  taken(layer) {
    const { level, rect } = this.wanted();
    layer.forget(0, (tile) => tile.level === level && holds(rect, tile));
    this.found = measure(layer, this.tiles.name, this.mark, level);
    this.on.change();
  }
  /** Measures a rectangle of a job's layer, and again when the image changes; null: none. */
  show(job, name, mark) {
    if (job === this.tiles.job && name === this.tiles.name && mark && this.mark && ["x0", "y0", "x1", "y1"].every((k) => mark[k] === this.mark[k])) return;
    Object.assign(this, { mark, found: null });
    this.tiles.show(mark ? job : null, name);
    if (mark) this.found = measure(this.tiles.layer, name, mark, levelOf(mark)); // as old as it is; what has changed comes
    this.on.change();
  }
}
