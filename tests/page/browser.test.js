// The page in a real browser, opened from the disk. PAGES names the folder that `python tests/films.py FOLDER` has
// filled, CHROMIUM the browser where it goes by another name.

import assert from "node:assert/strict";
import { after, before, test } from "node:test";
import { existsSync, mkdtempSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { delimiter, join } from "node:path";
import { pathToFileURL } from "node:url";

import { chromium } from "playwright-core";

const PAGES = process.env.PAGES;
const WIDE = { width: 1280, height: 800 };
const NARROW = { width: 390, height: 844 };
const BROWSERS = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
const FIRST_FRAME_MS = 1000;

let browser;
let truth;

function browserPath() {
  const places = (process.env.PATH ?? "").split(delimiter).flatMap((folder) => BROWSERS.map((name) => join(folder, name)));
  const found = process.env.CHROMIUM ?? places.find(existsSync);
  if (!found) throw new Error("the page's tests need Chromium: apt-get install chromium, or name it in CHROMIUM");
  return found;
}

before(async () => {
  assert.ok(PAGES, "PAGES names no folder; run make page-tests");
  truth = JSON.parse(readFileSync(join(PAGES, "truth.json"), "utf8"));
  browser = await chromium.launch({ executablePath: browserPath(), args: ["--no-sandbox"] });
});

after(() => browser?.close());

/** Open a page, let `use` do with it what it wants, and check that it neither complained nor asked for anything. */
async function withPage(name, { hash = "#t=0", init, complains = false, file, ...options }, use) {
  const context = await browser.newContext({ viewport: WIDE, acceptDownloads: true, ...options });
  const page = await context.newPage();
  const [complaints, requests] = [[], []];
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && complaints.push(message.text()));
  page.on("pageerror", (error) => complaints.push(error.message));
  page.on("dialog", (dialog) => complaints.push(`dialog: ${dialog.message()}`) && dialog.dismiss());
  context.on("request", (request) => requests.push(request.url()));
  if (init) await page.addInitScript(init);
  const url = pathToFileURL(file ?? join(PAGES, `${name}.html`)).href;
  await page.goto(url + hash);
  try {
    await use(page, context);
    if (!complains) assert.deepEqual(complaints, []);
    const asked = requests.filter((request) => !request.startsWith(url) && !/^(blob|data):/.test(request));
    assert.deepEqual(asked, []);
  } finally {
    await context.close();
  }
}

const ready = (page) => page.waitForFunction(() => window.replay);
const state = (page) => page.evaluate(() => window.replay.state());
const drawn = (page) => page.evaluate(() => new Promise((resolve) => requestAnimationFrame(() => requestAnimationFrame(resolve))));
const near = (one, other, by) => Math.abs(one - other) <= by;

/** Keep a picture of the road in the page, under a name. */
async function keep(page, name) {
  await drawn(page);
  await page.evaluate((as) => {
    const canvas = document.querySelector(".stage canvas");
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    window.kept ??= {};
    window.kept[as] = new Uint32Array(copy.getImageData(0, 0, canvas.width, canvas.height).data.buffer);
  }, name);
}

/** Which share of the pixels of two pictures differ, by more than the smoothing of edges does from time to time. */
const differing = (page, one, other) =>
  page.evaluate(
    (names) => {
      const [first, second] = names.map((name) => window.kept[name]);
      const apart = (pixel, k) => [0, 8, 16].some((shift) => Math.abs(((pixel >> shift) & 0xff) - ((second[k] >> shift) & 0xff)) > 8);
      return first.filter(apart).length / first.length;
    },
    [one, other],
  );

/** How many pixels of a picture have a colour. */
const inShade = (page, name, [r, g, b]) =>
  page.evaluate(([which, colour]) => window.kept[which].filter((pixel) => (pixel & 0xffffff) === colour).length, [name, r + (g << 8) + (b << 16)]);

for (const [size, viewport] of Object.entries({ "1280 x 800": WIDE, "390 x 844": NARROW })) {
  for (const name of ["one", "two", "thousand", "town"]) {
    test(`${name}, ${size}: it opens, draws at once, stands until it is played, and fetches nothing`, async () => {
      await withPage(name, { viewport, hasTouch: viewport === NARROW, hash: "" }, async (page) => {
        await ready(page);
        const { firstFrameMs, playing, elapsed } = await state(page);
        assert.deepEqual([playing, elapsed], [false, 0], "it plays by itself");
        await page.locator(".begin").first().click();
        assert.equal((await state(page)).playing, true);
        assert.ok(firstFrameMs < FIRST_FRAME_MS, `the first frame came after ${firstFrameMs} ms`);
        await page.evaluate(() => window.replay.seek(120));
        const median = await page.evaluate(
          () =>
            new Promise((resolve) => {
              const [times, began] = [[], performance.now()];
              const look = (now) => {
                times.push(now);
                if (now - began < 2000) requestAnimationFrame(look);
                else {
                  const steps = times.slice(1).map((time, k) => time - times[k]).sort((a, b) => a - b);
                  resolve(steps[Math.floor(steps.length / 2)]);
                }
              };
              requestAnimationFrame(look);
            }),
        );
        await page.keyboard.press("Space");
        assert.equal((await state(page)).playing, false);
        const work = await page.evaluate(() => {
          const began = performance.now();
          for (let k = 0; k < 20; k += 1) {
            window.replay.elapsed = 120 + k * 0.37;
            window.replay.draw();
          }
          return (performance.now() - began) / 20;
        });
        console.log(
          `${name}, ${size}: ${(truth[name].bytes / 1e6).toFixed(2)} MB, first frame ${firstFrameMs.toFixed(0)} ms, ` +
            `${(1000 / median).toFixed(0)} frames a second, ${work.toFixed(1)} ms to draw one`,
        );
        await page.evaluate(() => window.replay.seek(30));
        await keep(page, "at 30 s");
        await page.evaluate(() => window.replay.seek(33));
        await keep(page, "at 33 s");
        assert.ok((await differing(page, "at 30 s", "at 33 s")) > 0.001, "the picture stands still");
        const overflow = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
        assert.ok(overflow <= 0, `the page is ${overflow} px wider than the window`);
      });
    });
  }
}

for (const name of ["one", "two", "unequal", "sumo", "hostile", "town"]) {
  test(`${name}: what was packed is what is shown`, async () => {
    await withPage(name, {}, async (page) => {
      await ready(page);
      for (const [number, film] of truth[name].films.entries()) {
        const shown = await page.evaluate(
          ([which, frames]) => {
            const { films, head } = window.replay;
            const { spans, quanta, driven, ...rest } = films[which];
            return {
              quanta,
              nFrames: rest.nFrames,
              frames: frames.map((frame) => {
                const vehicles = {};
                for (let span = 0; span < spans.first.length; span += 1) {
                  const since = frame - spans.first[span];
                  if (since < 0 || since >= spans.length[span]) continue;
                  const row = spans.row[span] + since;
                  vehicles[rest.vehicles[spans.vehicle[span]].id] = [
                    head.origin_m[0] + rest.x[row] * quanta.position_m,
                    head.origin_m[1] + rest.y[row] * quanta.position_m,
                    rest.heading[row] * quanta.heading_rad,
                    rest.speed[row] * quanta.speed_mps,
                  ];
                }
                const seen = driven && {
                  rays: Array.from({ length: driven.nRays }, (_, k) => driven.ray[k * rest.nFrames + frame] * quanta.ray_m),
                  gap: Number.isNaN(driven.gapM[frame]) ? null : driven.gapM[frame],
                  set: Number.isNaN(driven.setMps[frame]) ? null : driven.setMps[frame],
                  limit: driven.limitMps[frame],
                  holding: driven.holding[frame],
                };
                return { vehicles, ...seen };
              }),
              decisions: driven?.decisions ?? [],
              marks: driven?.marks ?? [],
              endReason: driven?.endReason ?? null,
            };
          },
          [number, film.frames.map(({ frame }) => frame)],
        );
        assert.deepEqual([shown.nFrames, shown.endReason], [film.n_frames, film.end_reason]);
        const { quanta } = shown;
        const within = (one, other, quantum, what) => assert.ok(near(one, other, 0.501 * quantum + 1e-9), `${what}: ${one}, ${other}`);
        film.frames.forEach((expected, k) => {
          const found = shown.frames[k];
          assert.deepEqual(Object.keys(found.vehicles).sort(), Object.keys(expected.vehicles).sort());
          for (const [id, [x, y, heading, speed]] of Object.entries(expected.vehicles)) {
            const there = found.vehicles[id];
            within(there[0], x, quanta.position_m, "x");
            within(there[1], y, quanta.position_m, "y");
            within(Math.sin((there[2] - heading) / 2) * 2, 0, quanta.heading_rad, "heading");
            within(there[3], speed, quanta.speed_mps, "speed");
          }
          if (!expected.rays) return;
          expected.rays.forEach((reach, ray) => within(found.rays[ray], reach, quanta.ray_m, "ray"));
          if (expected.gap === null) assert.equal(found.gap, null);
          else within(found.gap, expected.gap, quanta.gap_m, "gap");
          if (expected.set === null) assert.equal(found.set, null);
          else within(found.set, expected.set, quanta.speed_mps, "set speed");
          within(found.limit, expected.limit, quanta.speed_mps, "limit");
          assert.equal(found.holding, expected.holding);
        });
        assert.equal(shown.decisions.length, film.decisions.length);
        film.decisions.forEach(([frame, asked, carriedOut, why, open, shares, judged, stays], k) => {
          const found = shown.decisions[k];
          assert.deepEqual([found.frame, found.asked, found.carriedOut, found.why, found.open, found.stays], [frame, asked, carriedOut, why, open, stays]);
          shares.forEach((share, action) => within(found.probabilities[action], share, quanta.probability, "probability"));
          within(found.judged, judged, quanta.probability, "score");
        });
        assert.deepEqual(shown.marks.map(({ frame, kind, text }) => [frame, kind, text]), film.marks);
      }
    });
  });
}

test("every key does what it should", async () => {
  await withPage("one", { hash: "#t=60" }, async (page) => {
    await ready(page);
    const [film] = truth.one.films;
    const press = async (key) => {
      await page.keyboard.press(key);
      return state(page);
    };
    assert.ok(near((await press("ArrowRight")).elapsed, 61, 1e-9));
    assert.ok(near((await press("Shift+ArrowRight")).elapsed, 71, 1e-9));
    assert.ok(near((await press("Shift+ArrowLeft")).elapsed, 61, 1e-9));
    assert.ok(near((await press("ArrowLeft")).elapsed, 60, 1e-9));
    const decisions = film.decisions.map(([frame]) => frame / 10);
    assert.ok(near((await press(".")).elapsed, decisions.find((at) => at > 60.001), 1e-6));
    assert.ok(near((await press(",")).elapsed, 60, 1e-6));
    assert.ok(near((await press(",")).elapsed, decisions.findLast((at) => at < 59.999), 1e-6));
    await page.evaluate(() => window.replay.seek(60));
    const marks = [...new Set(film.marks.map(([frame]) => frame / 10))];
    assert.ok(near((await press("k")).elapsed, marks.find((at) => at > 60.001), 1e-6));
    const here = (await state(page)).elapsed;
    assert.ok(near((await press("j")).elapsed, marks.findLast((at) => at < here - 0.001), 1e-6));
    for (const [k, rate] of [0.25, 0.5, 1, 2, 4, 8, 16].entries()) assert.equal((await press(String(k + 1))).rate, rate);
    for (const [key, what] of [["f", "follows"], ["l", "rays"], ["n", "names"]]) {
      const was = (await state(page))[what];
      assert.equal((await press(key))[what], !was);
      assert.equal((await press(key))[what], was);
    }
    const { scale } = (await state(page)).views[0];
    assert.ok((await press("+")).views[0].scale > scale);
    assert.ok(near((await press("-")).views[0].scale, scale, 1e-9));
    assert.equal((await press("0")).follows, false);
    assert.equal((await press("End")).elapsed, 300);
    assert.equal((await press("Home")).elapsed, 0);
    assert.equal((await press("Space")).playing, true);
    assert.equal((await press("Space")).playing, false);
    await press("?");
    assert.equal(await page.locator("#keys").evaluate((dialog) => dialog.open), true);
    assert.ok((await page.locator("#keys dt").count()) >= 14);
    await press("Escape");
    assert.equal(await page.locator("#keys").evaluate((dialog) => dialog.open), false);
    const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
    const light = await ground();
    await keep(page, "light");
    await press("d");
    assert.notEqual(await ground(), light);
    await keep(page, "dark");
    assert.ok((await differing(page, "light", "dark")) > 0.9, "the road keeps its colours");
  });
});

for (const viewport of [WIDE, NARROW]) {
  test(`every button does what it should, ${viewport.width} px`, async () => {
    await withPage("one", { viewport, hasTouch: viewport === NARROW, hash: "#t=60" }, async (page) => {
      await ready(page);
      const click = async (id) => {
        await page.click(`#${id}`);
        return state(page);
      };
      assert.equal((await click("play")).playing, true);
      assert.equal(await page.getAttribute("#play", "aria-label"), "Pause (Space)");
      assert.equal((await click("play")).playing, false);
      await page.evaluate(() => window.replay.seek(60.5));
      assert.ok(near((await click("previous-decision")).elapsed, 60, 1e-6));
      assert.ok(near((await click("next-decision")).elapsed, 61, 1e-6));
      assert.ok((await click("next-mark")).elapsed > 61);
      assert.ok((await click("previous-mark")).elapsed <= 61);
      for (const [id, what] of [["follow", "follows"], ["rays", "rays"], ["names", "names"]]) {
        const was = (await state(page))[what];
        assert.equal((await click(id))[what], !was);
        assert.equal(await page.getAttribute(`#${id}`, "aria-pressed"), String(!was));
        await click(id);
      }
      const { scale } = (await state(page)).views[0];
      assert.ok((await click("zoom-in")).views[0].scale > scale);
      assert.ok(near((await click("zoom-out")).views[0].scale, scale, 1e-9));
      assert.ok((await click("whole")).views[0].scale < scale);
      await page.selectOption("#rate", "4");
      assert.equal((await state(page)).rate, 4);
      await page.keyboard.press("Space"); // the button that was clicked last does not take the key
      assert.equal((await state(page)).playing, true);
      await page.keyboard.press("Space");
      await click("help");
      await page.click("#keys button");
      await click("theme");
      await page.click("#about summary");
      assert.equal(await page.locator("#about dd").first().textContent(), "motorway");
    });
  });
}

test("rays, names and signals are drawn", async () => {
  await withPage("one", { hash: "#t=18.5" }, async (page) => {
    await ready(page);
    await keep(page, "before");
    for (const key of ["l", "n"]) {
      await page.keyboard.press(key);
      await keep(page, "without");
      assert.ok((await differing(page, "before", "without")) > 0.001, key);
      await page.keyboard.press(key);
    }
    await keep(page, "after");
    assert.ok((await differing(page, "before", "after")) < 1e-4, "what was switched back on looks different");
    // The signal 5.2 km down the road turns green at 33 s, with nobody near.
    await page.evaluate(() => {
      const { replay } = window;
      const [x1, y1] = replay.ground.stopLines[1].ends;
      replay.options.follows = false;
      for (const { camera } of replay.stages) Object.assign(camera, { x: x1, y: y1, scale: 8 });
      replay.seek(20);
    });
    await keep(page, "red");
    await page.evaluate(() => window.replay.seek(40));
    await keep(page, "green");
    for (const [name, other, shade] of [["red", "green", [211, 32, 58]], ["green", "red", [0, 158, 115]]]) {
      assert.ok((await inShade(page, name, shade)) > 50, name);
      assert.equal(await inShade(page, other, shade), 0, other);
    }
  });
});

test("a mark that is clicked is gone to, and a kind that is left out is skipped", async () => {
  await withPage("one", {}, async (page) => {
    await ready(page);
    const [film] = truth.one.films;
    const moments = film.marks.map(([frame]) => frame / 10);
    const alone = film.marks.findIndex((_, k) => moments[k] > 3 && moments.every((at, other) => other === k || Math.abs(at - moments[k]) > 3));
    const box = await page.locator(".mark").nth(alone).boundingBox();
    await page.mouse.click(box.x + box.width / 2 + 2, box.y + box.height / 2);
    assert.ok(near((await state(page)).elapsed, moments[alone], 1e-9));
    const kind = film.marks[alone][1];
    await page.click(`#filters [data-kind="${kind}"]`);
    assert.deepEqual((await state(page)).hiddenKinds, [kind]);
    assert.equal(await page.locator(".mark").nth(alone).isVisible(), false);
    await page.evaluate((at) => window.replay.seek(at - 0.1), moments[alone]);
    await page.keyboard.press("k");
    assert.ok((await state(page)).elapsed > moments[alone]);
    await page.click(`#filters [data-kind="${kind}"]`);
    await page.evaluate((at) => window.replay.seek(at - 0.1), moments[alone]);
    await page.keyboard.press("k");
    assert.equal((await state(page)).elapsed, moments[alone]);
    assert.match(await page.textContent("#status"), new RegExp(kind === "lane end" ? "end of lane" : kind));
  });
});

test("timeline, strip and curves are on one clock, and are gone to by a click", async () => {
  await withPage("one", {}, async (page) => {
    await ready(page);
    const track = await page.locator("#track").boundingBox();
    const middle = track.x + track.width / 2;
    for (const place of [".rail", ".strip", ".curve:nth-of-type(1) .u-over", ".curve:last-child .u-over"]) {
      await page.evaluate(() => window.replay.seek(3));
      const box = await page.locator(place).first().boundingBox();
      await page.mouse.click(middle, box.y + box.height / 2);
      assert.ok(near((await state(page)).elapsed, 150, 0.5), `${place}: ${(await state(page)).elapsed}`);
      await drawn(page);
      const line = await page.locator("#playhead").boundingBox();
      assert.ok(near(line.x, middle, 2), `${place}: the line is at ${line.x}, not ${middle}`);
    }
    await page.mouse.move(middle, track.y + track.height - 5);
    await page.mouse.down();
    await page.mouse.move(track.x + 0.25 * track.width, track.y + track.height - 5, { steps: 4 });
    await page.mouse.up();
    assert.ok(near((await state(page)).elapsed, 75, 0.5));
    assert.equal(await page.getAttribute("#track", "aria-valuetext"), `${(await state(page)).elapsed.toFixed(1)} s`);
  });
});

test("the card tells what was decided, and why not", async () => {
  await withPage("one", {}, async (page) => {
    await ready(page);
    const [film] = truth.one.films;
    const sentences = { gap: "the gap is too short", "no lane": "there is no lane on that side" };
    for (const [why, sentence] of Object.entries(sentences)) {
      const [frame, asked, , , open, shares, judged] = film.decisions.find((decision) => decision[3] === why);
      await page.evaluate((at) => window.replay.seek(at), frame / 10 + 0.35);
      await drawn(page);
      assert.equal(await page.textContent(".card h2"), `Decision at ${(frame / 10).toFixed(1)} s`);
      assert.equal(await page.textContent(".outcome"), `${asked}: refused, ${sentence}`);
      assert.equal(await page.locator(".choices .closed").count(), open.filter((isOpen) => !isOpen).length);
      assert.match(await page.textContent(".choices .asked"), new RegExp(`${(100 * shares[asked === "left" ? 3 : 4]).toFixed(0)} %`));
      assert.equal(await page.textContent(".choices .judged .share"), judged.toFixed(2));
    }
    const { frame, gap, set, limit } = film.frames[2];
    await page.evaluate((at) => window.replay.seek(at), frame / 10);
    await drawn(page);
    const card = await page.textContent(".figures");
    assert.ok(card.includes(`set speed${(set * 3.6).toFixed(0)} km/h`) && card.includes(`limit${(limit * 3.6).toFixed(0)} km/h`), card);
    assert.ok(card.includes(gap === null ? "nobody in sight" : `gap ahead${gap.toFixed(1)} m`), card);
  });
});

test("a link's moment is opened, standing, and the address keeps up", async () => {
  await withPage("one", { hash: "#t=123.4" }, async (page) => {
    await ready(page);
    const found = await state(page);
    assert.ok(near(found.elapsed, 123.4, 1e-9) && !found.playing);
    await page.keyboard.press("ArrowRight");
    await page.waitForFunction(() => location.hash === "#t=124.4"); // within a second: it is not written at every move
    await page.evaluate(() => (location.hash = "#t=10"));
    await page.waitForFunction(() => window.replay.state().elapsed === 10);
    assert.equal(await page.evaluate(() => history.length), 3); // a blank tab, the page, and what was typed
  });
});

/** Let the address be changed `most` times in 10 s, as browsers do, and count how often it is. */
const rationed = (most) => {
  const [replace, times] = [history.replaceState.bind(history), []];
  window.linked = times;
  history.replaceState = (...given) => {
    times.push(performance.now());
    if (times.filter((time) => time > performance.now() - 10_000).length > most) throw new DOMException("too often", "SecurityError");
    replace(...given);
  };
};

/** Drag along the timeline to and fro, to a share of it in the end; returns how often the picture followed. */
async function scrub(page, share) {
  const track = await page.locator("#track").boundingBox();
  const [top, left] = [track.y + track.height - 5, (at) => track.x + at * track.width];
  await page.mouse.move(left(0.1), top);
  await page.mouse.down();
  const seen = new Set();
  for (const to of [0.9, 0.2, 0.8, 0.3]) {
    await page.mouse.move(left(to), top, { steps: 60 });
    await drawn(page);
    seen.add(await page.textContent("#clock"));
  }
  await page.mouse.move(left(share), top, { steps: 60 });
  await page.mouse.up();
  await drawn(page);
  return seen.size;
}

for (const [most, what] of [[100, "as Safari does"], [5, "sooner than any browser does"], [0, "as it does in a frame of another page"]]) {
  test(`scrubbing and playing go on where the address may be changed ${most} times, ${what}`, async () => {
    await withPage("one", { init: `(${rationed})(${most})` }, async (page) => {
      await ready(page);
      assert.equal(await scrub(page, 0.5), 4);
      const { elapsed } = await state(page);
      assert.ok(near(elapsed, 150, 1), `${elapsed}`);
      assert.equal(await page.textContent("#clock"), `${elapsed.toFixed(1)} s of 300.0 s`);
      const [linked, tookMs] = await page.evaluate(() => [window.linked.length, performance.now()]);
      assert.ok(linked >= 1 && linked <= 2 + tookMs / 1000, `the address was changed ${linked} times in ${tookMs} ms`);
      if (most > 5) await page.waitForFunction((hash) => location.hash === hash, `#t=${elapsed.toFixed(1)}`);
      await page.keyboard.press("Space");
      await page.waitForFunction((since) => window.replay.state().elapsed > since + 1.5, elapsed);
      assert.equal((await state(page)).playing, true);
    });
  });
}

test("within a sandboxed frame of another page it plays", async () => {
  const file = join(mkdtempSync(join(tmpdir(), "replay-")), "frame.html");
  const text = readFileSync(join(PAGES, "unequal.html"), "utf8").replaceAll("&", "&amp;").replaceAll('"', "&quot;");
  writeFileSync(file, `<!doctype html><title>frame</title><iframe sandbox="allow-scripts" width="1200" height="700" srcdoc="${text}"></iframe>`);
  await withPage("frame", { file, hash: "" }, async (page) => {
    await page.waitForFunction(() => frames.length === 1);
    const frame = page.frames()[1];
    await frame.locator(".begin").first().click();
    await frame.waitForFunction(() => window.replay.state().elapsed > 2);
    assert.equal((await state(frame)).playing, true);
  });
});

test("films of the simulation's time are linked by it", async () => {
  await withPage("town", { hash: "#t=25260" }, async (page) => {
    await ready(page);
    assert.equal((await state(page)).elapsed, 60);
    assert.match(await page.textContent("#clock"), /^07:01:00\.0/);
  });
});

test("an episode's clock, marks and decisions count from its start, and the simulation's time is told too", async () => {
  for (const name of ["one", "two"]) {
    await withPage(name, { hash: "#t=60.5" }, async (page) => {
      await ready(page);
      assert.equal((await state(page)).elapsed, 60.5);
      assert.match(await page.textContent("#clock"), /^60\.5 s of 300\.0 s$/);
      const [film] = truth[name].films;
      const [frame, kind] = film.marks.at(-1);
      assert.ok(kind && (await page.locator(".mark title").nth(film.marks.length - 1).textContent()).startsWith(`${(frame / 10).toFixed(1)} s `));
      for (const card of await page.locator(".card").allInnerTexts()) assert.match(card, /^Decision at 60\.0 s/);
      assert.equal(await page.innerText("#simulation"), "simulation 240.5 s");
      await page.keyboard.press("ArrowRight");
      await drawn(page);
      assert.equal(await page.innerText("#simulation"), "simulation 241.5 s");
    });
  }
  await withPage("town", { hash: "" }, async (page) => {
    await ready(page);
    assert.equal(await page.locator("#simulation").isVisible(), false); // the clock shows it
    await page.keyboard.press("?");
    assert.doesNotMatch(await page.innerText("#keys p"), /episode/);
  });
});

test("drag and wheel move the view; dragging lets go of the host", async () => {
  await withPage("one", { hash: "#t=60" }, async (page) => {
    await ready(page);
    const box = await page.locator(".stage canvas").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    await page.mouse.move(x, y);
    const farther = (await state(page)).views[0];
    await page.mouse.wheel(0, -300);
    await page.waitForFunction((scale) => window.replay.state().views[0].scale > scale, farther.scale);
    assert.equal((await state(page)).follows, true);
    const closer = (await state(page)).views[0];
    await page.mouse.down();
    await page.mouse.move(x + 100, y + 40, { steps: 5 });
    await page.mouse.up();
    const moved = await state(page);
    assert.equal(moved.follows, false);
    assert.ok(near(moved.views[0].x, closer.x - 100 / closer.scale, 20 / closer.scale));
    assert.ok(near(moved.views[0].y, closer.y + 40 / closer.scale, 20 / closer.scale));
  });
});

test("two fingers zoom", async () => {
  await withPage("one", { viewport: NARROW, hasTouch: true, hash: "#t=60" }, async (page, context) => {
    await ready(page);
    const session = await context.newCDPSession(page);
    const box = await page.locator(".stage canvas").boundingBox();
    const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
    const fingers = (apart) => [{ x: x - apart, y, id: 0 }, { x: x + apart, y, id: 1 }];
    const { scale } = (await state(page)).views[0];
    await session.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: fingers(30) });
    for (const apart of [40, 50, 60]) await session.send("Input.dispatchTouchEvent", { type: "touchMove", touchPoints: fingers(apart) });
    await session.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
    const pinched = (await state(page)).views[0].scale;
    assert.ok(near(pinched / scale, 2, 0.1), `${pinched / scale}`);
  });
});

test("of a run without a host, help and buttons leave out what does nothing", async () => {
  const [withoutHost, withHost] = [[], []];
  for (const [name, shown] of [["town", withoutHost], ["one", withHost]]) {
    await withPage(name, {}, async (page) => {
      await ready(page);
      await page.keyboard.press("?");
      shown.push(...(await page.locator("#keys dd").allTextContents()));
      const words = await page.locator("#keys p").innerText();
      assert.equal(words.includes("A click on a curve or a mark goes there"), name === "one");
      for (const id of ["previous-mark", "next-mark", "previous-decision", "next-decision", "rays"]) {
        assert.equal(await page.locator(`#${id}`).isVisible(), name === "one", id);
      }
    });
  }
  const leftOut = withHost.filter((meaning) => !withoutHost.includes(meaning));
  assert.deepEqual(leftOut, ["previous, next decision", "previous, next mark", "rays: what the host senses"]);
  assert.ok(withoutHost.includes("play or pause"));
});

test("a crowd opens as a whole; who is clicked is followed", async () => {
  await withPage("town", { hash: "#t=25500" }, async (page) => {
    await ready(page);
    const opened = await state(page);
    assert.equal(opened.follows, false);
    assert.ok(opened.views[0].drawn > 2000);
    await page.evaluate(() => {
      const { stages } = window.replay;
      const [{ x, y }] = stages[0].seen;
      Object.assign(stages[0].camera, { x, y, scale: 8 });
      stages[0].isMoved = true;
      window.replay.invalidate();
    });
    await drawn(page);
    assert.ok((await state(page)).views[0].drawn < 200, "it draws who is far away");
    const box = await page.locator(".stage canvas").boundingBox();
    await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
    const followed = await state(page);
    assert.ok(followed.follows && followed.views[0].target !== null);
    await drawn(page);
    assert.match(await page.textContent(".who"), /^Following flow\d\.\d+: (passenger|bus), /);
    const { x, y } = (await state(page)).views[0];
    await page.keyboard.press("ArrowRight");
    await drawn(page);
    const later = (await state(page)).views[0];
    const moved = Math.hypot(later.x - x, later.y - y);
    assert.ok(moved > 1 && moved < 25, `${moved} m in a second`);
  });
});

test("two films run on one clock, and their difference is told", async () => {
  await withPage("two", { hash: "#t=200" }, async (page) => {
    await ready(page);
    await drawn(page);
    assert.equal(await page.locator(".stage canvas").count(), 2);
    const passed = truth.two.films.map(({ marks }) => marks.filter(([frame, kind]) => kind === "overtake" && frame <= 2000).length);
    assert.ok((await page.textContent("#difference")).includes(`overtakes so far ${passed[1]} to ${passed[0]} `));
    const [first, second] = (await state(page)).views;
    assert.equal(first.scale, second.scale);
    assert.notEqual(first.x, second.x);
  });
});

test("of two films the shorter one's end is told, and nothing of it goes on", async () => {
  await withPage("unequal", {}, async (page) => {
    await ready(page);
    const at = async (elapsed) => {
      await page.evaluate((to) => window.replay.seek(to), elapsed);
      await drawn(page);
      const { views } = await state(page);
      return {
        cards: await page.locator(".card").allInnerTexts(),
        difference: await page.textContent("#difference"),
        ended: views.map(({ ended }) => ended),
      };
    };
    const last = await at(9.5);
    assert.match(last.cards[0], /^Decision at 9\.0 s[^]*speed\s+\d+ km\/h[^]*The episode ended at 9\.5 s: end of the course\.$/);
    assert.match(last.difference, /speed [+−±]\d+ km\/h/);
    assert.deepEqual(last.ended, [false, false]);
    await keep(page, "last frame");
    const past = await at(9.6);
    assert.equal(past.cards[0].replace(/\s*\n\s*/g, "|").trim(), "road-rail|The episode ended at 9.5 s: end of the course");
    assert.match(past.cards[1], /^Decision at 9\.0 s[^]*speed\s+\d+ km\/h/);
    assert.doesNotMatch(past.cards[1], /ended/);
    assert.match(past.difference, /speed –driven [+−±]\d+ movertakes so far \d+ to \d+ /);
    assert.deepEqual(past.ended, [true, false]);
    await keep(page, "past it");
    assert.ok((await differing(page, "last frame", "past it")) > 0.2, "its picture looks as if it drove on");
    const driven = await page.evaluate(() => window.replay.difference.distances[0].at(-1));
    assert.ok(driven > 200);
    await page.keyboard.press("End");
    const end = await at(20);
    assert.match(end.cards[1], /speed\s+\d+ km\/h[^]*The episode ended at 20\.0 s: collision\.$/);
    assert.match(end.difference, /speed –/);
    const back = await at(5);
    assert.match(back.cards[0], /^Decision at 5\.0 s/);
    assert.deepEqual(back.ended, [false, false]);
  });
});

test("of two films all curves are on the page at 1280 x 800", async () => {
  await withPage("two", {}, async (page) => {
    await ready(page);
    await drawn(page);
    const below = await page.evaluate(() => [...document.querySelectorAll(".curve")].at(-1).getBoundingClientRect().bottom - innerHeight);
    assert.match(await page.locator(".curve p").last().textContent(), /^judge’s score/);
    assert.ok(below <= 0, `the last curve ends ${below} px below the window`);
    assert.ok((await page.locator(".view").first().boundingBox()).height >= 160);
  });
});

/** Note what is written on canvases, and where: {text, left, right, top, bottom} by canvas. */
const noteTexts = () => {
  const write = CanvasRenderingContext2D.prototype.fillText;
  window.written = new Map();
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const { actualBoundingBoxLeft, actualBoundingBoxRight, actualBoundingBoxAscent, actualBoundingBoxDescent } = this.measureText(text);
    const box = { text, left: x - actualBoundingBoxLeft, right: x + actualBoundingBoxRight, top: y - actualBoundingBoxAscent, bottom: y + actualBoundingBoxDescent };
    window.written.set(this.canvas, [...(window.written.get(this.canvas) ?? []), box]);
    write.call(this, text, x, y);
  };
};

for (const viewport of [WIDE, NARROW]) {
  test(`decisions' labels are whole and apart, and of two films each row says whose it is, ${viewport.width} px`, async () => {
    for (const name of ["one", "two"]) {
      await withPage(name, { viewport, init: noteTexts }, async (page) => {
        await ready(page);
        const strips = await page.evaluate(() => {
          window.written.clear();
          window.replay.curves.resize();
          return [...document.querySelectorAll(".strip")].map((strip) => window.written.get(strip));
        });
        const drivers = strips.map((labels) => labels.map(({ text }) => text).filter((text) => /^[AB]$/.test(text)));
        assert.deepEqual(drivers, name === "two" ? [["A"], ["B"]] : [[]]);
        for (const labels of strips) {
          for (const [k, one] of labels.entries()) {
            assert.ok(one.left >= 0 && one.top >= 0, `${one.text} is cut off`);
            for (const other of labels.slice(0, k)) {
              const isApart = one.top >= other.bottom || one.bottom <= other.top || one.left >= other.right || one.right <= other.left;
              assert.ok(isApart, `${one.text} lies on ${other.text}`);
            }
          }
        }
      });
    }
  });
}

test("of two films a curve that only one of them has says whose it is", async () => {
  await withPage("two", {}, async (page) => {
    await ready(page);
    await page.evaluate(() => {
      for (const decision of window.replay.films[0].driven.decisions) decision.judged = null;
      window.replay.curves.build();
    });
    assert.deepEqual(await page.locator(".curve p").last().locator("span").allTextContents(), ["B score"]);
  });
});

test("of a host that SUMO drives nothing is told that only our driver has", async () => {
  await withPage("sumo", { hash: "#t=10" }, async (page) => {
    await ready(page);
    await drawn(page);
    assert.equal(await page.textContent(".card h2"), "No decisions: SUMO’s own driver drives");
    assert.equal(await page.locator(".figures .wide").first().textContent(), "The host is driven by SUMO, which chooses its speed and lane.");
    assert.match(await page.textContent(".figures"), /set speednone/);
    assert.deepEqual(await page.locator(".curve p").first().locator("span").allTextContents(), ["speed", "limit"]);
  });
});

test("whom the rays end on does not depend on what the view shows", async () => {
  await withPage("one", {}, async (page) => {
    await ready(page);
    const counts = await page.evaluate(() => {
      const { replay } = window;
      const [stage] = replay.stages;
      const { scale } = stage.camera;
      const sensed = (elapsed, look) => {
        Object.assign(replay.options, { follows: look.follows });
        Object.assign(stage.camera, look);
        stage.draw(elapsed);
        return stage.sensed.size;
      };
      return Array.from({ length: 60 }, (_, k) => 5 * k).map((elapsed) => [
        sensed(elapsed, { follows: true, scale }),
        sensed(elapsed, { follows: true, scale: 40 }),
        sensed(elapsed, { follows: false, scale, x: stage.camera.x + 200 }),
      ]);
    });
    assert.ok(counts.filter(([count]) => count > 0).length > 10, "nobody is sensed");
    for (const [usual, close, away] of counts) assert.deepEqual([close, away], [usual, usual]);
  });
});

test("a picture and a film of the view are saved", async () => {
  await withPage("two", { hash: "#t=30", complains: true }, async (page) => {
    await ready(page);
    const [picture] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("s")]);
    assert.equal(picture.suggestedFilename(), "road-rail-beside-road-expert-30.0s.png");
    const png = readFileSync(await picture.path());
    assert.deepEqual([...png.subarray(0, 4)], [0x89, 0x50, 0x4e, 0x47]);
    assert.ok(png.readUInt32BE(16) >= 1278); // both films wide
    await page.keyboard.press("r");
    assert.equal((await state(page)).recording, true);
    await page.waitForTimeout(1500);
    const [recorded] = await Promise.all([page.waitForEvent("download"), page.keyboard.press("r")]);
    const webm = readFileSync(await recorded.path());
    assert.deepEqual([...webm.subarray(0, 4)], [0x1a, 0x45, 0xdf, 0xa3]);
    assert.ok(webm.length > 20_000);
  });
});

test("over the road there is a button to play, until the film is played or another moment gone to", async () => {
  const begun = {
    Space: true, // whether it plays then
    ArrowRight: false,
    End: false,
  };
  for (const [key, plays] of Object.entries(begun)) {
    await withPage("two", { hash: "" }, async (page) => {
      await ready(page);
      const shown = () => page.locator(".begin:visible").count();
      assert.equal(await shown(), 2); // one over each road
      for (const other of ["+", "n", "d"]) await page.keyboard.press(other);
      assert.equal(await shown(), 2);
      await page.keyboard.press(key);
      assert.equal((await state(page)).playing, plays, key);
      assert.equal(await shown(), 0, key);
      if (plays) await page.keyboard.press(key);
      assert.equal(await shown(), 0, "it is paused, not at its beginning");
    });
  }
  await withPage("one", { hash: "#t=20" }, async (page) => {
    await ready(page);
    const button = page.getByRole("button", { name: "Play", exact: true });
    const [over, road] = await Promise.all([button.boundingBox(), page.locator(".stage canvas").boundingBox()]);
    assert.ok(over.y > road.y + road.height / 2 && over.y + over.height < road.y + road.height, "it hides the host");
    await page.keyboard.press("Tab");
    await button.focus();
    await page.keyboard.press("Space"); // of a button that has the focus, once
    assert.equal((await state(page)).playing, true);
    await page.waitForFunction(() => window.replay.state().elapsed > 20.2);
  });
});

test("dark is dark from the first frame on", async () => {
  await withPage("one", { colorScheme: "dark" }, async (page) => {
    await ready(page);
    await keep(page, "dark");
    const corner = await page.evaluate(() => window.kept.dark[0]);
    for (const shift of [0, 8, 16]) assert.ok(((corner >> shift) & 0xff) < 80);
  });
});

test("light and dark are as the system is, until the reader chooses", async () => {
  const colours = {};
  for (const colorScheme of ["light", "dark"]) {
    await withPage("one", { colorScheme }, async (page) => {
      await ready(page);
      const shown = () =>
        page.evaluate(() => {
          const { backgroundColor, color, colorScheme: scheme } = getComputedStyle(document.body);
          return [backgroundColor, color, scheme];
        });
      colours[colorScheme] = await shown();
      await page.keyboard.press("d");
      colours[`not ${colorScheme}`] = await shown();
    });
  }
  assert.deepEqual(colours.light, ["rgb(251, 251, 249)", "rgb(29, 37, 41)", "light"]);
  assert.deepEqual(colours.dark, ["rgb(20, 24, 27)", "rgb(232, 236, 238)", "dark"]);
  assert.deepEqual([colours["not light"], colours["not dark"]], [colours.dark, colours.light]);
});

test("names from users' files are text and nothing else", async () => {
  await withPage("hostile", {}, async (page) => {
    await ready(page);
    await page.keyboard.press("n");
    await page.click("#about summary");
    assert.equal(await page.locator("img").count(), 0);
    assert.ok((await page.textContent("#title")).startsWith("</script><img"));
    assert.ok((await page.textContent("figcaption")).startsWith("</script><img"));
    assert.ok((await page.evaluate(() => window.replay.films[0].vehicles[0].id)).startsWith("</script><img"));
  });
});

test("every control has a name, and a focus that can be seen", async () => {
  await withPage("one", {}, async (page) => {
    await ready(page);
    const nameless = await page.evaluate(() =>
      [...document.querySelectorAll("button, select, summary, [role=slider], canvas")]
        .filter((element) => !(element.getAttribute("aria-label") || element.textContent.trim()) && element.getClientRects().length)
        .map((element) => element.outerHTML.slice(0, 100)),
    );
    assert.deepEqual(nameless.filter((html) => !html.includes("<canvas width")), []);
    await page.keyboard.press("Tab");
    assert.notEqual(await page.evaluate(() => getComputedStyle(document.activeElement).outlineStyle), "none");
  });
});

const damaged = {
  "cut off": (text) => text.replace(/(id="film-0">[^<]{2000})[^<]*/, "$1"),
  "of another kind": (text) => text.replace(/(id="film-0">)[^<]*/, "$1AAAA"),
  "no base64": (text) => text.replace(/(id="ground">)[^<]*/, "$1!!"),
};
for (const [how, damage] of Object.entries(damaged)) {
  test(`data that are ${how}: one plain sentence`, async () => {
    const file = join(mkdtempSync(join(tmpdir(), "replay-")), "damaged.html");
    writeFileSync(file, damage(readFileSync(join(PAGES, "one.html"), "utf8")));
    await withPage("one", { file, complains: true }, async (page) => {
      await page.waitForFunction(() => document.getElementById("message").textContent.startsWith("The film cannot be shown: "));
      assert.match(await page.textContent("#message"), /^The film cannot be shown: its data are (damaged|cut off)\.$/);
      assert.equal(await page.locator("#app").isVisible(), false);
      assert.equal(await page.locator("#message").isVisible(), true);
    });
  });
}

test("a browser without DecompressionStream, or without JavaScript: one plain sentence", async () => {
  await withPage("one", { init: () => delete window.DecompressionStream, complains: true }, async (page) => {
    await page.waitForFunction(() => document.getElementById("message").textContent.includes("2023 or later"));
    assert.match(await page.textContent("#message"), /^The film cannot be shown: this browser cannot unpack it/);
  });
  await withPage("one", { javaScriptEnabled: false }, async (page) => {
    assert.match(await page.locator("body").innerText(), /^This page draws a drive with JavaScript, which is switched off here\./);
  });
});

for (const [viewport, columns] of [[WIDE, 3], [NARROW, 2]]) {
  test(`a sweep's figures are small, ${columns} in a row, and a click or Enter makes one large and small again, ${viewport.width} px`, async () => {
    await withPage("sweep", { hash: "", viewport }, async (page) => {
      const images = page.locator(".figures img");
      const boxes = await Promise.all([0, 1, 2, 3].map((k) => images.nth(k).boundingBox()));
      assert.equal(boxes.filter(({ y }) => y === boxes[0].y).length, columns);
      await images.nth(1).click();
      const large = await images.nth(1).boundingBox();
      assert.ok(large.width > 1.9 * boxes[1].width, `${large.width} px`);
      await page.keyboard.press("Enter"); // it has the focus
      assert.deepEqual(await images.nth(1).boundingBox(), boxes[1]);
      const sideways = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      assert.ok(sideways <= 0, "the page is wider than the window");
    });
  });
}

for (const [size, viewport] of Object.entries({ wide: WIDE, narrow: NARROW })) {
  test(`a sweep's differences have whole names, all columns on a wide page, and their scroll bar in sight, ${size}`, async () => {
    await withPage("sweep", { hash: "", viewport }, async (page) => {
      await page.locator("summary", { hasText: "All differences" }).click();
      const box = page.locator("details .wide").first();
      const [hidden, bottom] = await box.evaluate((one) => [one.scrollWidth - one.clientWidth, one.getBoundingClientRect().height]);
      assert.equal(hidden > 0, size === "narrow", `${hidden} px are to be scrolled to`);
      assert.ok(bottom < viewport.height, `${bottom} px high`);
      const names = box.locator("td.words", { hasText: "drac_above_3_4_per_vehkm" });
      const [name, short] = [names.first(), box.locator("td.words", { hasText: "waiting" }).first()];
      const lines = (cell) => cell.evaluate((one) => { const range = document.createRange(); range.selectNodeContents(one); return range.getClientRects().length; });
      assert.deepEqual([await lines(name), await lines(short)], [1, 1]);
    });
  });
}

for (const [size, viewport] of Object.entries({ wide: WIDE, narrow: NARROW })) {
  test(`a report's tables are sorted by a click on a heading, by the full value, and turned round by a second, ${size}`, async () => {
    await withPage("report", { hash: "", viewport }, async (page) => {
      const table = page.locator("details table").first();
      await page.locator("summary").first().click();
      const heading = table.locator("th", { hasText: "speed_kmh" });
      const column = await heading.evaluate((cell) => cell.cellIndex);
      const speeds = () =>
        table.evaluate((element, k) => [...element.tBodies[0].rows].map((row) => Number(row.cells[k].dataset.value)), column);
      const unsorted = await speeds();
      assert.ok(unsorted.length > 100 && new Set(unsorted).size > 100);
      const ordered = unsorted.toSorted((one, other) => one - other);
      assert.notDeepEqual(unsorted, ordered);
      await heading.locator("button").click();
      assert.deepEqual(await speeds(), ordered);
      assert.equal(await heading.getAttribute("aria-sort"), "ascending");
      await page.keyboard.press("Enter"); // the heading has the focus
      assert.deepEqual(await speeds(), ordered.toReversed());
      const policies = table.locator("th", { hasText: "policy" });
      await policies.locator("button").click();
      assert.equal(await heading.getAttribute("aria-sort"), null);
      const names = await table.evaluate((element) => [...element.tBodies[0].rows].map((row) => row.cells[0].textContent));
      assert.deepEqual(names, names.toSorted((one, other) => one.localeCompare(other)));
      const sideways = await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
      assert.ok(sideways <= 0, "tables scroll within themselves, not the page");
    });
  });
}
