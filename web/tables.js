// tables: numbers as people read them, and the tables of jobs, workers and events.

const pad = (n) => String(n).padStart(2, "0");

export const format = {
  /** "1.5 M"; counts have no unit. */
  count(n) {
    if (!isFinite(n)) return "-";
    for (const [size, letter] of [[1e12, "T"], [1e9, "G"], [1e6, "M"], [1e3, "k"]]) if (n >= size) return `${(n / size).toPrecision(3)} ${letter}`;
    return String(Math.round(n));
  },
  /** "1:02:03", "2:03" or "4.5 s". */
  duration(seconds) {
    if (!(seconds >= 0) || !isFinite(seconds)) return "-";
    if (seconds < 59.5) return `${+seconds.toPrecision(2)} s`;
    const s = Math.round(seconds), h = Math.floor(s / 3600);
    if (h >= 48) return `${Math.round(h / 24)} days`;
    return h > 0 ? `${h}:${pad(Math.floor(s / 60) % 60)}:${pad(s % 60)}` : `${Math.floor(s / 60)}:${pad(s % 60)}`;
  },
  percent: (share) => (share > 0 && isFinite(share) ? `${+(100 * share).toPrecision(2)} %` : "-"),
  number: (value) => (Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(2) : String(+value.toPrecision(4))),
};

export function make(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

/** The share of a job that is done, 0 to 1: of its samples, its time or its error, whichever is nearest to the end. It is 1
 * when the job is done, and not before. */
export function fraction(job) {
  if (job.state === "done") return 1;
  const parts = [0];
  if (job.samples_total > 0) parts.push(job.samples_done / job.samples_total);
  if (job.time_limit > 0) parts.push(job.elapsed / job.time_limit);
  if (job.error_target > 0 && job.error > 0) parts.push((job.error_target / job.error) ** 2);
  return Math.min(0.9999, Math.max(...parts));
}

/** Fills a table's body; rows keep their elements, so that focus and what a screen reader reads stay. */
function fill(body, items, key, row) {
  const old = new Map([...body.rows].map((r) => [r.dataset.key, r]));
  const rows = items.map((item) => {
    const name = String(key(item)), element = old.get(name) ?? make("tr");
    element.dataset.key = name;
    row(element, item);
    return element;
  });
  if (rows.length !== body.rows.length || rows.some((r, i) => body.rows[i] !== r)) body.replaceChildren(...rows);
}

/** Sets the texts of the cells of a row; a cell is made once. */
function cells(row, texts) {
  texts.forEach((text, i) => {
    const cell = row.cells[i] ?? row.appendChild(make("td"));
    if (cell.textContent !== text) cell.textContent = text;
  });
}

function jobRow(row, job, chosen, choose) {
  if (!row.cells.length) {
    const button = make("button", { type: "button", className: "choose" });
    button.addEventListener("click", () => choose(Number(row.dataset.key)));
    row.append(make("th", { scope: "row" }, button));
    for (let i = 0; i < 6; i++) row.append(make("td"));
    row.cells[2].append(make("progress", { max: 1 }), make("span", { className: "share" }));
  }
  const button = row.querySelector("button"), name = `${job.job} ${job.name}`;
  if (button.textContent !== name) button.textContent = name;
  button.setAttribute("aria-pressed", String(job.job === chosen));
  row.classList.toggle("chosen", job.job === chosen);
  const share = fraction(job), [bar, text] = row.cells[2].children;
  bar.value = share;
  bar.setAttribute("aria-label", `job ${job.job}, done`);
  text.textContent = `${Math.floor(100 * share)} %`;
  const texts = [job.state, null, format.count(job.samples_done), format.percent(job.error), format.duration(job.elapsed), job.state === "running" ? format.duration(job.remaining) : "-"];
  texts.forEach((value, i) => {
    if (value !== null && row.cells[i + 1].textContent !== value) row.cells[i + 1].textContent = value;
  });
  row.title = job.message || "";
}

export function showJobs(body, jobs, chosen, choose) {
  fill(body, jobs, (job) => job.job, (row, job) => jobRow(row, job, chosen, choose));
}

const age = (seconds) => (seconds >= 0 ? `${format.duration(seconds)} ago` : "-");

export function showWorkers(body, workers) {
  fill(body, workers.map((worker, i) => ({ ...worker, i })), (worker) => worker.i, (row, worker) => {
    const state = worker.aside ? `gets no work: ${worker.aside}` : !worker.connected ? "gone" : worker.relay ? "relay" : worker.units_held > 0 ? "at work" : "waits";
    const speed = worker.speed > 0 ? `${format.count(worker.speed)}/s` : "-";
    cells(row, [worker.name, String(worker.threads), speed, worker.job ? `${worker.units_held} of job ${worker.job}` : "-", age(worker.last_seen), state]);
  });
}

const MOST_EVENTS = 200;

/** Adds a line to the list of events, newest first. What happens again and again (`kind`) keeps one line while nothing else does. */
export function addEvent(list, { text, kind = "" }, when = new Date()) {
  const time = make("time", { dateTime: when.toISOString() }, when.toTimeString().slice(0, 8)), first = list.firstChild;
  if (kind && first?.dataset.kind === kind) first.remove();
  const line = make("li", {}, time, ` ${text}`);
  line.dataset.kind = kind;
  list.prepend(line);
  while (list.children.length > MOST_EVENTS) list.lastChild.remove();
}

const WORKERS = { joined: () => "joined.", left: () => "left.", aside: (why) => `gets no work: ${why}`, back: () => "is given work again." };
/** An event of a worker as a line. */
export const workerText = ({ name, what, why }) => ({ text: `Worker ${name} ${WORKERS[what]?.(why) ?? what}` });

const NOTES = { checkpoint: "a checkpoint was written ", verified: "work was verified: ", differs: "WORK THAT WAS RENDERED TWICE DIFFERS: ", saved: "kept ", extended: "goes on ", message: "" };
/** A note on a job as a line. */
export function noteText({ job, what, why }) {
  const often = what === "checkpoint" || what === "verified";
  return { text: `Job ${job}: ${NOTES[what] ?? `${what} `}${why}`, kind: often ? `${what} ${job}` : "" };
}

/** What has changed between two lists of jobs, and of workers, in words; of jobs, what no note tells. */
export function jobNews(before, after) {
  const old = new Map(before.map((job) => [job.job, job])), news = [];
  for (const job of after) {
    const was = old.get(job.job);
    if (!was) news.push(`Job ${job.job} (${job.name}) was submitted.`);
    else if (was.state !== job.state) news.push(`Job ${job.job} is ${job.state}.`);
    old.delete(job.job);
  }
  for (const job of old.keys()) news.push(`Job ${job} was deleted.`);
  return news;
}

export function workerNews(before, after) {
  const names = (list, test) => new Map(list.filter(test).map((w) => [`${w.name} ${w.key}`, w])), news = [];
  const was = names(before, (w) => w.connected), is = names(after, (w) => w.connected);
  for (const [key, w] of is) if (!was.has(key)) news.push(`Worker ${w.name} joined.`);
  for (const [key, w] of was) if (!is.has(key)) news.push(`Worker ${w.name} left.`);
  const aside = names(before, (w) => w.aside);
  for (const [key, w] of names(after, (w) => w.aside)) if (!aside.has(key)) news.push(`Worker ${w.name} gets no work: ${w.aside}`);
  return news;
}
