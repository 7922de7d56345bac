// orders: what can be done with the job that is chosen, and the files that can be had of its image.

import { getFile, order } from "./api.js";
import { $, setOptions, setText } from "./dom.js";
import { format, make } from "./tables.js";

/** The states of a job that is over. */
export const OVER = ["done", "failed", "cancelled"];
const BIG = 2 ** 30; // samples a pixel, at most
// How a goal is given: [what the API calls it, its unit, the input's attributes, what it is by default, its number for the API].
const GOALS = [
  ["spp", "samples a pixel", { min: 1, max: BIG, step: 1 }, (one) => Math.min(2 * one.spp, BIG) || 1024, (v) => v],
  ["error", "% error", { min: 0, max: 100, step: "any" }, (one) => format.number(50 * (one.error_target || one.error || 0.02)), (v) => v / 100],
  ["time", "seconds from now", { min: 1, max: 1e9, step: "any" }, () => 600, (v) => v],
];

/** Asks a question; true for yes. */
function sure(text) {
  setText("sure-text", text);
  $("sure").returnValue = "";
  $("sure").showModal();
  return new Promise((done) => $("sure").addEventListener("close", () => done($("sure").returnValue === "yes"), { once: true }));
}

function showGoal(one) {
  const [, , attributes, usual] = GOALS.find(([name]) => name === $("unit").value);
  Object.assign($("goal"), attributes);
  $("goal").required = !["cancelled", "failed"].includes(one?.state); // these go on to their old goals
  if (one && $("goal").value === "") $("goal").placeholder = String(usual(one));
}

/** The images that can be had: as it is now, and those of --save-at. */
function showFiles(one) {
  const has = !!one && one.samples_done > 0;
  for (const id of ["at", "exr", "png"]) $(id).disabled = !has;
  const kept = (one?.save_at ?? []).map((spp) => [String(spp), `at ${spp} samples a pixel${spp > one.saved ? " (not yet)" : ""}`]);
  const choices = [["", "now"], ...kept], wanted = choices.some(([value]) => value === $("at").value) ? $("at").value : "";
  setOptions($("at"), choices, wanted);
  for (const option of $("at").options) option.disabled = Number(option.value) > (one?.saved ?? 0);
}

export class Orders {
  /** on.job() is the job that is chosen, on.exposure() that of the view; on.given() is told of an order, on.refused() that the token is. */
  constructor(on) {
    this.on = on;
    setOptions($("unit"), GOALS.map(([name, unit]) => [name, unit]), GOALS[0][0]);
    const buttons = { pause: () => this.pauseOrResume(), cancel: () => this.cancel(), delete: () => this.remove(), retain: () => this.retainOrRelease(), exr: () => this.download("exr"), png: () => this.download("png") };
    for (const [id, act] of Object.entries(buttons)) $(id).addEventListener("click", act);
    const forms = { extend: () => this.extend(), priority: () => this.prioritize() };
    for (const [id, act] of Object.entries(forms))
      $(id).addEventListener("submit", (event) => {
        event.preventDefault();
        act();
      });
    $("unit").addEventListener("change", () => {
      $("goal").value = "";
      showGoal(on.job());
    });
  }
  /** Another job is chosen. */
  clear() {
    setText("answer", "");
    $("goal").value = $("at").value = "";
  }
  show() {
    const one = this.on.job(), over = one && OVER.includes(one.state);
    setText("pause", one?.state === "paused" ? "Resume" : "Pause");
    $("pause").disabled = !one || over;
    $("cancel").disabled = !one || over;
    $("delete").disabled = !one || !over;
    setText("retain", one?.retained ? "Release" : "Retain");
    $("retain").disabled = !one;
    setText("retain-why", one?.retained ? "Retained: it stays, with what it needs to go on, until you delete it." : "Not retained: when it is over, it may go when the master needs room.");
    for (const form of ["extend", "priority"]) for (const part of $(form).elements) part.disabled = !one;
    if (one && document.activeElement !== $("priority-value")) $("priority-value").value = one.priority;
    showGoal(one);
    showFiles(one);
  }
  async give(what, body, said) {
    const one = this.on.job();
    if (!one) return;
    try {
      await order(one.job, what, body);
      setText("answer", `Job ${one.job} ${said}`);
    } catch (error) {
      if (error.status === 401) return this.on.refused();
      setText("answer", error.status === 403 ? `Not allowed: ${error.message}` : error.message);
    }
    this.on.given();
  }
  pauseOrResume() {
    const one = this.on.job();
    if (!one || OVER.includes(one.state)) return;
    if (one.state === "paused") this.give("resume", null, "goes on.");
    else this.give("pause", null, "pauses.");
  }
  retainOrRelease() {
    if (this.on.job()?.retained) this.give("release", null, "is not retained any more.");
    else this.give("retain", null, "is retained.");
  }
  extend() {
    const [name, unit, , , toApi] = GOALS.find(([one]) => one === $("unit").value), value = $("goal").value;
    if (value === "") this.give("extend", {}, "goes on to its old goals.");
    else this.give("extend", { [name]: toApi(Number(value)) }, `goes on to ${value} ${unit}.`);
    $("goal").value = "";
  }
  prioritize() {
    const value = $("priority-value").value;
    this.give("priority", { priority: Number(value) }, `has priority ${value}.`);
  }
  async cancel() {
    const one = this.on.job();
    if (one && (await sure(`Cancel job ${one.job} (${one.name})? Its image so far is kept.`))) this.give("cancel", null, "is cancelled.");
  }
  async remove() {
    const one = this.on.job();
    if (one && (await sure(`Delete job ${one.job} (${one.name}), its film and its image?`))) this.give("delete", null, "is deleted.");
  }
  /** Saves the image as a file. A link cannot show the token, so the page fetches it. */
  async download(type) {
    const one = this.on.job(), at = $("at").value, query = new URLSearchParams();
    if (!one) return;
    if (at) query.set("at", at);
    if (type === "png") query.set("exposure", this.on.exposure());
    $(type).disabled = true;
    setText("answer", "The master writes the image ...");
    try {
      const { blob, name } = await getFile(`/jobs/${one.job}/image.${type}?${query}`), link = make("a", { href: URL.createObjectURL(blob), download: name });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 60000);
      setText("answer", `${name}: ${type === "png" ? "picture" : "all layers"}, ${format.count(blob.size)}B.`);
    } catch (error) {
      if (error.status === 401) return this.on.refused();
      setText("answer", error.message);
    } finally {
      $(type).disabled = false;
    }
  }
}
