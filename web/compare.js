// compare: what the image is compared with: a state that was pinned, another layer, or another job; and how.

import { Layer, Tiles } from "./tiles.js";

const PINS = 2;
export const WAYS = [["side", "side by side"], ["wipe", "wipe"], ["signed", "difference"], ["absolute", "absolute difference"]];

/** What the differences' colours mean. */
const MEANING = { signed: " Orange: brighter; blue: darker; black: equal.", absolute: " Black: equal." };

export class Compare {
  /**
   * `view` draws; `first` are the tiles of the image that is shown; on.problem as Tiles has it, on.change() is told when the
   * choice or the pins have changed, on.title(name) is a layer's name for people. `what` is "" for nothing, "pin:0", "layer:light" or "job:3".
   */
  constructor(view, first, on) {
    Object.assign(this, { view, first, on, what: "", how: "side", pins: new Array(PINS).fill(null), nextPin: 0, job: null, jobs: [], refused: "", note: "", shown: "" });
    this.second = new Tiles({ wanted: () => view.wanted(), taken: (layer, fresh) => view.taken(layer, fresh) }, on);
  }

  // ---- pins

  /** Keeps what is in sight of a job's image as it is now, in the place of the older pin. */
  pin(job) {
    const seen = this.view.inSight();
    if (!job || !seen) return this.tell("Nothing is in sight yet.");
    const at = this.nextPin;
    this.nextPin = (at + 1) % PINS;
    this.pins[at] = { layer: Layer.hold(seen), name: this.name, job: job.job, width: job.width, height: job.height, samples: job.samples_done / (job.width * job.height), level: seen.level };
    if (this.what === `pin:${at}`) this.choose(this.what);
    this.tell(`Kept as ${this.pinName(at)}.`);
  }
  /** Says something until the next choice. */
  tell(note) {
    this.note = note;
    this.on.change();
  }
  /** What is shown: a layer, or what `shown` says instead. */
  get name() {
    return this.shown || this.first.name;
  }
  pinName(i) {
    const pin = this.pins[i];
    return `pin ${Number(i) + 1}: job ${pin.job}, ${this.on.title(pin.name)}, ${+pin.samples.toPrecision(2)} samples a pixel${pin.level ? `, level ${pin.level}` : ""}`;
  }

  // ---- the choice

  /** All that can be chosen, as [value, text]; `layers` are [name, text] of those that the job has. */
  choices(layers) {
    const pins = this.pins.flatMap((pin, i) => (pin ? [[`pin:${i}`, this.pinName(i)]] : []));
    const others = this.jobs.filter((one) => one.job !== this.job?.job).map((one) => [`job:${one.job}`, `job ${one.job}: ${one.name}`]);
    return [["", "nothing"], ...pins, ...layers.map(([name, text]) => [`layer:${name}`, `layer ${text}`]), ...others];
  }
  choose(what, how = this.how) {
    Object.assign(this, { what, how });
    this.apply();
  }
  /** The job that is shown, and the queue; what is compared may be of another size now, or gone. */
  setJobs(job, jobs) {
    const was = this.job;
    Object.assign(this, { job, jobs });
    const gone = this.what.startsWith("job:") && !jobs.some((one) => `job:${one.job}` === this.what);
    if (gone || this.what === `job:${job?.job}`) this.what = "";
    if (gone || was?.job !== job?.job || was?.width !== job?.width || was?.height !== job?.height) this.apply();
  }
  /** Why two images cannot be compared; "" when they can. */
  refusal(name, other) {
    const { job } = this;
    if (!job || !other || (other.width === job.width && other.height === job.height)) return "";
    return `${name} has ${other.width} × ${other.height} pixels, job ${job.job} has ${job.width} × ${job.height}: only images of one size can be compared.`;
  }
  apply() {
    const [kind, value] = this.what.split(":");
    this.note = "";
    if (!this.job || kind === "") this.set("", null, null, null);
    else if (kind === "pin") this.set(this.refusal(`Pin ${Number(value) + 1}`, this.pins[value]), null, this.pins[value].layer, this.pins[value].name);
    else if (kind === "layer") this.set("", this.job.job, null, value);
    else this.set(this.refusal(`Job ${value}`, this.jobs.find((one) => one.job === Number(value))), Number(value), null, this.first.name);
    this.on.change();
  }
  /** `job`: its layer `name` is fetched; else `layer` is there already. */
  set(refused, job, layer, name) {
    this.refused = refused;
    this.second.show(refused ? null : job, name ?? "picture");
    if (refused) this.view.compare(null, null, this.how);
    else this.view.compare(job === null ? layer : this.second.layer, name, this.how);
    this.second.restart();
  }
  /** The first image shows another layer: another job shows that too. */
  follow() {
    if (this.what.startsWith("job:")) this.apply();
  }
  /** What is to be seen, and what there is to say. */
  describe() {
    return [this.refused || this.legend(), this.note].filter((one) => one).join(" ");
  }
  legend() {
    const [kind, value] = this.what.split(":");
    if (!this.job || kind === "") return "";
    const layer = this.on.title(this.first.name), now = `job ${this.job.job}, ${this.on.title(this.name)}, now`;
    const other = kind === "pin" ? this.pinName(value) : kind === "layer" ? `layer ${this.on.title(value)}` : `job ${value}, ${layer}`;
    if (this.how === "wipe") return `Left of the line: ${other}. Right: ${now}.`;
    const panes = this.view.panes();
    if (this.how === "side") return panes[1]?.y ? `Above: ${now}. Below: ${other}.` : `Left: ${now}. Right: ${other}.`;
    return `${now}, minus ${other}.${MEANING[this.how]}`;
  }
}
