// farm: a real master with real workers, and what the command line says of them.
import { execFileSync, spawn } from "node:child_process";
import fs from "node:fs";
import net from "node:net";
import path from "node:path";

export const sleep = (ms) => new Promise((done) => setTimeout(done, ms));

/** Waits until `test` answers something true, which is returned. */
export async function until(what, test, ms = 40000) {
  for (const end = Date.now() + ms; Date.now() < end; await sleep(50)) {
    const found = await test();
    if (found) return found;
  }
  throw new Error(`waited ${ms / 1000} s for: ${what}`);
}

/** The ports that are for us: those of tests/run.sh, or those that the system gives to nobody by itself. */
function range() {
  return (process.env.TEST_PORTS ?? "20000-31999").split("-").map(Number);
}

const isFree = (port) =>
  new Promise((done) => {
    const server = net.createServer();
    server.once("error", () => done(false)).listen(port, "127.0.0.1", () => server.close(() => done(true)));
  });

/** The first of three free ports side by side. */
async function freePorts() {
  const [first, last] = range();
  for (;;) {
    const port = first + Math.floor(Math.random() * (last - first - 2));
    if ((await isFree(port)) && (await isFree(port + 1)) && (await isFree(port + 2))) return port;
  }
}

export class Farm {
  constructor(build, folder) {
    Object.assign(this, { build, folder, data: path.join(folder, "data"), children: [] });
  }
  async begin(workers) {
    this.port = await freePorts();
    this.page = this.port + 2;
    await this.startMaster();
    for (let i = 0; i < workers; i++) this.startWorker(`worker-${i}`);
  }
  startWorker(name) {
    return this.start("lightmill-worker", `127.0.0.1:${this.port}`, "--threads", "1", "--name", name, "--cache", path.join(this.folder, `cache-${name}`));
  }
  start(program, ...args) {
    const log = fs.openSync(path.join(this.folder, `${program}.log`), "a");
    const child = spawn(path.join(this.build, program), args, { stdio: ["ignore", log, log] });
    fs.closeSync(log);
    this.children.push(child);
    return child;
  }
  async startMaster() {
    fs.rmSync(path.join(this.data, "http"), { force: true });
    this.master = this.start("lightmill-master", "--listen", `127.0.0.1:${this.port}`, "--data", this.data, "--http", String(this.page), "--batch-interval", "0.4", "--checkpoint", "0.3", "--heartbeat", "0.3", "--lease", "2");
    await until("the master", () => fs.existsSync(path.join(this.data, "http")));
  }
  async killMaster() {
    const gone = new Promise((done) => this.master.once("exit", done));
    this.master.kill("SIGKILL");
    await gone;
  }
  run(...args) {
    return execFileSync(path.join(this.build, "lightmill"), args, { encoding: "utf8", timeout: 30000 });
  }
  /** A command that speaks to the master. */
  ask(command, ...args) {
    return this.run(command, ...args, "--master", `127.0.0.1:${this.port}`);
  }
  status(job) {
    return JSON.parse(this.ask("status", String(job), "--json")).jobs[0];
  }
  address(...args) {
    return this.run("open", "--data", this.data, "--print", ...args).trim();
  }
  async end() {
    const running = this.children.filter((child) => child.exitCode === null && child.signalCode === null);
    const all = running.map((child) => new Promise((done) => child.once("exit", done)));
    for (const child of running) child.kill("SIGKILL");
    await Promise.all(all);
  }
}
