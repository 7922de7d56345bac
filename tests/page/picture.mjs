// The pictures of the page in README.md and docs/http.md: the seed's scene as it converges, eye and light image side by
// side, from the first second to the end.
//
// usage: node picture.mjs BUILD FOLDER      writes FOLDER/page-begin.png, page-middle.png, page-end.png and page-phone.png
import fs from "node:fs";
import { createRequire } from "node:module";
import os from "node:os";
import path from "node:path";
import { Farm, sleep, until } from "./farm.mjs";

const build = path.resolve(process.argv[2]), folder = process.argv[3];
const { chromium } = createRequire(path.join(build, "page", "/"))("playwright-core");
const SIDE = 224, TARGET = 0.03, MIDDLE = 0.08; // the error at the end, and when the picture of the middle is taken

const scratch = fs.mkdtempSync(path.join(os.tmpdir(), "lightmill-picture-"));
const farm = new Farm(build, scratch);
let browser;

/** Takes the picture once the page shows both images. */
async function take(page, name) {
  await until("both images", () => page.evaluate(() => lightmill.view.other && lightmill.view.layer.tiles.size > 0 && lightmill.view.other.layer.tiles.size > 0), 60000);
  await sleep(200);
  await page.screenshot({ path: path.join(folder, `page-${name}.png`) });
}

async function run() {
  await farm.begin(2);
  browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", headless: true, args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
  const page = await browser.newPage({ viewport: { width: 1060, height: 600 }, colorScheme: "dark" });
  await page.goto(farm.address());
  const job = Number(farm.ask("submit", "scenes/seed-hidden", "--resolution", `${SIDE}x${SIDE}`, "--spp", "65536", "--error", String(TARGET)));
  await until("the job", () => page.evaluate(() => lightmill.state.chosen !== null));
  await page.keyboard.press("b");
  await page.keyboard.press("1");
  await page.locator("#exposure").evaluate((slider) => {
    slider.value = 1;
    slider.dispatchEvent(new Event("input"));
  });
  await take(page, "begin");
  await until("the middle", () => farm.status(job).error > 0 && farm.status(job).error < MIDDLE, 600000);
  await take(page, "middle");
  await until("the end", () => farm.status(job).state === "done", 1800000);
  await until("the end on the page", async () => (await page.textContent("#image-title")).endsWith("done"));
  await sleep(3000);
  await take(page, "end");
  await page.setViewportSize({ width: 390, height: 700 });
  await page.keyboard.press("b");
  await page.selectOption("#tone", "relative");
  await page.keyboard.press("0");
  await page.locator("#image").scrollIntoViewIfNeeded();
  await sleep(2000);
  await page.screenshot({ path: path.join(folder, "page-phone.png") });
}

try {
  await run();
} finally {
  await browser?.close();
  await farm.end();
  fs.rmSync(scratch, { recursive: true });
}
