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
let browser, page, job, second, exr, pinned;

// ---- what the page has

const shown = () => page.evaluate(() => ({ version: lightmill.tiles.version, layer: lightmill.tiles.name, scale: lightmill.view.scale }));
const text = (selector) => page.textContent(selector);
const said = (selector, words) => until(`${selector} says "${words}"`, async () => (await text(selector)).includes(words));

/** All tiles of level 0 are there. */
const complete = () =>
  page.evaluate(() => {
    const { view } = lightmill, count = [...view.layer.tiles.values()].filter((tile) => tile.level === 0).length;
    return count === Math.ceil(view.width / 64) * Math.ceil(view.height / 64);
  });

/** The sum of the bits of all texels: another image has another. */
const fingerprint = () => page.evaluate(() => [...lightmill.view.layer.tiles.values()].reduce((sum, tile) => tile.texels.reduce((all, half) => all + half, sum), 0));

/** The numbers that `inPage` leaves in a typed array of this kind; text takes far less time than a list of numbers. */
async function numbers(kind, inPage, argument) {
  const base64 = await page.evaluate(`(async () => {
    const array = await (${inPage})(${JSON.stringify(argument)});
    let text = "";
    for (const byte of new Uint8Array(array.buffer)) text += String.fromCharCode(byte);
    return btoa(text);
  })()`);
  return Array.from(new kind(new Uint8Array(Buffer.from(base64, "base64")).buffer));
}

/** The texels of level 0 as [height][width][4] numbers. */
const texels = () =>
  numbers(Float32Array, async () => {
    const { halfToNumber } = await import("/tiles.js");
    const { view } = lightmill, values = new Float32Array(4 * view.width * view.height).fill(NaN);
    for (const tile of view.layer.tiles.values()) {
      if (tile.level !== 0) continue;
      for (let y = 0; y < tile.h; y++)
        for (let x = 0; x < tile.w; x++)
          for (let c = 0; c < 4; c++) values[4 * ((64 * tile.ty + y) * view.width + 64 * tile.tx + x) + c] = halfToNumber(tile.texels[4 * (y * tile.w + x) + c]);
    }
    return values;
  });

/** The image at 1:1 in a pane of the canvas as [height][width][3] bytes. */
const canvas = (pane = 0) =>
  numbers(Uint8Array, (i) => {
    const { view } = lightmill, all = view.pixels(), bytes = new Uint8Array(3 * view.width * view.height), row = view.canvas.width, at = view.panes()[i];
    for (let y = 0, n = 0; y < view.height; y++)
      for (let x = 0; x < view.width; x++) for (let c = 0; c < 3; c++) bytes[n++] = all[4 * ((view.canvas.height - 1 - y - view.y - at.y) * row + x + view.x + at.x) + c];
    return bytes;
  }, pane);

const srgb = (v) => {
  const c = Math.min(Math.max(v, 0), 1);
  return 255 * (c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055);
};
const mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;

/** What the canvas is to show of three channels: their values times 2^exposure as sRGB. */
const expected = (layer, exposure = 0, file = exr) => {
  const out = [];
  for (let p = 0; p < WIDTH * HEIGHT; p++) for (const c of "RGB") out.push(srgb(file.channels[layer + c][p] * 2 ** exposure));
  return out;
};
const LUMINANCE = [0.2126, 0.7152, 0.0722];
const luminance = (file, p, layer = "") => LUMINANCE.reduce((sum, weight, c) => sum + weight * file.channels[layer + "RGB"[c]][p], 0);

async function chooseLayer(name) {
  await page.selectOption("#layer", name);
  await until(`the tiles of ${name}`, async () => (await shown()).version > 0 && (await shown()).layer === name && (await complete()));
  return texels();
}

/** Fails unless a pane shows an image of the file. */
async function assertCanvas(layer, exposure = 0, pane = 0) {
  const wanted = expected(layer, exposure);
  assertNear(await canvas(pane), wanted);
}

function assertNear(is, wanted) {
  assert.ok(wanted.some((v) => v > 20), "the image is not black");
  assert.ok(Math.abs(mean(is) - mean(wanted)) < 0.3, `mean ${mean(is)} on the canvas, ${mean(wanted)} of the file`);
  const worst = Math.max(...is.map((v, i) => Math.abs(v - wanted[i])));
  assert.ok(worst <= 1.5, `a value is off by ${worst} of 255`);
}

/** The job's image now, once the page has it too. */
async function fetchExr(number = job) {
  const file = path.join(folder, `job-${number}.exr`);
  farm.ask("fetch", String(number), "-o", file, ...(number === job ? ["--halves"] : []));
  return readExr(file);
}

/** Pauses the job that renders, and waits until the page shows its last batch. */
async function settled() {
  await until("the pause", () => farm.status(job).state === "paused");
  await until("the last batches", () => farm.status(job).samples_out === 0);
  exr = await fetchExr();
  const { batches } = farm.status(job);
  await until("the last version", async () => (await shown()).version === batches);
  await until("all tiles", complete);
}

const setRange = (selector, value) =>
  page.locator(selector).evaluate((element, v) => {
    element.value = v;
    element.dispatchEvent(new Event("input"));
  }, value);

/** "mean 1 2 3; luminance 4 ± 5, from 6 to 7" as { rgb, mean, error, least, most }. */
async function regionText() {
  const words = await until("the rectangle's mean", async () => {
    const all = await text("#region");
    return all.includes("mean") && all;
  });
  const [, r, g, b, y, error, least, most] = words.match(/mean (\S+) {2}(\S+) {2}(\S+); luminance (\S+) ± (\S+), from (\S+) to (\S+)/);
  return { words, rgb: [r, g, b].map(Number), mean: Number(y), error: Number(error), least: Number(least), most: Number(most) };
}

/** Fails unless the page says of the rectangle what the file does. */
async function assertRegion({ x0, y0, x1, y1 }) {
  const is = await regionText(), pixels = [], near = (a, b, what) => assert.ok(Math.abs(a - b) <= 2e-3 * Math.abs(b) + 1e-6, `${what}: ${a} instead of ${b}`);
  assert.ok(is.words.includes(`from ${x0}, ${y0}, ${x1 - x0} × ${y1 - y0}`), is.words);
  assert.ok(!is.words.includes("level"), "it is of level 0");
  for (let y = y0; y < y1; y++) for (let x = x0; x < x1; x++) pixels.push(y * WIDTH + x);
  is.rgb.forEach((value, c) => near(value, mean(pixels.map((p) => exr.channels["RGB"[c]][p])), "RGB"[c]));
  const values = pixels.map((p) => luminance(exr, p)), errors = pixels.map((p) => luminance(exr, p, "noise."));
  near(is.mean, mean(values), "luminance");
  near(is.error, Math.sqrt(errors.reduce((sum, e) => sum + e * e, 0)) / pixels.length, "standard error");
  near(is.least, Math.min(...values), "least");
  near(is.most, Math.max(...values), "most");
}

async function assertAccessible(what) {
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  assert.deepEqual(violations.map((v) => `${v.id}: ${v.nodes.map((n) => n.html).join(" ")}`), [], `axe: ${what}`);
}

const screenshot = (name) => page.screenshot({ path: path.join(shots, `${name}.png`), fullPage: true });

// ---- the tests, in their order

/** Fails unless the wipe shows the pinned state left of its line, and the image now right of it; moves it by keys. */
async function assertWipe() {
  const lineAt = () => page.evaluate(() => Math.round(lightmill.view.divider * lightmill.view.canvas.width) - lightmill.view.x);
  const before = await lineAt();
  await page.keyboard.press("]");
  const box = await page.locator("#canvas").boundingBox(), at = await lineAt();
  assert.ok(at > before);
  await page.mouse.move(box.x + (await page.evaluate(() => lightmill.view.x)) + at, box.y + 20);
  await page.mouse.down();
  await page.mouse.move(box.x + (await page.evaluate(() => lightmill.view.x)) + 60, box.y + 20);
  await page.mouse.up();
  assert.ok(Math.abs((await lineAt()) - 60) <= 1, "the line is dragged");
  const old = expected("", 0, pinned), now = expected("", 0, exr), is = await canvas();
  const side = (p) => (p % WIDTH < 56 ? old : p % WIDTH >= 64 ? now : null);
  assertNear(is, is.map((v, i) => side(Math.floor(i / 3))?.[i] ?? v));
}

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
    await said("#image-title", "paused");
  },

  async "the canvas shows what the file of the image holds"() {
    await settled();
    assert.deepEqual([exr.width, exr.height], [WIDTH, HEIGHT]);
    await page.keyboard.press("1");
    await until("the zoom", async () => (await shown()).scale === 1);
    await until("all tiles", complete);
    await assertCanvas("");
    await screenshot("dark");
  },

  async "every layer holds what the file's layer holds"() {
    const layers = { picture: ["R", "G", "B"], eye: ["eye.R", "eye.G", "eye.B"], light: ["light.R", "light.G", "light.B"], noise: ["noise.R", "noise.G", "noise.B"], albedo: ["albedo.R", "albedo.G", "albedo.B"], normal: ["normal.X", "normal.Y", "normal.Z"], depth: ["depth.Z"], samples: ["samples"], half0: ["half0.R", "half0.G", "half0.B"], half1: ["half1.R", "half1.G", "half1.B"] };
    const near = (is, was, what) => assert.ok(Math.abs(is - was) <= 1e-3 * Math.abs(was) + 1e-6, `${what}: ${is} instead of ${was}`);
    for (const [name, channels] of Object.entries(layers)) {
      const values = await chooseLayer(name);
      for (let p = 0; p < WIDTH * HEIGHT; p++)
        channels.forEach((channel, c) => near((name === "samples" ? 1024 : 1) * values[4 * p + c], exr.channels[channel][p], `${channel} of pixel ${p}`));
      const error = (p) => 0.2126 * exr.channels["noise.R"][p] + 0.7152 * exr.channels["noise.G"][p] + 0.0722 * exr.channels["noise.B"][p];
      for (let p = 0; name === "picture" && p < WIDTH * HEIGHT; p++) near(values[4 * p + 3], error(p), `the error of pixel ${p}`);
      if (["eye", "light", "albedo"].includes(name)) await assertCanvas(`${name}.`);
    }
    for (const name of ["object", "material"]) {
      const values = await chooseLayer(name), is = await canvas(), colours = new Map();
      for (let p = 0; p < WIDTH * HEIGHT; p++) {
        const id = exr.channels[`${name}.id`][p], colour = is.slice(3 * p, 3 * p + 3).join();
        assert.equal(values[4 * p] + 2048 * values[4 * p + 1] + 2048 ** 2 * values[4 * p + 2], id);
        assert.equal(colours.get(id) ?? colour, colour, `${name} ${id} has two colours`);
        colours.set(id, colour);
      }
      assert.ok(colours.size > 3 && new Set(colours.values()).size === colours.size, `${colours.size} ids, ${new Set(colours.values()).size} colours`);
    }
    const values = await chooseLayer("strategies");
    for (let p = 0; p < WIDTH * HEIGHT; p++) {
      const eye = luminance(exr, p, "eye."), light = luminance(exr, p, "light."), sum = eye + light;
      if (sum > 1e-4) assert.ok(Math.abs(values[4 * p] - eye / sum) < 2e-3 && Math.abs(values[4 * p + 2] - light / sum) < 2e-3, `the shares of pixel ${p}`);
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

  async "a pixel on the rim of a tile shows its place, not the tile's other side"() {
    const zoomed = (scale) =>
      numbers(Uint8Array, (s) => {
        const { view } = lightmill, all = (Object.assign(view, { scale: s, x: 0, y: 0 }), view.pixels()), bytes = [];
        view.actual();
        for (let y = 0; y < Math.floor(view.height * s); y++)
          for (let x = 0; x < Math.floor(view.width * s); x++) bytes.push(...all.slice(4 * ((view.canvas.height - 1 - y) * view.canvas.width + x), 4 * ((view.canvas.height - 1 - y) * view.canvas.width + x) + 3));
        return Uint8Array.from(bytes);
      }, scale);
    const scale = 48.5 / 64, is = await zoomed(scale), wanted = expected(""), width = Math.floor(WIDTH * scale); // tiles end in the middle of pixels
    const shows = (p, x, y) => [0, 1, 2].every((c) => Math.abs(is[3 * p + c] - wanted[3 * (y * WIDTH + x) + c]) <= 1.5);
    const near = (v, side) => [0, -1, 1].map((d) => Math.floor(v / scale + d)).filter((at) => at >= 0 && at < side);
    for (let p = 0; p < is.length / 3; p++) {
      const x = (p % width) + 0.5, y = Math.floor(p / width) + 0.5;
      assert.ok(near(y, HEIGHT).some((v) => near(x, WIDTH).some((u) => shows(p, u, v))), `the pixel at ${x}, ${y}`);
    }
  },

  async "eye and light image are seen side by side, at one exposure"() {
    await page.keyboard.press("b");
    await until("both", () => page.evaluate(() => lightmill.view.panes().length === 2 && lightmill.view.other.layer.tiles.size > 0));
    await page.keyboard.press("1");
    await setRange("#exposure", 1);
    await until("the tiles", async () => (await shown()).layer === "eye" && (await complete()));
    await page.evaluate(() => lightmill.view.setProbe(-1, -1)); // its frame is drawn in both panes
    await assertCanvas("eye.", 1, 0);
    await assertCanvas("light.", 1, 1);
    assert.match(await text("#comparison"), /Left: job \d+, eye, now. Right: layer light/);
    await screenshot("eye-and-light");
    await page.click("#both");
    assert.equal(await page.inputValue("#layer"), "picture");
    await page.keyboard.press("r");
    await page.keyboard.press("1");
    await until("the picture", async () => (await shown()).layer === "picture" && (await complete()));
    await assertCanvas("");
  },

  async "a rectangle tells its mean and the standard error of that"() {
    const place = await page.evaluate(() => ({ x: lightmill.view.x, y: lightmill.view.y }));
    const box = await page.locator("#canvas").boundingBox(), at = (x, y) => [box.x + place.x + x + 0.5, box.y + place.y + y + 0.5];
    await page.keyboard.down("Shift");
    await page.mouse.move(...at(150, 100));
    await page.mouse.down();
    await page.mouse.move(...at(120, 20));
    await page.mouse.move(...at(51, 30), { steps: 3 });
    await page.mouse.up();
    await page.keyboard.up("Shift");
    await until("the rectangle", async () => (await text("#region")).includes("100 × 71: mean"));
    await assertRegion({ x0: 51, y0: 30, x1: 151, y1: 101 });
    assert.deepEqual(await page.evaluate(() => ({ x: lightmill.view.x, y: lightmill.view.y })), place, "it does not pan");
    await screenshot("rectangle");
    await page.keyboard.press("u");
    assert.equal(await text("#region"), "");
    await page.focus("#canvas"); // by keys alone, from where the pointer was
    await page.keyboard.press("m");
    for (const key of ["Control+ArrowRight", "Control+ArrowDown", "ArrowDown"]) await page.keyboard.press(key);
    await page.keyboard.press("m");
    await page.keyboard.press("ArrowDown"); // moves the probe only
    await until("the rectangle", async () => (await text("#region")).includes("17 × 18: mean"));
    await assertRegion({ x0: 51, y0: 30, x1: 68, y1: 48 });
    await page.click("#unmark");
    assert.equal(await text("#region"), "");
  },

  async "a large rectangle is measured at a level that can be fetched"() {
    const levels = await page.evaluate(async () => {
      const { levelOf } = await import("/region.js");
      return [2048, 2049, 8192].map((side) => levelOf({ x0: 0, y0: 0, x1: side, y1: side }));
    });
    assert.deepEqual(levels, [0, 1, 2]);
  },

  async "a state is pinned"() {
    await page.keyboard.press("a");
    await said("#comparison", "Kept as pin 1: job 1, picture");
    await sleep(1500); // the queue is asked for again
    await said("#comparison", "Kept as pin 1");
    pinned = exr;
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
    const all = { x0: 0, y0: 0, x1: WIDTH, y1: HEIGHT };
    const found = await page.evaluate(async (mark) => (await import("/region.js")).measure(lightmill.view.layer, "picture", mark, 2), all);
    const pixels = exr.channels.R.map((_, p) => p), near = (a, b) => assert.ok(Math.abs(a - b) <= 2e-3 * b, `${a} instead of ${b}`);
    near(found.mean, mean(Array.from(pixels, (p) => luminance(exr, p))));
    near(found.error, Math.sqrt(pixels.reduce((sum, p) => sum + luminance(exr, p, "noise.") ** 2, 0)) / pixels.length);
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
    await tabTo("#goal");
    await page.keyboard.type("2000000");
    await page.keyboard.press("Enter");
    await until("the extension", () => farm.status(job).spp === 2000000);
    await said("#events", "goes on to 2000000 samples a pixel");
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("p");
    await until("the job goes on", () => farm.status(job).state === "running");
    const { version } = await shown();
    await until("a newer image", async () => (await shown()).version > version);
  },

  async "a pinned state is compared with the image now: side by side, by a wipe, by differences"() {
    await page.keyboard.press("p");
    await settled();
    await page.selectOption("#other", "pin:0");
    await page.keyboard.press("1");
    const plain = await canvas(1);
    await page.evaluate(() => lightmill.view.setProbe(100, 50));
    assert.notDeepEqual(await canvas(1), plain, "the probe is framed in the other pane too");
    await page.evaluate(() => lightmill.view.setProbe(-1, -1));
    assertNear(await canvas(0), expected("", 0, exr));
    assertNear(await canvas(1), expected("", 0, pinned));
    await page.selectOption("#how", "wipe");
    await page.keyboard.press("1");
    assert.match(await text("#comparison"), /Left of the line: pin 1: .*Right: job 1, picture, now/);
    await assertWipe();
    await assertAccessible("a wipe");
    await page.selectOption("#how", "signed");
    await setRange("#exposure", 4);
    const difference = (p) => 16 * (luminance(exr, p) - luminance(pinned, p));
    // Both are halves, whose rounding the exposure enlarges.
    const room = (p) => 16 * 2 ** -10 * (luminance(exr, p) + luminance(pinned, p)), orange = [1, 0.45, 0.1], blue = [0.1, 0.45, 1];
    const shows = (is, low, high, what) => assert.ok(is >= srgb(Math.min(low, high)) - 1.5 && is <= srgb(Math.max(low, high)) + 1.5, `${what}: ${is}`);
    let brighter = 0, darker = 0;
    const is = await canvas();
    for (let p = 0; p < WIDTH * HEIGHT; p++) {
      const d = difference(p), e = room(p);
      if (Math.abs(d) < e) continue;
      if (d > 0) brighter++;
      else darker++;
      for (let c = 0; c < 3; c++) shows(is[3 * p + c], (Math.abs(d) - e) * (d > 0 ? orange : blue)[c], (Math.abs(d) + e) * (d > 0 ? orange : blue)[c], `pixel ${p}`);
    }
    assert.ok(brighter > 1000 && darker > 1000, `${brighter} brighter, ${darker} darker`);
    await screenshot("difference");
    await setRange("#exposure", 0);
  },

  async "another job is compared, and one of another size refused"() {
    const submit = (...args) => Number(farm.ask("submit", "scenes/cornell", ...args));
    second = submit("--resolution", `${WIDTH}x${HEIGHT}`, "--spp", "4", "--save-at", "2", "--seed", "5");
    const small = submit("--resolution", "64x48", "--spp", "1");
    await until("both", () => farm.status(second).state === "done" && farm.status(small).state === "done");
    const other = await fetchExr(second);
    await until("the choice", async () => (await page.locator(`#other option[value="job:${small}"]`).count()) === 1);
    await page.selectOption("#how", "absolute");
    await page.selectOption("#other", `job:${second}`);
    const wanted = [];
    for (let p = 0; p < WIDTH * HEIGHT; p++) for (const c of "RGB") wanted.push(srgb(Math.abs(exr.channels[c][p] - other.channels[c][p])));
    const far = (is) => is.filter((v, i) => Math.abs(v - wanted[i]) > 3).length;
    // Where both are nearly equal, sRGB's steep start shows the rounding of halves.
    await until("the difference", async () => far(await canvas()) < 0.01 * wanted.length);
    assert.ok(Math.abs(mean(await canvas()) - mean(wanted)) < 0.3);
    await page.selectOption("#other", `job:${small}`);
    assert.match(await text("#comparison"), /Job \d+ has 64 × 48 pixels, job 1 has 200 × 136: only images of one size/);
    await assertCanvas("");
    await page.selectOption("#other", "");
    farm.ask("delete", String(small));
  },

  async "light groups are mixed: all at 1 are the picture, and one at 0 is gone"() {
    const lit = Number(farm.ask("submit", "scenes/seed-hidden", "--resolution", `${WIDTH}x${HEIGHT}`, "--spp", "4", "--light-groups", "front=1,rest"));
    assert.equal(await page.locator("#mixer").isVisible(), false, "this job has no groups");
    await until("the end", () => farm.status(lit).state === "done");
    await until("its row", async () => (await text("#jobs")).includes("seed-hidden"));
    await page.evaluate((number) => (location.hash = `#job=${number}`), lit);
    await until("its groups", () => page.locator("#mixer").isVisible());
    assert.match(await text("#groups"), /front.*rest/);
    await page.keyboard.press("1");
    await until("the picture", async () => (await shown()).version > 0 && (await complete()));
    const file = await fetchExr(lit);
    /** What the canvas is to show of a mix: a factor of each group, or of each of its colours. */
    const mixed = (factors) => {
      const values = [], part = (name, c, p) => file.channels[`group.${name}.eye.${c}`][p] + file.channels[`group.${name}.light.${c}`][p];
      for (let p = 0; p < WIDTH * HEIGHT; p++)
        for (const [i, c] of [..."RGB"].entries()) values.push(srgb(Object.entries(factors).reduce((sum, [name, by]) => sum + (by[i] ?? by) * part(name, c, p), 0)));
      return values;
    };
    assertNear(mixed({ front: 1, rest: 1 }), expected("", 0, file));
    const assertSoon = async (what, wanted) => {
      await until(what, async () => (await canvas()).every((v, i) => Math.abs(v - wanted[i]) <= 1.5));
      assertNear(await canvas(), wanted);
    };
    const mix = (factors) => assertSoon(`the mix ${JSON.stringify(factors)}`, mixed(factors));
    await setRange("#factor-0", 0);
    await mix({ front: 0, rest: 1 });
    await screenshot("mix");
    await assertAccessible("light groups");
    assert.match(await text("#probe"), /Point at|^\d/);
    await setRange("#factor-0", 1);
    await mix({ front: 1, rest: 1 });
    await setRange("#factor-1", 1.5);
    await setRange("#tint-0", "#ff0000");
    await mix({ front: [1, 0, 0], rest: 1.5 });
    await page.keyboard.press("a");
    await said("#comparison", `job ${lit}, mix`);
    await page.click("#unmix");
    assert.equal(await page.inputValue("#factor-1"), "1");
    await assertSoon("the picture", expected("", 0, file));
    await page.evaluate((number) => (location.hash = `#job=${number}`), job);
    await until("the job from before", async () => (await text("#image-title")).includes(`Job ${job}:`));
    assert.equal(await page.locator("#mixer").isVisible(), false);
    farm.ask("delete", String(lit));
    await page.keyboard.press("1");
    await until("all tiles", async () => (await shown()).version > 0 && (await complete()));
    await assertCanvas("");
  },

  async "images are downloaded: as they are now, and those that were kept"() {
    await page.click("#jobs tr:nth-child(2) button");
    await said("#image-title", `Job ${second}:`);
    const download = async (button) => {
      const coming = page.waitForEvent("download");
      await page.click(button);
      const got = await coming, file = path.join(folder, got.suggestedFilename());
      await got.saveAs(file);
      return file;
    };
    assert.deepEqual(await page.locator("#at option").allTextContents(), ["now", "at 2 samples a pixel"]);
    const now = await download("#exr");
    assert.match(path.basename(now), /^cornell.*\.exr$/);
    assert.deepEqual(readExr(now).channels, (await fetchExr(second)).channels);
    await page.selectOption("#at", "2");
    const kept = await download("#exr"), same = path.join(folder, "kept.exr");
    farm.ask("fetch", String(second), "--at", "2", "-o", same);
    assert.deepEqual(readExr(kept).channels, readExr(same).channels);
    assert.notDeepEqual(readExr(kept).channels.R, readExr(now).channels.R);
    const png = fs.readFileSync(await download("#png"));
    assert.equal(png.toString("latin1", 1, 4), "PNG");
    assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [WIDTH, HEIGHT]);
    await page.click("#jobs tr:nth-child(1) button");
    farm.ask("delete", String(second));
    await until("one job", async () => (await page.locator("#jobs tr").count()) === 1);
  },

  async "orders are given: retain and release, other goals"() {
    await page.click("#retain");
    await until("it is retained", () => farm.status(job).retained === true);
    await said("#retain", "Release");
    await page.click("#retain");
    await until("it is released", () => farm.status(job).retained === false);
    const goOn = async (unit, value) => {
      await page.selectOption("#unit", unit);
      await page.fill("#goal", value);
      await page.press("#goal", "Enter");
    };
    await goOn("error", "0.02");
    await until("another error", () => farm.status(job).error_target === 0.0002);
    await goOn("time", "7200");
    await until("a time", () => farm.status(job).time_limit >= 7200);
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("p");
    await until("the job goes on", () => farm.status(job).state === "running");
  },

  async "what happens on the farm is told"() {
    const guest = farm.startWorker("guest");
    await said("#events", "Worker guest joined");
    guest.kill("SIGKILL");
    await said("#events", "Worker guest left");
    await said("#events", "a checkpoint was written at");
    const lines = await page.locator("#events li").allTextContents();
    const jobs = lines.map((line) => line.match(/Job (\d+): a checkpoint/)?.[1]);
    assert.ok(jobs.every((job, i) => !job || job !== jobs[i + 1]), "one line of a job's checkpoints");
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
    for (let i = 0; i < 2; i++) {
      const seen = await fingerprint();
      await until("another image", async () => (await fingerprint()) !== seen);
    }
    await page.evaluate(() => document.activeElement.blur());
    await page.keyboard.press("p");
    await settled();
    await page.keyboard.press("1");
    await assertCanvas("");
    await page.keyboard.press("p");
    await until("the job goes on", () => farm.status(job).state === "running");
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
