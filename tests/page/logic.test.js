// What the page computes, without a browser: node --test

import assert from "node:assert/strict";
import { deflateSync } from "node:zlib";
import { test } from "node:test";

import { bucketsOf, bytesOf, forEachPresent, inflate, opened, spanAt, summed, summedTwice, varints } from "../../rail_sumo/pictures/replay/decode.js";
import { beside } from "../../rail_sumo/pictures/replay/road.js";
import { Camera } from "../../rail_sumo/pictures/replay/camera.js";
import { clock, ending, holdingSentence, outcome, signed, tick } from "../../rail_sumo/pictures/replay/words.js";
import { clockBase, countUntil, decisionAt, frameAt, hasEnded, letterAt, linkedMoment, momentsOf, neighbour, overtakesOf } from "../../rail_sumo/pictures/replay/timeline.js";
import { commandOf, keysOf } from "../../rail_sumo/pictures/replay/controls.js";
import { drivenDistance, poseInSpan, poseOf, turned } from "../../rail_sumo/pictures/replay/motion.js";
import { rangeOf, ticksOf } from "../../rail_sumo/pictures/replay/curves.js";
import { shadeOf, signalMeaning } from "../../rail_sumo/pictures/replay/colours.js";

const QUANTA = { position_m: 0.01, heading_rad: (2 * Math.PI) / 36000, speed_mps: 0.01 };

/** A film of spans such as {vehicle, first, x, y, heading, speed}, in whole quanta. */
function film(spans, { stepS = 1, nFrames = 10 } = {}) {
  const column = (name) => Int32Array.from(spans.flatMap((span) => span[name] ?? span.x.map(() => 0)));
  const lengths = Int32Array.from(spans, (span) => span.x.length);
  const made = {
    vehicle: Int32Array.from(spans, (span) => span.vehicle),
    first: Int32Array.from(spans, (span) => span.first),
    length: lengths,
    row: Int32Array.from(spans, (_, k) => lengths.subarray(0, k).reduce((sum, length) => sum + length, 0)),
  };
  return { stepS, nFrames, quanta: QUANTA, spans: made, buckets: bucketsOf(made, nFrames), x: column("x"), y: column("y"), heading: column("heading"), speed: column("speed") };
}

test("varints: the sign is in the lowest bit, seven bits a byte", () => {
  assert.deepEqual([...varints(Uint8Array.of(0, 1, 2, 3, 0x80, 0x01, 0xff, 0xff, 0xff, 0xff, 0x0f), 6)], [0, -1, 1, -2, 64, -2147483648]);
});

test("varints that are cut off or too many are damaged data", () => {
  assert.throws(() => varints(Uint8Array.of(0x80), 1));
  assert.throws(() => varints(Uint8Array.of(0, 0), 1), /damaged/);
});

test("differences are summed anew from each start", () => {
  assert.deepEqual([...summed(Int32Array.of(5, 1, 1, 7, -2), [0, 3])], [5, 6, 7, 7, 5]);
  assert.deepEqual([...summedTwice(Int32Array.of(5, 2, 1, 0, 7, -2, 1), [0, 4])], [5, 7, 10, 13, 7, 5, 4]);
});

test("a container is opened, and one that is cut off is refused", async () => {
  const head = new TextEncoder().encode(JSON.stringify({ name: "é", streams: { a: [2, 2], b: [1, 2] } }));
  const raw = Uint8Array.of(head.length, 0, 0, 0, ...head, 2, 4, 0x80, 0x01);
  const back = await inflate(bytesOf(Buffer.from(deflateSync(raw)).toString("base64")));
  const { header, stream } = opened(back);
  assert.equal(header.name, "é");
  assert.deepEqual([[...stream("a")], [...stream("b")]], [[1, 2], [64]]);
  assert.throws(() => opened(raw.subarray(0, raw.length - 1)), /cut off/);
  await assert.rejects(inflate(Uint8Array.of(1, 2, 3, 4)));
});

test("who is present: spans with a gap between them, over the border of a bucket", () => {
  const some = film([{ vehicle: 0, first: 60, x: Array(10).fill(0) }, { vehicle: 0, first: 80, x: [1] }, { vehicle: 1, first: 0, x: Array(200).fill(2) }], { nFrames: 200 });
  const present = (frame) => {
    const found = [];
    forEachPresent(some, frame, (span) => found.push(span));
    return found;
  };
  assert.deepEqual([59, 60, 64, 69, 70, 80, 81].map(present), [[2], [0, 2], [0, 2], [0, 2], [2], [1, 2], [2]]);
  const short = film([{ vehicle: 3, first: 63, x: [0, 0] }], { nFrames: 200 });
  assert.deepEqual([62, 63, 64, 65].map((frame) => spanAt(short, 3, frame)), [-1, 0, 0, -1]);
  assert.equal(spanAt(some, 0, 75), -1);
  assert.equal(spanAt(some, 0, 80), 1);
});

test("on a frame a vehicle is where the film says; at a steady speed, half a frame later it is half way", () => {
  const some = film([{ vehicle: 0, first: 0, x: [0, 1000, 2000], speed: [1000, 1000, 1000] }]);
  assert.deepEqual(poseOf(some, 0, 1), { x: 10, y: 0, heading: 0, speed: 10 });
  assert.ok(Math.abs(poseOf(some, 0, 1.5).x - 15) < 1e-9);
  assert.equal(poseOf(some, 0, 2.4).x, 20); // nobody knows where it went
  assert.equal(poseOf(some, 0, 3), null);
  assert.equal(poseOf(some, 1, 1), null);
});

test("between two frames a quarter circle is followed, not cut", () => {
  const radius = 10;
  const speed = (radius * Math.PI) / 2; // a quarter in 1 s
  const some = film([{ vehicle: 0, first: 0, x: [0, 100 * radius], y: [0, 100 * radius], heading: [0, 9000], speed: [100 * speed, 100 * speed] }]);
  const { x, y, heading } = poseInSpan(some, 0, 0.5, {});
  assert.ok(Math.abs(Math.hypot(x, y - radius) - radius) < 0.25, `${x} ${y}`);
  assert.ok(Math.abs(heading - Math.PI / 4) < 1e-9);
});

test("who leaps stays until it has leapt, and the leap is not driven", () => {
  const some = film([{ vehicle: 0, first: 0, x: [0, 1000, 500000, 501000], speed: [1000, 1000, 1000, 1000] }], { nFrames: 4 });
  assert.equal(poseOf(some, 0, 1.9).x, 10);
  assert.deepEqual([...drivenDistance(some, 0)], [0, 10, 10, 20]);
});

test("a step sideways without a turn, as SUMO's lane changes are, is gone evenly", () => {
  const some = film([{ vehicle: 0, first: 0, x: [0, 0], y: [0, 350], speed: [100, 100] }]);
  for (const share of [0.25, 0.5]) {
    const { x, y } = poseInSpan(some, 0, share, {});
    assert.ok(Math.abs(x) < 1e-9 && Math.abs(y - 3.5 * share) < 1e-9, `${x} ${y}`);
  }
});

test("angles turn the short way round", () => {
  assert.ok(Math.abs(turned(0.1, 2 * Math.PI - 0.1, 0.5)) < 1e-12);
  assert.ok(Math.abs(turned(6.2, 0.1, 1) - (0.1 + 2 * Math.PI)) < 1e-12);
});

test("a frame's moment is that frame exactly, and none is outside the film", () => {
  const ten = { stepS: 0.1, nFrames: 101 };
  for (let frame = 0; frame <= 100; frame += 1) assert.equal(frameAt(ten, frame * 0.1), frame);
  assert.deepEqual([-1, 99].map((elapsed) => frameAt(ten, elapsed)), [0, 100]);
});

test("a film has ended after its last frame, not on it", () => {
  const short = { stepS: 0.1, nFrames: 4 };
  assert.deepEqual([0, 3 * 0.1, 0.3, 0.31, 9].map((elapsed) => hasEnded(short, elapsed)), [false, false, false, true, true]);
  assert.deepEqual(ending("end of road", "9.5 s"), ["The episode ended at 9.5 s", "end of the road"]);
  assert.deepEqual(ending("", "9.5 s"), ["The film ends at 9.5 s"]);
});

test("the decision in force, and the marks before and after", () => {
  const decisions = [{ frame: 10 }, { frame: 20 }];
  assert.deepEqual([9.9, 10, 19.9, 20, 99].map((frame) => decisionAt(decisions, frame)?.frame ?? null), [null, 10, 10, 20, 20]);
  assert.equal(countUntil([], 5), 0);
  const films = [{ stepS: 0.1, marks: [{ frame: 10, kind: "a" }, { frame: 30, kind: "b" }] }, { stepS: 0.5, marks: [{ frame: 2, kind: "a" }, { frame: 4, kind: "b" }] }];
  const moments = momentsOf(films, ({ marks }) => marks);
  assert.deepEqual(moments, [1, 2, 3]);
  assert.deepEqual(momentsOf(films, ({ marks }) => marks, ({ kind }) => kind === "b"), [2, 3]);
  assert.deepEqual([neighbour(moments, 2, 1), neighbour(moments, 2, -1), neighbour(moments, 3, 1), neighbour(moments, 0, -1)], [3, 1, null, null]);
});

test("overtakes of several at once count as many", () => {
  const marks = [{ frame: 1, kind: "overtake", text: "" }, { frame: 3, kind: "overtake", text: "3" }, { frame: 4, kind: "refused", text: "2" }];
  const overtakes = overtakesOf(marks);
  assert.deepEqual([0, 1, 2, 3, 9].map((frame) => countUntil(overtakes, frame)), [0, 1, 1, 4, 4]);
});

test("clock, ticks and links", () => {
  assert.equal(clock(63.46), "63.5 s");
  assert.equal(clock(25259.96, { long: true }), "07:01:00.0");
  assert.deepEqual([tick(25200, { long: true }), tick(25260.5, { long: true }), tick(0.30000000000000004)], ["07:00:00", "07:01:00.5", "0.3"]);
  assert.deepEqual(["#t=12.5", "#x=1&t=3", "#t=", "", "#tt=3", "#t=-2"].map(linkedMoment), [12.5, 3, null, null, null, -2]);
  assert.equal(clockBase([{ startS: 60 }, { startS: 60 }]), 60);
  assert.equal(clockBase([{ startS: 60 }, { startS: 90 }]), 0);
  assert.equal(clockBase([{ startS: 60, driven: {} }]), 0);
  assert.deepEqual([signed(3.2), signed(-0.2), signed(-4)], ["+3", "±0", "−4"]);
});

test("a decision's outcome in a sentence", () => {
  const told = (asked, carriedOut, why = "", stays = "") => outcome({ asked, carriedOut, why, stays });
  assert.equal(told("left", "keep", "gap"), "left: refused, the gap is too short");
  assert.equal(told("right", "right"), "right: carried out");
  assert.equal(told("keep", "keep"), "keep: nothing changes");
  assert.equal(told("decelerate", "decelerate"), "decelerate: carried out");
  assert.equal(told("decelerate", "decelerate", "", "lowest"), "decelerate: no effect, the set speed stays at its lowest");
});

test("signals: SUMO's letters, the last change that has come", () => {
  const changes = [[0, "r"], [10, "G"]];
  assert.deepEqual([0, 9.9, 10, 50].map((frame) => letterAt(changes, frame)), ["r", "r", "G", "G"]);
  assert.equal(letterAt([[5, "r"]], 1), "");
  assert.deepEqual([..."Ggyurso O"].map(signalMeaning), ["go", "go", "wait", "wait", "stop", "stop", "off", "off", "off"]);
});

test("what lies under the pointer stays there while zooming, and the camera's two ways agree", () => {
  const camera = new Camera();
  Object.assign(camera, { x: 100, y: -50, width: 800, height: 600, scale: 5, ratio: 2 });
  const before = camera.toWorld(200, 100);
  camera.zoom(1.7, 200, 100);
  const after = camera.toWorld(200, 100);
  assert.ok(Math.hypot(after[0] - before[0], after[1] - before[1]) < 0.2); // a device pixel
  const [left, top] = camera.toScreen(...camera.toWorld(10, 20));
  assert.ok(Math.hypot(left - 10, top - 20) < 1e-9);
});

test("a line beside a bent one keeps its distance", () => {
  const bend = beside([0, 10, 10], [0, 0, 10], 1); // east, then north: the left side is inside
  assert.deepEqual([...bend.x].map((x) => +x.toFixed(9)), [0, 9, 9]);
  assert.deepEqual([...bend.y].map((y) => +y.toFixed(9)), [1, 1, 10]);
});

test("axes start at 0, or a little below the lowest value", () => {
  assert.deepEqual(rangeOf({ from: 0, to: 1 }, 0.2, 0.9), [0, 1]);
  assert.equal(rangeOf({ from: null }, 93, 110)[0], 80);
  assert.equal(rangeOf({ from: null }, 3, 9)[0], 0);
  assert.ok(rangeOf({ from: 0 }, null, null)[1] >= 1); // nothing to show
});

test("axes have round numbers, as many as there is room for", () => {
  assert.deepEqual(ticksOf(60, 139, 3), [75, 100, 125]);
  assert.deepEqual(ticksOf(0, 1, 3), [0, 0.5, 1]);
  assert.deepEqual(ticksOf(0, 3000, 2), [0, 2000]);
  assert.deepEqual(ticksOf(0.5, 0.6, 0), [0.5]);
});

test("who is slower than the set speed does not drive at it", () => {
  const goals = { setMps: 25, limitMps: 20 };
  assert.equal(holdingSentence("set speed", 25.1, goals), "drives at the set speed");
  assert.equal(holdingSentence("set speed", 20, goals), "speeds up to the set speed");
  assert.equal(holdingSentence("set speed", 26, goals), "slows down to the set speed");
  assert.equal(holdingSentence("limit", 18, goals), "speeds up to the speed limit");
  assert.equal(holdingSentence("limit", 20, goals), "keeps to the speed limit");
  assert.equal(holdingSentence("vehicle ahead", 0, goals), "stands behind the vehicle ahead");
  assert.equal(holdingSentence("limit ahead", 15, goals), "slows down for a lower speed limit ahead");
  assert.equal(holdingSentence("vehicle ahead", 3, goals), "follows the vehicle ahead");
});

test("speeds' shades stay within the scale", () => {
  assert.deepEqual([-1, 0, 30, 99].map((speed) => shadeOf(speed, 30)), [0, 0, 31, 31]);
});

test("keys are listed where they do something", () => {
  const all = keysOf({ decisions: true, marks: true, rays: true, recorder: true }).map(([keys]) => keys);
  const some = keysOf({ decisions: false, marks: 0, rays: false, recorder: true }).map(([keys]) => keys);
  assert.deepEqual(all.filter((keys) => !some.includes(keys)), [", .", "J K", "L"]);
});

test("keys: with Ctrl they are the browser's", () => {
  assert.deepEqual(commandOf({ key: "ArrowLeft", shiftKey: true }), ["skip", -10]);
  assert.deepEqual(commandOf({ key: "K" }), ["mark", 1]);
  assert.deepEqual(commandOf({ key: "7" }), ["rate", 16]);
  assert.equal(commandOf({ key: "s", ctrlKey: true }), null);
  assert.equal(commandOf({ key: "toString" }), null);
});
