// api: the page's end of the master's HTTP API: the token, requests, orders and the stream of events.

const KEY = "lightmill.token";

/** A request that the master answered with a problem; `status` is HTTP's, 0 when there was no answer at all. */
export class Problem extends Error {
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

/** Moves the token from the address (#token=...) to this tab's storage, so that it is in no history. */
export function takeToken() {
  const hash = new URLSearchParams(location.hash.slice(1));
  if (!hash.has("token")) return;
  setToken(hash.get("token"));
  hash.delete("token");
  history.replaceState(null, "", location.pathname + (hash.size ? `#${hash}` : ""));
}

export const setToken = (token) => sessionStorage.setItem(KEY, token.trim());
export const hasToken = () => !!sessionStorage.getItem(KEY);

const headers = (more) => {
  // What is no header value (a typing error) is refused as any wrong token is.
  const token = (sessionStorage.getItem(KEY) ?? "").replace(/[^\x21-\x7e]/g, "?");
  return { Authorization: `Bearer ${token}`, ...more };
};

async function problemOf(answer) {
  let text = `${answer.status} ${answer.statusText}`;
  try {
    const body = await answer.json();
    text = body.detail || body.title || text;
  } catch {
    /* not ours: a proxy's page */
  }
  return new Problem(answer.status, text);
}

async function request(path, options = {}) {
  let answer;
  try {
    answer = await fetch(`/api/v1${path}`, { cache: "no-store", ...options, headers: headers(options.headers) });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem(0, "The master does not answer.");
  }
  if (!answer.ok) throw await problemOf(answer);
  return answer;
}

/** GET as JSON. */
export const get = async (path, signal) => (await request(path, { signal })).json();
/** GET as bytes. */
export const getBytes = async (path, signal) => (await request(path, { signal })).arrayBuffer();

/** GET as a file: { blob, name }. */
export async function getFile(path) {
  const answer = await request(path), name = /filename="([^"]+)"/.exec(answer.headers.get("Content-Disposition") ?? "");
  return { blob: await answer.blob(), name: name ? name[1] : path.replace(/\?.*/, "").replace(/.*\//, "") };
}

/** An order to a job: "pause", "extend" with { spp }, ... or "delete". */
export function order(job, what, body) {
  if (what === "delete") return request(`/jobs/${job}`, { method: "DELETE" });
  const options = { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body ?? {}) };
  return request(`/jobs/${job}/${what}`, options);
}

/** Splits a stream of server-sent events: `feed` takes text as it comes, and calls back whole events. */
export function eventParser(onEvent) {
  let text = "", event = {};
  const line = (one) => {
    if (one === "") {
      if (event.data !== undefined) onEvent(event);
      event = {};
      return;
    }
    const colon = one.indexOf(":");
    if (colon === 0) return; // a comment, which keeps the line alive
    const field = colon < 0 ? one : one.slice(0, colon), value = colon < 0 ? "" : one.slice(colon + 1).replace(/^ /, "");
    event[field] = field === "data" && event.data !== undefined ? `${event.data}\n${value}` : value;
  };
  return (chunk) => {
    text += chunk;
    const lines = text.split(/\r\n|\n|\r(?!$)/);
    text = lines.pop();
    lines.forEach(line);
  };
}

const SILENCE = 40000; // ms without a byte, comments included, after which the line counts as cut

/**
 * Reads the master's events until `signal` ends it, and reconnects for ever with growing pauses. EventSource cannot send
 * a token, so this reads the stream itself. `on` has event(type, data), state("live" | "asking" | "lost" | "refused").
 */
export async function watchEvents(signal, on) {
  let last = null, pause = 300;
  const stream = async () => {
    const cut = new AbortController();
    const stop = () => cut.abort();
    signal.addEventListener("abort", stop);
    let timer = setTimeout(stop, SILENCE);
    try {
      const answer = await request("/events", { signal: cut.signal, headers: last === null ? {} : { "Last-Event-ID": last } });
      on.state("live");
      pause = 300;
      const parse = eventParser((event) => {
        if (event.id !== undefined) last = event.id;
        on.event(event.event ?? "message", JSON.parse(event.data));
      });
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      for (let part; !(part = await reader.read()).done; ) {
        clearTimeout(timer);
        timer = setTimeout(stop, SILENCE);
        parse(part.value);
      }
    } finally {
      clearTimeout(timer);
      signal.removeEventListener("abort", stop);
    }
  };
  while (!signal.aborted) {
    let line = "lost";
    try {
      await stream();
    } catch (error) {
      if (error.status === 401) return on.state("refused");
      // The master is there, but has no room for one more stream: what changes is asked for from time to time. A proxy whose
      // master is gone answers with 502 or 504.
      if (error.status === 503) line = "asking";
    }
    if (signal.aborted) return;
    if (line === "asking") last = null;
    on.state(line);
    await new Promise((done) => setTimeout(done, pause));
    pause = Math.min(2 * pause, 5000);
  }
}
