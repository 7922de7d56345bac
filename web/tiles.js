// tiles: the parts of a job's image that are in this page: what is fetched when, what each tile holds, how old it is.

import { getBytes } from "./api.js";

export const SIDE = 64;
const HEAD = 28;
const SPEED = 2.5e6; // bytes a second that the page takes for images that change, at most
const PAUSE = 1000; // ms between two questions, at least
const MOST_LAYERS = 4; // of a job whose tiles are kept

/** Decodes an answer: { version, width, height, level, tiles: [{ tx, ty, w, h, texels }] }; texels are RGBA halves. */
export function decode(buffer) {
  const view = new DataView(buffer), word = (i) => view.getUint32(4 + 4 * i, true);
  if (buffer.byteLength < HEAD || view.getUint32(0, true) !== 0x31544d4c) throw new Error("This is no answer of tiles.");
  const [version, width, height, level, , count] = [0, 1, 2, 3, 4, 5].map(word);
  const tiles = [];
  for (let i = 0, at = HEAD; i < count; i++) {
    const [tx, ty, w, h] = [0, 2, 4, 6].map((k) => view.getUint16(at + k, true));
    tiles.push({ tx, ty, w, h, texels: new Uint16Array(buffer.slice(at + 8, at + 8 + 8 * w * h)) });
    at += 8 + 8 * w * h;
  }
  return { version, width, height, level, tiles };
}

/** A half float as a number. */
export function halfToNumber(half) {
  const exponent = (half >> 10) & 31, fraction = half & 1023, sign = half >> 15 ? -1 : 1;
  if (exponent === 0) return (sign * fraction) / 2 ** 24;
  if (exponent === 31) return fraction ? NaN : sign * Infinity;
  return sign * 2 ** (exponent - 15) * (1 + fraction / 1024);
}

export const levelSide = (side, level) => Math.max(1, Math.ceil(side / 2 ** level));
export const levelCount = (width, height) => {
  let count = 1;
  while (levelSide(Math.max(width, height), count - 1) > SIDE) count++;
  return count;
};

/** The id in three channels of a texel: a half is a whole number up to 2048 only. */
export const idOf = (rgb) => rgb[0] + 2048 * rgb[1] + 2048 ** 2 * rgb[2];

/** The tiles that two rectangles of tiles have in common. */
export const intersect = (a, b) => ({ tx0: Math.max(a.tx0, b.tx0), ty0: Math.max(a.ty0, b.ty0), tx1: Math.min(a.tx1, b.tx1), ty1: Math.min(a.ty1, b.ty1) });

/** How many tiles a rectangle has, and whether a tile of its level is one of them. */
export const countOf = (rect) => (rect.tx1 - rect.tx0) * (rect.ty1 - rect.ty0);
export const holds = (rect, { tx, ty }) => tx >= rect.tx0 && tx < rect.tx1 && ty >= rect.ty0 && ty < rect.ty1;

const keyOf = (level, tx, ty) => `${level}/${tx}/${ty}`;

/** The tiles of one layer of one job. */
export class Layer {
  tiles = new Map(); // of keyOf: { level, tx, ty, w, h, texels, asOf: the version that it was seen to be current at }
  held = null; // of what is kept as it was: { level, rect }, and there are no other tiles
  /** Tiles of one level that stay as they are; their texels are shared. */
  static hold({ level, rect, tiles }) {
    const layer = new Layer();
    layer.held = { level, rect };
    for (const tile of tiles) layer.tiles.set(keyOf(level, tile.tx, tile.ty), { ...tile });
    return layer;
  }
  get(level, tx, ty) {
    return this.tiles.get(keyOf(level, tx, ty));
  }
  take(answer, rect) {
    const fresh = [];
    for (const tile of answer.tiles) {
      const key = keyOf(answer.level, tile.tx, tile.ty);
      this.tiles.delete(key); // to the end: the least recent go first
      this.tiles.set(key, { ...tile, level: answer.level, asOf: answer.version });
      fresh.push(this.tiles.get(key));
    }
    for (const tile of this.within(answer.level, rect)) tile.asOf = answer.version;
    return fresh;
  }
  *within(level, rect) {
    for (let ty = rect.ty0; ty < rect.ty1; ty++)
      for (let tx = rect.tx0; tx < rect.tx1; tx++) if (this.get(level, tx, ty)) yield this.get(level, tx, ty);
  }
  /** What to ask for to see a rectangle of tiles: that of the missing ones, else all that changed. */
  question(level, rect) {
    const missing = { tx0: Infinity, ty0: Infinity, tx1: 0, ty1: 0 };
    let since = Infinity;
    for (let ty = rect.ty0; ty < rect.ty1; ty++)
      for (let tx = rect.tx0; tx < rect.tx1; tx++) {
        const tile = this.get(level, tx, ty);
        if (tile) since = Math.min(since, tile.asOf);
        else Object.assign(missing, { tx0: Math.min(missing.tx0, tx), ty0: Math.min(missing.ty0, ty), tx1: Math.max(missing.tx1, tx + 1), ty1: Math.max(missing.ty1, ty + 1) });
      }
    return missing.tx1 > 0 ? { rect: missing, since: 0 } : { rect, since };
  }
  forget(limit, keep) {
    for (const [key, tile] of this.tiles) {
      if (this.tiles.size <= limit) return;
      if (!keep(tile)) this.tiles.delete(key);
    }
  }
}

/**
 * Fetches what a view needs. `view` has wanted() -> { level, rect } or null, and taken(layer, fresh), which is told of new
 * tiles; on.problem(text) is told of failures, and of "" when all is well again.
 */
export class Tiles {
  static all = []; // they share the speed
  constructor(view, on) {
    Tiles.all.push(this);
    Object.assign(this, { view, on, job: null, name: "picture", layers: new Map(), latest: 0, timer: 0, busy: null, asleep: true, bytes: 0, version: 0, empty: 0 });
  }
  get layer() {
    const key = `${this.job}/${this.name}`;
    const layer = this.layers.get(key) ?? new Layer();
    this.layers.delete(key); // to the end: the least recent go first
    this.layers.set(key, layer);
    for (const old of this.layers.keys()) if (this.layers.size > MOST_LAYERS) this.layers.delete(old);
    return layer;
  }
  /** Shows another job or layer. */
  show(job, name) {
    if (job !== this.job) {
      this.layers.clear();
      this.latest = this.version = 0;
    }
    Object.assign(this, { job, name, empty: 0 });
    if (job === null) this.on.problem("");
    this.restart();
  }
  get busyNow() {
    return this.job !== null && !this.asleep;
  }
  /** The master says that there is a version. */
  announce(version) {
    if (version <= this.latest) return;
    this.latest = version;
    this.soon(0);
  }
  /** What was seen may be from another life of the master: all is asked for again. */
  distrust() {
    for (const layer of this.layers.values()) for (const tile of layer.tiles.values()) tile.asOf = 0;
    this.latest = 0;
    this.restart();
  }
  sleep() {
    this.asleep = true;
    this.busy?.abort();
    clearTimeout(this.timer);
    this.timer = 0;
  }
  wake() {
    this.asleep = false;
    this.restart();
  }
  /** What is wanted has changed. */
  restart() {
    this.busy?.abort();
    this.busy = null;
    clearTimeout(this.timer);
    this.timer = 0;
    this.soon(0);
  }
  soon(wait) {
    if (this.asleep || this.job === null || this.timer || this.busy) return;
    this.timer = setTimeout(() => this.ask(), wait);
  }
  /** Asks once; then again while there is more to come. */
  async ask() {
    this.timer = 0;
    const wanted = this.view.wanted();
    if (!wanted || this.asleep) return;
    const { job, name, layer } = this, question = layer.question(wanted.level, wanted.rect), r = question.rect;
    if (question.since !== 0 && question.since >= this.latest && this.version === question.since) return;
    const busy = (this.busy = new AbortController());
    let wait = PAUSE;
    try {
      const path = `/jobs/${job}/tiles?layer=${name}&level=${wanted.level}&since=${question.since}&x0=${r.tx0 * SIDE}&y0=${r.ty0 * SIDE}&x1=${r.tx1 * SIDE}&y1=${r.ty1 * SIDE}`;
      const buffer = await getBytes(path, busy.signal);
      if (busy.signal.aborted) return;
      this.bytes += buffer.byteLength;
      wait = Math.max(PAUSE, (1000 * buffer.byteLength * Tiles.all.filter((one) => one.busyNow).length) / SPEED);
      const answer = decode(buffer);
      if (this.take(layer, answer, r)) wait = 50; // the rest of what is missing
      this.empty = answer.version === 0 ? this.empty + 1 : 0;
      if (this.empty) wait = Math.min(PAUSE, 50 * 2 ** this.empty); // the first snapshot is being made
      this.on.problem("");
    } catch (error) {
      if (busy.signal.aborted) return;
      this.on.problem(error.message);
      wait = 3000;
    } finally {
      if (this.busy === busy) this.busy = null;
    }
    this.soon(wait);
  }
  /** True when there is more to ask for at once. */
  take(layer, answer, rect) {
    if (answer.version === 0) return false;
    this.version = answer.version;
    this.latest = Math.max(this.latest, answer.version);
    this.view.taken(layer, layer.take(answer, rect));
    const wanted = this.view.wanted();
    return wanted !== null && layer.question(wanted.level, wanted.rect).since === 0;
  }
}
