// The pictures of the replay page in docs/figures, of pages that these commands make in a new folder:
//
//   rail-sumo replay rail --seed 1 --out build/shots/highway.html
//   rail-sumo replay road-rail --network onramp --routes onramp --out build/shots/onramp.html
//   rail-sumo replay road-rail rule --network arterial --routes arterial --out build/shots/arterial.html
//   sumo -n networks/arterial.net.xml -r routes/arterial.rou.xml -e 600 --fcd-output build/shots/fcd.parquet
//   rail-sumo replay build/shots/fcd.parquet --network arterial --out build/shots/town.html
//
// PAGES=build/shots node docs/screenshots.mjs, after make page-tests, which installs what drives the browser.
import { fileURLToPath } from "node:url";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

import { chromium } from "../tests/page/node_modules/playwright-core/index.mjs";

const OUT = fileURLToPath(new URL("figures/", import.meta.url));
const WIDE = { width: 1280, height: 800 };
const NARROW = { width: 390, height: 844 };
// What is shown, when, and how: the keys that are pressed before.
const SHOTS = [
  { name: "replay_highway", page: "highway", at: 120, viewport: WIDE },
  { name: "replay_onramp", page: "onramp", at: 45, viewport: WIDE },
  { name: "replay_dark", page: "highway", at: 120, viewport: WIDE, colorScheme: "dark" },
  { name: "replay_two", page: "arterial", at: 126.7, viewport: WIDE },
  { name: "replay_narrow", page: "highway", at: 120, viewport: NARROW },
  { name: "replay_town", page: "town", at: 400, viewport: WIDE },
];

const browser = await chromium.launch({ executablePath: process.env.CHROMIUM ?? "/usr/bin/chromium", args: ["--no-sandbox"] });
for (const { name, page: of, at, viewport, colorScheme = "light" } of SHOTS) {
  const page = await browser.newPage({ viewport, colorScheme });
  await page.goto(pathToFileURL(join(process.env.PAGES, `${of}.html`)).href);
  await page.waitForFunction(() => window.replay);
  await page.evaluate((seconds) => (location.hash = `#t=${seconds}`), at);
  await page.waitForTimeout(800);
  await page.screenshot({ path: join(OUT, `${name}.png`) });
  console.log(name);
  await page.close();
}
await browser.close();
