// The page, in a real browser, against a real master with two workers that render. Prints what tests/run.sh counts.
//
// usage: node page.mjs BUILD      BUILD/page has playwright-core and axe-core, and gets the screenshots
import assert from "node:assert/strict";
import fs from "node:fs";
import { createRequire } from "node:module";
import os from "node:os";
import path from "node:path";
import { readExr } from "./exr.mjs";
import { Farm, sleep, until } from "./farm.mjs";

const build = path.resolve(process.argv[2]), shots = path.join(build, "page");
const require = createRequire(path.join(shots, "/"));
const { chromium } = require("playwright-core");
const axe = fs.readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");

const WIDTH = 200, HEIGHT = 136; // more than one tile, and some that are cut off
const folder = fs.mkdtempSync(path.join(os.tmpdir(), "lightmill-page-"));
const farm = new Farm(build, folder), errors = [];
let browser, page, job, exr;

// ---- what the page has

const shown = () => page.evaluate(() => ({ version: lightmill.tiles.version, layer: lightmill.tiles.name, scale: lightmill.view.scale }));
const text = (selector) => page.textContent(selector);
const said = (selector, words) => until(`${selector} says "${words}"`, async () => (await text(selector)).includes(words));

/** The texels of level 0 as [height][width][4] numbers; null when some are missing. */
const texels = () =>
  page.evaluate(async () => {
    const { halfToNumber } = await import("/tiles.js");
    const { view } = lightmill, values = new Array(4 * view.width * view.height).fill(null);
    for (const tile of view.layer.tiles.values()) {
      if (tile.level !== 0) continue;
      for (let y = 0; y < tile.h; y++)
        for (let x = 0; x < tile.w; x++)
          for (let c = 0; c < 4; c++) values[4 * ((64 * tile.ty + y) * view.width + 64 * tile.tx + x) + c] = halfToNumber(tile.texels[4 * (y * tile.w + x) + c]);
    }
    return values.includes(null) ? null : values;
  });

/** The image on the canvas at 1:1 as [height][width][3] bytes. */
const canvas = () =>
  page.evaluate(() => {
    const { view } = lightmill, all = view.pixels(), bytes = [], row = view.canvas.width;
    for (let y = 0; y < view.height; y++)
      for (let x = 0; x < view.width; x++) for (let c = 0; c < 3; c++) bytes.push(all[4 * ((view.canvas.height - 1 - y - view.y) * row + x + view.x) + c]);
    return bytes;
  });

const srgb = (v) => {
  const c = Math.min(Math.max(v, 0), 1);
  return 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
};
const mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;

/** What the canvas is to show of three channels: their values times 2^exposure as sRGB. */
const expected = (layer, exposure = 0) => {
  const out = [];
  for (let p = 0; p < WIDTH * HEIGHT; p++) for (const c of "RGB") out.push(srgb(exr.channels[layer + c][p] * 2 ** exposure));
  return out;
};

async function chooseLayer(name) {
  await page.selectOption("#layer", name);
  return until(`the tiles of ${name}`, async () => (await shown()).version > 0 && (await shown()).layer === name && (await texels()));
}

async function assertCanvas(layer, exposure = 0) {
  const is = await canvas(), wanted = expected(layer, exposure);
  assert.ok(wanted.some((v) => v > 20), "the image is not black");
  assert.ok(Math.abs(mean(is) - mean(wanted)) < 0.3, `mean ${mean(is)} on the canvas, ${mean(wanted)} of the file`);
  const worst = Math.max(...is.map((v, i) => Math.abs(v - wanted[i])));
  assert.ok(worst <= 1.5, `a value is off by ${worst} of 255`);
}

async function assertAccessible(what) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  assert.deepEqual(violations.map((v) => `${v.id}: ${v.nodes.map((n) => n.html).join(" ")}`), [], `axe: ${what}`);
}

const screenshot = (name) => page.screenshot({ path: path.join(shots, `${name}.png`), fullPage: true });

// ---- the tests, in their order

const tests = {
  async "the page opens with the token of lightmill open and shows the job that renders"() {
    const address = farm.address();
    assert.match(address, /#token=/);
    await page.goto(address);
    await until("the stream of events", async () => (await text("#connection")) === "live");
    assert.equal(new URL(page.url()).hash.includes("token"), false, "the token stays in the address");
    await said("#image-title", "running");
    await until("two versions of the image", async () => (await shown()).version >= 2);
    await said("#farm", "2 workers");
    assert.equal(await page.locator("#workers tr").count(), 2);
    await page.evaluate(() => (globalThis.neverReloaded = true));
  },

  async "the error falls on a curve"() {
    await until("a curve", async () => (await page.locator("#curve path.error").count()) === 1);
    await until("three points of it", async () => (await page.evaluate(() => lightmill.state.points.length)) >= 3);
    assert.match(await text("#eta"), /% after .*0\.01 % in about/);
  },

  async "a job is paused from the page"() {
    await page.click("#pause");
    await until("the pause", () => farm.status(job).state === "paused");
    await said("#image-title", "paused");
    await until("the last batches", () => farm.status(job).samples_out === 0, 10000);
  },

  async "the canvas shows what the file of the image holds"() {
    const file = path.join(folder, "so-far.exr");
    farm.ask("fetch", String(job), "-o", file);
    exr = readExr(file);
    assert.deepEqual([exr.width, exr.height], [WIDTH, HEIGHT]);
    const { batches } = farm.status(job);
    await until("the last version", async () => (await shown()).version === batches);
    await page.keyboard.press("1");
    await until("the zoom", async () => (await shown()).scale === 1);
    await until("all tiles", texels);
    await assertCanvas("");
    await screenshot("dark");
  },

  async "every layer holds what the file's layer holds"() {
    const layers = { picture: ["R", "G", "B"], eye: ["eye.R", "eye.G", "eye.B"], light: ["light.R", "light.G", "light.B"], noise: ["noise.R", "noise.G", "noise.B"], albedo: ["albedo.R", "albedo.G", "albedo.B"], normal: ["normal.X", "normal.Y", "normal.Z"], depth: ["depth.Z"], samples: ["samples"] };
    const near = (is, was, what) => assert.ok(Math.abs(is - was) <= 1e-3 * Math.abs(was) + 1e-6, `${what}: ${is} instead of ${was}`);
    for (const [name, channels] of Object.entries(layers)) {
      const values = await chooseLayer(name);
      for (let p = 0; p < WIDTH * HEIGHT; p++)
        channels.forEach((channel, c) => near((name === "samples" ? 1024 : 1) * values[4 * p + c], exr.channels[channel][p], `${channel} of pixel ${p}`));
      const error = (p) => 0.2126 * exr.channels["noise.R"][p] + 0.7152 * exr.channels["noise.G"][p] + 0.0722 * exr.channels["noise.B"][p];
      for (let p = 0; name === "picture" && p < WIDTH * HEIGHT; p++) near(values[4 * p + 3], error(p), `the error of pixel ${p}`);
      if (["eye", "light", "albedo"].includes(name)) await assertCanvas(`${name}.`);
    }
    await chooseLayer("picture");
  },

  async "exposure, colours and the probe do what they say"() {
    for (let i = 0; i < 4; i++) await page.keyboard.press("e");
    assert.equal(await text("#exposure-value"), "2");
    await assertCanvas("", 2);
    for (const tone of ["filmic", "false", "relative"]) {
      const before = await canvas();
      await page.keyboard.press("c");
      assert.equal(await page.inputValue("#tone"), tone);
      assert.notDeepEqual(await canvas(), before);
    }
    await screenshot("relative-error");
    await page.keyboard.press("r");
    await assertCanvas("");
    const place = await page.evaluate(() => ({ x: lightmill.view.x, y: lightmill.view.y }));
    await page.hover("#canvas", { position: { x: place.x + 70.5, y: place.y + 80.5 } });
    const [, x, y, r, g, b, error] = (await text("#probe")).match(/^(\d+), (\d+): (\S+) {2}(\S+) {2}(\S+) ± (\S+)/);
    assert.deepEqual([x, y], ["70", "80"]);
    const pixel = 80 * WIDTH + 70;
    for (const [is, channel] of [[r, "R"], [g, "G"], [b, "B"]]) assert.ok(Math.abs(is - exr.channels[channel][pixel]) <= 2e-3 * exr.channels[channel][pixel] + 1e-4, `${channel}: ${is}`);
    assert.ok(Number(error) >= 0);
  },

  async "what is far away is seen with few tiles"() {
    await page.evaluate(() => lightmill.view.zoom(0.25));
    const { level, count } = await until("a coarse level", () =>
      page.evaluate(() => {
        const { view } = lightmill, wanted = view.wanted(), at = [...view.layer.tiles.values()].filter((t) => t.level === wanted.level);
        return wanted.level > 0 && at.length > 0 && { level: wanted.level, count: at.length };
      }));
    assert.equal(level, 2);
    assert.equal(count, 1);
    await page.keyboard.press("1");
  },

  async "the page is whole in dark and light, on 390 pixels, and for screen readers"() {
    await assertAccessible("dark");
    const dark = await page.evaluate(() => getComputedStyle(document.body).backgroundColor);
    await page.emulateMedia({ colorScheme: "light" });
    assert.notEqual(await page.evaluate(() => getComputedStyle(document.body).backgroundColor), dark);
    await assertAccessible("light");
    await screenshot("light");
    await page.keyboard.press("?");
    assert.equal(await page.locator("#help").isVisible(), true);
    assert.ok((await page.locator("#keys tr").count()) > 10);
    await assertAccessible("help");
    await page.keyboard.press("?");
    assert.equal(await page.locator("#help").isVisible(), false);
    await page.setViewportSize({ width: 390, height: 844 });
    await sleep(300);
    assert.ok((await page.evaluate(() => document.documentElement.scrollWidth)) <= 390, "it scrolls sideways");
    await assertCanvas(""); // all of it is still in sight
    await assertAccessible("390 pixels");
    await screenshot("phone");
    await page.setViewportSize({ width: 1280, height: 900 });
    await page.emulateMedia({ colorScheme: "dark" });
  },

  async "everything can be done by keyboard"() {
    const tabTo = (selector) =>
      until(`Tab reaches ${selector}`, async () => {
        await page.keyboard.press("Tab");
        return page.evaluate((one) => document.activeElement.matches(one), selector);
      });
    await page.evaluate(() => document.activeElement.blur());
    await tabTo("#canvas");
    await page.keyboard.press("ArrowRight");
    await page.keyboard.press("ArrowDown");
    assert.match(await text("#probe"), /^\d+, \d+: /);
    await tabTo("#spp");
    await page.keyboard.type("2000000");
    await page.keyboard.press("Enter");
    await until("the extension", () => farm.status(job).spp === 2000000);
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("p");
    await until("the job goes on", () => farm.status(job).state === "running");
    const { version } = await shown();
    await until("a newer image", async () => (await shown()).version > version);
  },

  async "a hidden page asks for nothing"() {
    const hide = (hidden) =>
      page.evaluate((value) => {
        Object.defineProperty(document, "hidden", { value, configurable: true });
        document.dispatchEvent(new Event("visibilitychange"));
      }, hidden);
    await hide(true);
    await sleep(300);
    const asked = [];
    const count = (request) => asked.push(request.url());
    page.on("request", count);
    await sleep(2000);
    page.off("request", count);
    assert.deepEqual(asked, []);
    await hide(false);
    await said("#connection", "live");
  },

  async "a master that is killed and comes back is seen without a reload"() {
    await until("a checkpoint", () => farm.status(job).checkpoint_age >= 0);
    await farm.killMaster();
    await said("#connection", "connection lost");
    await screenshot("lost");
    await sleep(1000);
    await farm.startMaster();
    await said("#connection", "came back");
    await said("#image-title", "running");
    const { version } = await until("the image", async () => (await shown()).version > 0 && (await shown()));
    await until("a newer image", async () => (await shown()).version > version);
    assert.equal(await page.evaluate(() => globalThis.neverReloaded), true);
    assert.match(await text("#events"), /The master came back/);
  },

  async "what is cancelled and deleted is asked for first"() {
    await page.click("#cancel");
    await page.click("#sure button[value=no]");
    await sleep(200);
    assert.equal(farm.status(job).state, "running");
    await page.click("#cancel");
    await page.click("#sure-yes");
    await until("the end", () => farm.status(job).state === "cancelled");
    await said("#image-title", "cancelled");
    await page.click("#delete");
    await page.click("#sure-yes");
    await until("no job", async () => (await page.locator("#jobs tr").count()) === 0);
    await said("#image-title", "No job");
  },

  async "who may only look is told so, and who has no token how to get one"() {
    job = Number(farm.ask("submit", "scenes/cornell", "--resolution", "64x64", "--spp", "1000000"));
    const viewer = await browser.newPage();
    await viewer.goto(farm.address("--view"));
    await until("the job", async () => (await viewer.textContent("#image-title")).includes("cornell"));
    await viewer.click("#pause");
    await until("the refusal", async () => (await viewer.textContent("#answer")).startsWith("Not allowed"));
    assert.notEqual(farm.status(job).state, "paused");
    await viewer.goto(`http://127.0.0.1:${farm.page}/#token=wrong`);
    await until("the refusal", () => viewer.locator("#sign-in").isVisible());
    assert.match(await viewer.textContent("#sign-in"), /refused the token.*lightmill open/s);
    await viewer.close();
  },
};

// ---- running them

async function begin() {
  await farm.begin(2);
  job = Number(farm.ask("submit", "scenes/cornell", "--resolution", `${WIDTH}x${HEIGHT}`, "--spp", "1000000", "--error", "0.0001"));
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", headless: true, args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
  page = await browser.newPage({ viewport: { width: 1280, height: 900 }, colorScheme: "dark" });
  page.on("pageerror", (error) => errors.push(String(error)));
  // The browser also logs each request that fails; what the page makes of these is tested.
  page.on("console", (message) => message.type() === "error" && !message.text().startsWith("Failed to load resource") && errors.push(message.text()));
}

let passed = 0, failed = 0;
try {
  await begin();
  for (const [name, test] of Object.entries(tests)) {
    const start = Date.now();
    console.log(`[ RUN      ] ${name}`);
    await test();
    assert.deepEqual(errors, [], "errors in the browser");
    console.log(`[       OK ] ${name} (${Date.now() - start} ms)`);
    passed++;
  }
} catch (error) {
  failed = 1; // the tests stand on one another
  console.log(error.stack);
  await page?.screenshot({ path: path.join(shots, "failed.png"), fullPage: true }).catch(() => {});
  console.log(`errors in the browser: ${errors.join("; ") || "none"}; the page then: ${path.join(shots, "failed.png")}; logs: ${folder}`);
} finally {
  await browser?.close();
  await farm.end();
}
if (!failed) fs.rmSync(folder, { recursive: true });
console.log(`[  PASSED  ] ${passed} test(s).`);
if (failed) console.log(`[  FAILED  ] ${failed} test(s).`);
process.exit(failed);
