// app: puts the page together: what is chosen, what is asked of the master when, and what keys and buttons do.

import { get, hasToken, setToken, takeToken, watchEvents } from "./api.js";
import { drawCurve, secondsToTarget, usable } from "./curve.js";
import { Compare, WAYS } from "./compare.js";
import { $, setOptions, setText } from "./dom.js";
import { Mixer } from "./mixer.js";
import { OVER, Orders } from "./orders.js";
import { Region, SINGLE_NUMBERS, levelOf } from "./region.js";
import { TONES } from "./shader.js";
import { addEvent, format, jobNews, noteText, showJobs, showWorkers, workerNews, workerText } from "./tables.js";
import { Tiles, idOf } from "./tiles.js";
import { View } from "./view.js";

const EVERY = 5000; // ms: what changes is asked for again while no events come;
const ROUNDS = 5; // while they do, every fifth time: times and speeds change without one

const state = { jobs: null, workers: null, chosen: null, points: [], operate: true, line: "connecting", wasLost: false };
let awake = null; // aborted when the page is hidden

// ---- the image

const view = new View($("canvas"), () => moved(), () => showProbe(), () => marked());
const problems = new Map(); // what each of those who fetch tiles has to say
const problemOf = (who) => (text) => {
  problems.set(who, text);
  setText("problem", [...problems.values()].find((one) => one) ?? "");
};
const tiles = new Tiles(view, { problem: problemOf("image") });
const compare = new Compare(view, tiles, { problem: problemOf("other"), change: () => showComparison(), title: (name) => [...$("layer").options].find((one) => one.value === name)?.text ?? name });
const mixer = new Mixer(view, tiles, { problem: problemOf("groups"), change: () => showMix() });
const region = new Region({ problem: problemOf("region"), change: () => showRegion() });

let settle = 0;
function moved() {
  setText("zoom", `${format.number(100 * view.scale)} %`);
  clearTimeout(settle);
  settle = setTimeout(() => [tiles, compare.second, ...mixer.parts].forEach((one) => one.restart()), 80); // when the hand rests
  mixer.refresh();
  showProbe();
}

const percent = (share) => `${Math.round(100 * share)} %`;
const idText = (kind) => (...rgb) => (idOf(rgb) ? `${kind} ${idOf(rgb)}` : `no ${kind}`);
const MEANS = { samples: (v) => `${Math.round(1024 * v)} samples`, depth: (v) => `depth ${format.number(v)}`, object: idText("object"), material: idText("material"), strategies: (eye, _, light) => `eye ${percent(eye)}, light ${percent(light)}` };

/** A pixel's value in a layer, in words. */
function valueText(name, at) {
  if (MEANS[name]) return MEANS[name](...at.rgb);
  return at.rgb.map(format.number).join("  ") + (name === "picture" ? ` ± ${format.number(at.error)}` : "");
}

const meanText = ({ side }) => (side > 1 ? ` (mean of ${side} × ${side})` : "");

function showProbe() {
  const at = view.probed(), other = view.other && view.probed(view.other.layer);
  if (!at) return setText("probe", "Point at a pixel to see its value.");
  const second = other ? `; compared with ${valueText(view.other.name, other)}${meanText(other)}` : "";
  setText("probe", `${at.x}, ${at.y}: ${valueText(mixer.active ? "mix" : tiles.name, at)}${meanText(at)}${second}`);
}

// ---- the rectangle

let rest = 0;
function marked() {
  $("unmark").hidden = !view.mark;
  $("mark").setAttribute("aria-pressed", String(view.marking || view.stretching));
  $("divider").value = Math.round(100 * view.divider);
  clearTimeout(rest);
  const measure = () => region.show(state.chosen, tiles.name, mixer.active ? null : view.mark);
  if (view.mark) rest = setTimeout(measure, 80);
  else measure();
}

function showRegion() {
  const { mark, found, tiles: from } = region;
  if (!mark) return setText("region", mixer.active && view.mark ? "A mix is not measured: reset the light groups first." : "");
  const area = `Rectangle from ${mark.x0}, ${mark.y0}, ${mark.x1 - mark.x0} × ${mark.y1 - mark.y0}`;
  if (!found) return setText("region", `${area}: ...`);
  if (found.ids !== undefined) return setText("region", `${area}: ${found.ids} different ids${found.level ? ` (of level ${found.level})` : ""}`);
  const level = levelOf(mark), unit = from.name === "samples" ? 1024 : 1, number = (v) => format.number(unit * v);
  const single = SINGLE_NUMBERS.includes(from.name), error = from.name === "picture" ? ` ± ${number(found.error)}` : "";
  const value = single ? `mean ${number(found.mean)}` : `mean ${found.rgb.map(format.number).join("  ")}`;
  const y = from.name === "normal" ? "" : `${single ? "" : `; luminance ${number(found.mean)}${error}`}, from ${number(found.least)} to ${number(found.most)}`;
  setText("region", `${area}: ${value}${y}${level ? ` (of level ${level}: texels of ${2 ** level} × ${2 ** level} pixels)` : ""}`);
}

function toggleMark() {
  view.marking = !view.marking;
  marked();
}

// ---- the mix of light groups

function showMix() {
  compare.shown = mixer.active ? "mix" : "";
  $("unmix").disabled = !mixer.active;
  showComparison();
  marked();
  showProbe();
}

// ---- the comparison

const LAYERS = () => [...$("layer").options].filter((one) => !one.disabled).map((one) => [one.value, one.text]);

function showComparison() {
  setOptions($("other"), compare.choices(LAYERS()), compare.what);
  $("how").value = compare.how;
  $("how").disabled = compare.what === "";
  $("divider-label").hidden = !view.wipes;
  $("both").setAttribute("aria-pressed", String(showsBoth()));
  setText("comparison", compare.describe());
}

const showsBoth = () => tiles.name === "eye" && compare.what === "layer:light" && compare.how === "side" && !!view.other;

/** Eye and light image beside one another; again: the picture alone. */
function toggleBoth() {
  const both = showsBoth();
  compare.choose(both ? "" : "layer:light", "side");
  setLayer(both ? "picture" : "eye");
}

function moveDivider(by) {
  if (view.wipes) view.setDivider(view.divider + by);
}

function setTone() {
  view.exposure = Number($("exposure").value);
  view.offset = Number($("offset").value);
  view.tone = $("tone").value;
  setText("exposure-value", String(view.exposure));
  setText("offset-value", String(view.offset));
  view.draw();
}

function setLayer(name) {
  mixer.stop();
  $("layer").value = name;
  tiles.show(state.chosen, name);
  view.show(tiles.layer, name);
  compare.follow();
  showComparison();
  marked();
}

// ---- what is chosen

const job = () => state.jobs?.find((one) => one.job === state.chosen);
const hash = () => new URLSearchParams(location.hash.slice(1));

function choose(number) {
  if (number === state.chosen) return;
  state.chosen = number;
  state.points = [];
  if (number !== null) history.replaceState(null, "", `#job=${number}`);
  orders.clear();
  showAll();
  tiles.show(number, $("layer").value);
  if (number !== null) view.show(tiles.layer, $("layer").value);
  compare.setJobs(job() ?? null, state.jobs);
  marked();
  ask.history();
}

/** The job that somebody looked at last; else the one at work, else the newest. */
function chooseSome() {
  const wanted = Number(hash().get("job"));
  if (job()) return;
  const pick = state.jobs.find((one) => one.job === wanted) ?? state.jobs.find((one) => one.state === "running") ?? state.jobs.at(-1);
  choose(pick ? pick.job : null);
}

// ---- what is shown

const FEATURES = ["albedo", "normal", "depth", "object", "material"], HALVES = ["half0", "half1"];
/** A job may be without features; its halves are gone when it is over, unless its image has them. */
const hasLayer = (one, name) => (FEATURES.includes(name) ? one.layers : HALVES.includes(name) ? one.halves || !OVER.includes(one.state) : true);

function showTitle() {
  const one = job();
  const parts = one ? [`Job ${one.job}: ${one.name}`, `${one.width} × ${one.height}`, one.integrator, one.state] : ["No job"];
  setText("image-title", parts.join(", "));
  document.title = one ? `${one.name} (${one.state}) - Lightmill` : "Lightmill";
  view.setImage(one?.width ?? 0, one?.height ?? 0);
  mixer.setJob(one ?? null);
  for (const option of $("layer").options) option.disabled = !!one && !hasLayer(one, option.value);
}

function showCurve() {
  const one = job(), points = state.points, target = one?.error_target ?? 0, last = usable(points).at(-1);
  drawCurve($("curve"), points, target, $("against").value, format);
  const eta = secondsToTarget(points, target);
  const now = last ? `${format.percent(last.error)} after ${format.duration(last.elapsed)}` : "no error is known yet";
  const goal = !(target > 0) ? "" : eta === null ? `; target ${format.percent(target)}` : eta === 0 ? `; the target of ${format.percent(target)} is reached` : `; ${format.percent(target)} in about ${format.duration(eta)}`;
  setText("eta", now + goal);
  $("curve").setAttribute("aria-label", `Error of the image: ${now}${goal}`);
}

function showAll() {
  if (!state.jobs) return;
  showJobs($("jobs"), state.jobs, state.chosen, choose);
  $("no-jobs").hidden = state.jobs.length > 0;
  showTitle();
  orders.show();
  showCurve();
}

// ---- what is asked of the master

function note(what) {
  addEvent($("events"), typeof what === "string" ? { text: what } : what);
}

/** Runs `work` when asked, never twice at a time and at most every `least` ms; asked meanwhile, once more. */
function paced(least, work) {
  let running = false, again = false, last = 0;
  const run = async () => {
    if (running || !awake) return void (again = true);
    running = true;
    again = false;
    const wait = last + least - performance.now();
    if (wait > 0) await new Promise((done) => setTimeout(done, wait));
    last = performance.now();
    try {
      if (awake) await work(awake.signal);
    } catch (error) {
      if (error.status === 401) refused();
      else if (error.name !== "AbortError" && error.status) setText("problem", error.message);
    }
    running = false;
    if (again && awake) run();
  };
  return run;
}

const ask = {
  jobs: paced(500, async (signal) => {
    const before = state.jobs;
    state.jobs = (await get("/jobs", signal)).jobs;
    if (before) jobNews(before, state.jobs).forEach(note);
    chooseSome();
    showAll();
    compare.setJobs(job() ?? null, state.jobs);
    showComparison();
    for (const one of state.jobs) announce(one.job, one.batches);
  }),
  workers: paced(1000, async (signal) => {
    const before = state.workers;
    state.workers = (await get("/workers", signal)).workers;
    if (before && state.line === "asking") workerNews(before, state.workers).forEach(note); // else events tell
    showWorkers($("workers"), state.workers);
    $("no-workers").hidden = state.workers.length > 0;
    const at = state.workers.filter((one) => one.connected), sum = (what) => at.reduce((total, one) => total + one[what], 0);
    setText("farm", `${at.length} worker${at.length === 1 ? "" : "s"}, ${sum("threads")} threads, ${format.count(sum("speed"))} samples/s`);
  }),
  history: paced(1000, async (signal) => {
    const number = state.chosen;
    if (number === null) return;
    const { points } = await get(`/jobs/${number}/history`, signal);
    if (number !== state.chosen) return;
    state.points = points;
    showCurve();
  }),
  all() {
    ask.jobs();
    ask.workers();
    ask.history();
  },
};

/** A job's image has a version. */
function announce(number, version) {
  for (const one of Tiles.all) if (one.job === number) one.announce(version);
}

const orders = new Orders({ job, refused: () => refused(), given: () => ask.jobs(), exposure: () => view.exposure });

const on = {
  job: () => ask.jobs(),
  worker(data) {
    note(workerText(data));
    ask.workers();
  },
  note(data) {
    note(noteText(data));
    ask.jobs();
  },
  lost: () => ask.all(),
  image(data) {
    announce(data.job, data.version);
    if (data.job !== state.chosen) return;
    ask.history();
    ask.jobs();
  },
};

const LINES = { connecting: "connecting", live: "live", asking: "live, asked every few seconds", lost: "connection lost, trying again", back: "the master came back", hidden: "paused: the tab is hidden" };

function showLine(line) {
  state.line = line;
  $("connection").className = line;
  setText("connection", LINES[line]);
}

function onState(line) {
  if (line === "refused") return refused();
  if (line === "lost") {
    if (state.line !== "lost") note("The connection to the master was lost.");
    state.wasLost = true;
    Tiles.all.forEach((one) => one.sleep());
    return showLine("lost");
  }
  if (line === "asking" && state.line === "asking") return;
  showLine(state.wasLost ? "back" : line);
  if (state.wasLost) {
    note("The master came back.");
    setTimeout(() => state.line === "back" && showLine(line), 5000);
  }
  // It may be another process, whose numbers begin at its last checkpoint.
  if (state.wasLost) Tiles.all.forEach((one) => one.distrust());
  state.wasLost = false;
  Tiles.all.forEach((one) => one.wake());
  ask.all();
}

// ---- keys

const nudge = (id, by) => () => {
  $(id).value = Number($(id).value) + by;
  setTone();
};
const turn = (select, by) => () => {
  const options = [...select.options].filter((o) => !o.disabled), at = options.indexOf(select.selectedOptions[0]);
  select.value = options[(at + by + options.length) % options.length].value;
  select.dispatchEvent(new Event("change"));
};
const nextJob = (by) => () => {
  const at = state.jobs?.indexOf(job()) ?? -1;
  if (at >= 0) choose(state.jobs[(at + by + state.jobs.length) % state.jobs.length].job);
};

// [keys, what they do, the action]
const KEYS = [
  [["?"], "shows and hides this list", () => ($("help").open ? $("help").close() : $("help").showModal())],
  [["+", "="], "zooms in", () => view.zoom(2)],
  [["-"], "zooms out", () => view.zoom(0.5)],
  [["0"], "fits the image into its place", () => view.fit()],
  [["1"], "shows a pixel of the image as one of the screen", () => view.actual()],
  [["e"], "brighter by half a stop", nudge("exposure", 0.5)],
  [["E"], "darker by half a stop", nudge("exposure", -0.5)],
  [["r"], "exposure and offset 0, colours sRGB", () => reset()],
  [["l"], "next layer", turn($("layer"), 1)],
  [["L"], "previous layer", turn($("layer"), -1)],
  [["c"], "next colours: sRGB, filmic, false colour, relative error", turn($("tone"), 1)],
  [["a"], "pins what is in sight; two states are kept", () => compare.pin(job())],
  [["o"], "compares with the next pin, layer or job", turn($("other"), 1)],
  [["O"], "compares with the previous one", turn($("other"), -1)],
  [["w"], "compares side by side, by a wipe, by the difference, by the absolute difference", turn($("how"), 1)],
  [["["], "moves the divider of the wipe to the left", () => moveDivider(-0.02)],
  [["]"], "moves it to the right", () => moveDivider(0.02)],
  [["b"], "eye and light image side by side", toggleBoth],
  [["m"], "sets a corner of a rectangle at the probe, then the other", () => view.pinMark()],
  [["u"], "takes the rectangle away", () => view.setMark(null)],
  [["j"], "next job", nextJob(1)],
  [["k"], "previous job", nextJob(-1)],
  [["p"], "pauses or resumes the job", () => orders.pauseOrResume()],
  [["i"], "goes to the image, where arrow keys move the probe, with Ctrl by 16, and with Shift the image", () => $("canvas").focus()],
];

function reset() {
  $("exposure").value = $("offset").value = 0;
  $("tone").value = TONES[0];
  setTone();
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function imageKey(event) {
  const arrow = ARROWS[event.key];
  if (!arrow || event.altKey || event.metaKey) return;
  event.preventDefault();
  const [dx, dy] = arrow;
  if (event.shiftKey) view.pan((-dx * view.canvas.width) / 8, (-dy * view.canvas.height) / 8);
  else view.moveProbe((event.ctrlKey ? 16 : 1) * dx, (event.ctrlKey ? 16 : 1) * dy);
}

function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey || $("sure").open || $("page").hidden) return;
  if (event.target.matches("input:not([type=range]):not([type=checkbox]), select, textarea")) return;
  const row = KEYS.find(([keys]) => keys.includes(event.key));
  if (!row || (event.key !== "?" && (!$("keys-on").checked || $("help").open))) return;
  event.preventDefault();
  row[2]();
}

function listKeys() {
  for (const [keys, does] of KEYS) {
    const row = $("keys").insertRow(), cell = row.insertCell();
    keys.forEach((key) => cell.append(Object.assign(document.createElement("kbd"), { textContent: key }), " "));
    row.insertCell().textContent = does;
  }
}

// ---- the life of the page

function refused() {
  sleep();
  $("page").hidden = true;
  $("sign-in").hidden = false;
  setText("sign-in-why", hasToken() ? "The master refused the token of this tab." : "It was opened without one.");
  showLine("connecting");
  setText("connection", "not signed in");
}

function sleep() {
  awake?.abort();
  awake = null;
  Tiles.all.forEach((one) => one.sleep());
}

function wake() {
  if (awake || document.hidden) return;
  if (!hasToken()) return refused();
  $("sign-in").hidden = true;
  $("page").hidden = false;
  awake = new AbortController();
  showLine("connecting");
  watchEvents(awake.signal, { event: (type, data) => on[type]?.(data), state: onState });
  const mine = awake;
  let rounds = 0;
  const timer = setInterval(() => {
    rounds++;
    if (state.line !== "lost" && mine === awake && (state.line !== "live" || rounds % ROUNDS === 0)) ask.all();
  }, EVERY);
  awake.signal.addEventListener("abort", () => clearInterval(timer));
}

function wire() {
  $("sign-in-form").addEventListener("submit", (event) => {
    event.preventDefault();
    setToken($("token").value);
    $("token").value = "";
    wake();
  });
  $("layer").addEventListener("change", () => setLayer($("layer").value));
  for (const id of ["exposure", "offset"]) $(id).addEventListener("input", setTone);
  $("tone").addEventListener("change", setTone);
  for (const id of ["other", "how"]) $(id).addEventListener("change", () => compare.choose($("other").value, $("how").value));
  $("divider").addEventListener("input", () => view.setDivider(Number($("divider").value) / 100));
  $("against").addEventListener("change", showCurve);
  const buttons = { "zoom-in": () => view.zoom(2), "zoom-out": () => view.zoom(0.5), fit: () => view.fit(), actual: () => view.actual(), pin: () => compare.pin(job()), both: toggleBoth, unmix: () => mixer.stop(), mark: toggleMark, unmark: () => view.setMark(null), "help-open": () => $("help").showModal() };
  for (const [id, act] of Object.entries(buttons)) $(id).addEventListener("click", act);
  $("canvas").addEventListener("keydown", imageKey);
  document.addEventListener("keydown", onKey);
  document.addEventListener("visibilitychange", () => {
    if (!document.hidden) return wake();
    sleep();
    if (!$("page").hidden) showLine("hidden");
  });
  addEventListener("hashchange", () => {
    if (hash().has("token")) {
      takeToken();
      sleep();
      wake();
    } else if (state.jobs?.some((one) => one.job === Number(hash().get("job")))) choose(Number(hash().get("job")));
  });
}

takeToken();
wire();
listKeys();
setOptions($("how"), WAYS, WAYS[0][0]);
setTone();
if (!view.painter.gl) problemOf("browser")("This browser has no WebGL2, so the image cannot be shown.");
wake();

/** What tests and the console may look at. */
globalThis.lightmill = { view, tiles, compare, mixer, region, state };
