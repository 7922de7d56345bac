// curve: the error of a job against time or samples, log-log, with its target and the fit by n^-1/2; and what follows
// from the fit. SVG.

const SVG = "http://www.w3.org/2000/svg";
const WIDTH = 480, HEIGHT = 220, LEFT = 52, RIGHT = 10, TOP = 10, BOTTOM = 34;
const LETTER = 7; // the width of a letter, at most

/** The points that a logarithm exists of. */
export const usable = (points) => points.filter((p) => p.error > 0 && p.samples > 0 && p.elapsed > 0 && isFinite(p.error));

/**
 * The constant c of error = c * samples^-1/2, by least squares of the logarithms. The later half alone: the estimates of
 * the first samples are poor. null without points.
 */
export function fit(points) {
  const good = usable(points).slice(-Math.ceil(usable(points).length / 2));
  if (good.length === 0) return null;
  return Math.exp(good.reduce((sum, p) => sum + Math.log(p.error) + 0.5 * Math.log(p.samples), 0) / good.length);
}

/** Seconds of work from the last point until the fit reaches the target; null when that is not known. */
export function secondsToTarget(points, target) {
  const c = fit(points), last = usable(points).at(-1);
  if (c === null || !(target > 0)) return null;
  return Math.max(0, ((c / target) ** 2 / last.samples - 1) * last.elapsed);
}

function make(parent, name, attributes, text) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (text !== undefined) element.textContent = text;
  parent.append(element);
  return element;
}

/** Some round numbers of a range that holds hardly a power of ten. */
function evenTicks(low, high) {
  const step = 10 ** Math.floor(Math.log10(high - low)), by = (high - low) / step < 3 ? step / 2 : step;
  const first = Math.ceil(low / by), count = Math.floor(high / by) - first + 1, every = Math.ceil(count / 5);
  return Array.from({ length: count }, (_, i) => (first + i) * by).filter((_, i) => i % every === 0);
}

/** The powers of ten (and, in a short range, 2 and 5 times these) from `low` to `high`. */
function ticks(low, high) {
  const steps = Math.log10(high / low) < 2.2 ? [1, 2, 5] : [1];
  const found = [];
  for (let e = Math.floor(Math.log10(low)); e <= Math.ceil(Math.log10(high)); e++)
    for (const s of steps) if (s * 10 ** e >= low * 0.999 && s * 10 ** e <= high * 1.001) found.push(s * 10 ** e);
  if (found.length < 2) return evenTicks(low, high);
  const every = Math.ceil(found.length / 7);
  return found.filter((_, i) => i % every === 0);
}

const scale = (low, high, from, to) => (v) => from + (Math.log(v / low) / Math.log(high / low)) * (to - from);
const line = (points) => points.map(([x, y], i) => `${i ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("");

function range(values, room) {
  const low = Math.min(...values), high = Math.max(...values);
  return [low / room, high * room];
}

function drawAxes(svg, x, y, xs, ys, by, format) {
  for (const v of ticks(...xs)) {
    make(svg, "path", { class: "grid", d: `M${x(v)} ${TOP}V${HEIGHT - BOTTOM}` });
    const text = by === "elapsed" ? format.duration(v) : format.count(v), last = WIDTH - (LETTER * text.length) / 2; // fits there
    make(svg, "text", { x: Math.min(x(v), last), y: HEIGHT - BOTTOM + 14, "text-anchor": "middle" }, text);
  }
  for (const v of ticks(...ys)) {
    make(svg, "path", { class: "grid", d: `M${LEFT} ${y(v)}H${WIDTH - RIGHT}` });
    make(svg, "text", { x: LEFT - 5, y: y(v) + 4, "text-anchor": "end" }, format.percent(v));
  }
  make(svg, "text", { x: (LEFT + WIDTH - RIGHT) / 2, y: HEIGHT - 4, "text-anchor": "middle" }, by === "elapsed" ? "time" : "samples");
}

/** Where the fit is at a point of the horizontal axis; time and samples are proportional at the last point. */
function fitAt(points, c, by) {
  const last = usable(points).at(-1);
  const samples = by === "samples" ? (v) => v : (v) => (v * last.samples) / last.elapsed;
  return (v) => c / Math.sqrt(samples(v));
}

/** Draws the curve of `points` into an svg element. `by` is "elapsed" or "samples", `target` 0 for none. */
export function drawCurve(svg, points, target, by, format) {
  svg.replaceChildren();
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  const good = usable(points);
  if (good.length === 0) return;
  const c = fit(good), model = fitAt(good, c, by), at = good.map((p) => p[by]);
  const more = target > 0 && target < good.at(-1).error ? Math.min((good.at(-1).error / target) ** 2, 100) : 1.5;
  const xs = range([...at, at.at(-1) * more], 1.05), ys = range([...good.map((p) => p.error), ...(target > 0 ? [target] : [])], 1.2);
  const x = scale(...xs, LEFT, WIDTH - RIGHT), y = scale(...ys, HEIGHT - BOTTOM, TOP);
  drawAxes(svg, x, y, xs, ys, by, format);
  const clip = (v) => Math.min(Math.max(y(v), TOP), HEIGHT - BOTTOM);
  const low = Math.max(xs[0], xs[0] * (model(xs[0]) / ys[1]) ** 2), high = Math.min(xs[1], xs[0] * (model(xs[0]) / ys[0]) ** 2);
  if (low < high) make(svg, "path", { class: "fit", d: line([[x(low), clip(model(low))], [x(high), clip(model(high))]]) });
  if (target > 0) make(svg, "path", { class: "target", d: `M${LEFT} ${y(target)}H${WIDTH - RIGHT}` });
  make(svg, "path", { class: "error", d: line(good.map((p) => [x(p[by]), y(p.error)])) });
  make(svg, "circle", { class: "now", cx: x(at.at(-1)), cy: y(good.at(-1).error), r: 3.5 });
}
