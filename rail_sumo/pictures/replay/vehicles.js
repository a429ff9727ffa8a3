// Draws who is on the road, and what the host senses.

import { SHADES, SIGNALS, shadeOf, signalMeaning } from "./colours.js";
import { forEachPresent } from "./decode.js";
import { poseInSpan } from "./motion.js";
import { letterAt } from "./timeline.js";

const DRIVEN = "driven car"; // what fcd.py calls those of a sweep that are driven
const BODY_PX = 11; // long enough to be drawn with a windscreen
const BOX_PX = 4; // long enough to be drawn as a box
const NAMES_PX = 3; // pixels a metre from which names are drawn
const MOST_NAMES = 120;
const NAME_PX = 12; // how high a name is
const MANY_DOTS = 400; // their outlines would cover the road
const [DARK_GLASS, LIGHT_GLASS] = ["#20282d", "#dfe6ea"];
const DARK_SHADES = 14; // of the shades, on which glass is light
const LONG_M = 6.5; // from here on it has a cab

/** Everybody at a frame with its fraction. */
export function everybodyAt(film, frame) {
  const poses = [];
  forEachPresent(film, Math.floor(frame), (span) => {
    const pose = poseInSpan(film, span, frame, {});
    pose.vehicle = film.spans.vehicle[span];
    pose.size = film.vehicles[pose.vehicle];
    poses.push(pose);
  });
  return poses;
}

/** Who of them is in view. */
export function seenFrom(poses, view) {
  return poses.filter(({ x, y }) => x >= view.left && x <= view.right && y >= view.bottom && y <= view.top);
}

/** How far each ray reaches at a frame with its fraction, in metres. */
export function raysAt(film, frame) {
  const { ray, nRays, rangeM } = film.driven;
  const whole = Math.floor(frame);
  const share = frame - whole;
  return Float64Array.from({ length: nRays }, (_, k) => {
    const at = k * film.nFrames + whole;
    const now = ray[at] * film.quanta.ray_m;
    if (!share || whole + 1 >= film.nFrames) return now;
    const next = ray[at + 1] * film.quanta.ray_m;
    const same = Math.abs(next - now) < 5 && now < rangeM && next < rangeM; // it still ends on the same thing
    return same ? now + share * (next - now) : now;
  });
}

/** Where the host's rays end: on whom, on a border, or on nothing. `poses` are everybody's, in view or not. */
export function hitsOf(film, frame, host, poses) {
  const reaches = (pose) => Math.hypot(pose.x - host.x, pose.y - host.y) <= film.driven.rangeM + pose.size.lengthM;
  const others = poses.filter((pose) => pose.vehicle !== host.vehicle && reaches(pose));
  return Array.from(raysAt(film, frame), (reach, k) => {
    const angle = host.heading + (2 * Math.PI * k) / film.driven.nRays;
    const [x, y] = [host.x + reach * Math.cos(angle), host.y + reach * Math.sin(angle)];
    const isHit = reach < film.driven.rangeM - film.quanta.ray_m;
    return { x, y, isHit, on: isHit ? (others.find((other) => isOn(other, x, y)) ?? null) : null };
  });
}

function isOn(pose, x, y) {
  const [cos, sin] = [Math.cos(pose.heading), Math.sin(pose.heading)];
  const [dx, dy] = [x - pose.x, y - pose.y];
  const spare = 0.5;
  return (
    Math.abs(dx * cos + dy * sin) <= pose.size.lengthM / 2 + spare && Math.abs(dy * cos - dx * sin) <= pose.size.widthM / 2 + spare
  );
}

export function drawSignals(context, camera, film, stopLines, frame) {
  film.signals.forEach((changes, k) => {
    const [x1, y1, x2, y2] = stopLines[k].ends;
    const [left, right] = [camera.toScreen(x1, y1), camera.toScreen(x2, y2)];
    const meaning = signalMeaning(letterAt(changes, frame));
    // Red is thick and whole, green thin, amber dotted: colour alone does not tell them apart to everybody.
    context.lineWidth = Math.max((meaning === "stop" ? 0.9 : 0.5) * camera.scale, meaning === "stop" ? 2.5 : 1.5);
    context.setLineDash(meaning === "wait" ? [0.5 * camera.scale, 0.4 * camera.scale] : []);
    context.strokeStyle = SIGNALS[meaning];
    context.beginPath();
    context.moveTo(...left);
    context.lineTo(...right);
    context.stroke();
  });
  context.setLineDash([]);
}

export function drawRays(context, camera, palette, host, hits) {
  const [fromX, fromY] = camera.toScreen(host.x, host.y);
  for (const hit of hits) {
    const [toX, toY] = camera.toScreen(hit.x, hit.y);
    context.strokeStyle = hit.on ? palette.ray : palette.rail;
    context.globalAlpha = hit.on ? 0.9 : hit.isHit ? 0.5 : 0.18;
    context.lineWidth = hit.on ? 1.4 : 1;
    context.beginPath();
    context.moveTo(fromX, fromY);
    context.lineTo(toX, toY);
    context.stroke();
  }
  context.globalAlpha = 1;
}

export function drawHits(context, camera, palette, hits) {
  for (const hit of hits) {
    if (!hit.isHit) continue;
    const [x, y] = camera.toScreen(hit.x, hit.y);
    context.beginPath();
    context.arc(x, y, hit.on ? 4 : 2.5, 0, 2 * Math.PI);
    context.fillStyle = hit.on ? palette.ray : palette.rail;
    context.fill();
    if (!hit.on) continue;
    context.lineWidth = 1.5;
    context.strokeStyle = palette.halo;
    context.stroke();
  }
}

/**
 * Draw everybody: a body with a windscreen where there is room for it, a dot from afar.
 * `look` has palette, topMps, host and chosen (vehicles' indices or null), and sensed (a set of indices).
 */
export function drawVehicles(context, camera, seen, look) {
  const { scale, ratio } = camera;
  const apart = [];
  const dots = new Map();
  for (const pose of seen) {
    const isApart = pose.vehicle === look.host || pose.vehicle === look.chosen;
    if (isApart) apart.push(pose);
    else if (pose.size.lengthM * scale < BOX_PX) {
      const shade = shadeOf(pose.speed, look.topMps);
      if (!dots.has(shade)) dots.set(shade, []);
      dots.get(shade).push(pose);
    } else drawBody(context, camera, pose, shadeOf(pose.speed, look.topMps), look);
  }
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  drawDots(context, camera, dots, look.palette);
  for (const pose of apart) drawApart(context, camera, pose, look);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
}

function drawDots(context, camera, dots, palette) {
  const size = 3.2;
  const edge = seenIn(dots) > MANY_DOTS ? 0.25 : 0.6;
  context.fillStyle = palette.outline;
  for (const poses of dots.values()) {
    for (const pose of poses) {
      const [x, y] = camera.toScreen(pose.x, pose.y);
      context.fillRect(x - size / 2 - edge, y - size / 2 - edge, size + 2 * edge, size + 2 * edge);
    }
  }
  for (const [shade, poses] of dots) {
    context.fillStyle = SHADES[shade];
    for (const pose of poses) {
      const [x, y] = camera.toScreen(pose.x, pose.y);
      context.fillRect(x - size / 2, y - size / 2, size, size);
    }
  }
}

function seenIn(dots) {
  return [...dots.values()].reduce((sum, poses) => sum + poses.length, 0);
}

function drawApart(context, camera, pose, look) {
  const isHost = pose.vehicle === look.host;
  const [x, y] = camera.toScreen(pose.x, pose.y);
  const colour = isHost ? look.palette.host : look.palette.chosen;
  const radius = Math.max(0.62 * pose.size.lengthM * camera.scale, 7);
  context.setTransform(camera.ratio, 0, 0, camera.ratio, 0, 0);
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.lineWidth = 1.5;
  context.strokeStyle = colour;
  context.globalAlpha = 0.75;
  context.stroke();
  context.globalAlpha = 1;
  drawBody(context, camera, pose, isHost ? null : shadeOf(pose.speed, look.topMps), look);
}

/** Without a shade it is the host. */
function drawBody(context, camera, pose, shade, look) {
  const { scale, ratio } = camera;
  const [x, y] = camera.toScreen(pose.x, pose.y);
  const [cos, sin] = [Math.cos(pose.heading) * ratio, Math.sin(pose.heading) * ratio];
  context.setTransform(cos, -sin, sin, cos, x * ratio, y * ratio); // now x points ahead, in pixels
  const long = Math.max(pose.size.lengthM * scale, 6) / 2;
  const wide = Math.max(pose.size.widthM * scale, 3) / 2;
  const isMarked = look.sensed.has(pose.vehicle) || pose.size.vclass === DRIVEN;
  context.fillStyle = shade === null ? look.palette.host : SHADES[shade];
  context.strokeStyle = isMarked ? look.palette.host : look.palette.outline;
  context.lineWidth = isMarked ? 2.5 : 1;
  context.beginPath();
  if (2 * long < BODY_PX) {
    context.moveTo(-long, -wide);
    context.lineTo(long / 2, -wide);
    context.lineTo(long, 0);
    context.lineTo(long / 2, wide);
    context.lineTo(-long, wide);
    context.closePath();
    context.stroke();
    context.fill();
    return;
  }
  const hasCab = pose.size.lengthM >= LONG_M;
  const taper = hasCab ? 0.18 * wide : 0.55 * wide;
  const nose = Math.min(hasCab ? 0.25 * wide : 0.8 * wide, long);
  const round = 0.35 * wide;
  context.moveTo(-long + round, -wide);
  context.lineTo(long - nose, -wide);
  context.quadraticCurveTo(long - 0.1 * nose, -wide + 0.2 * taper, long, -wide + taper);
  context.lineTo(long, wide - taper);
  context.quadraticCurveTo(long - 0.1 * nose, wide - 0.2 * taper, long - nose, wide);
  context.lineTo(-long + round, wide);
  context.quadraticCurveTo(-long, wide, -long, wide - round);
  context.lineTo(-long, -wide + round);
  context.quadraticCurveTo(-long, -wide, -long + round, -wide);
  context.closePath();
  context.stroke();
  context.fill();
  drawWindscreen(context, long, wide, hasCab, shade !== null && shade < DARK_SHADES, scale);
}

function drawWindscreen(context, long, wide, hasCab, isDark, scale) {
  const front = hasCab ? long - 0.35 * scale : 0.42 * long;
  const back = hasCab ? long - 1.1 * scale : 0.12 * long;
  context.fillStyle = isDark ? LIGHT_GLASS : DARK_GLASS;
  context.globalAlpha = 0.85;
  context.beginPath();
  context.moveTo(back, -0.68 * wide);
  context.lineTo(front, -0.82 * wide);
  context.lineTo(front, 0.82 * wide);
  context.lineTo(back, 0.68 * wide);
  context.closePath();
  context.fill();
  if (hasCab) {
    context.fillRect(long - 2.4 * scale, -wide, Math.max(0.12 * scale, 0.8), 2 * wide);
  }
  context.globalAlpha = 1;
}

export function drawNames(context, camera, seen, look) {
  if (camera.scale < NAMES_PX) return;
  context.font = "11px system-ui, sans-serif";
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.lineJoin = "round";
  const isApart = (pose) => pose.vehicle === look.host || pose.vehicle === look.chosen;
  const placed = []; // names do not lie on one another: the host's and the chosen one's come first
  for (const pose of [...seen.filter(isApart), ...seen.filter((other) => !isApart(other))]) {
    if (placed.length >= MOST_NAMES) break;
    const [x, y] = camera.toScreen(pose.x, pose.y);
    const above = (Math.abs(Math.sin(pose.heading)) * pose.size.lengthM * camera.scale) / 2;
    const top = y - Math.max(above, (pose.size.widthM * camera.scale) / 2) - 3;
    const half = context.measureText(pose.size.id).width / 2;
    if (placed.some((other) => Math.abs(other.x - x) < other.half + half + 2 && Math.abs(other.top - top) < NAME_PX)) continue;
    placed.push({ x, top, half });
    context.lineWidth = 3;
    context.strokeStyle = look.palette.paper;
    context.strokeText(pose.size.id, x, top);
    context.fillStyle = look.palette.ink;
    context.fillText(pose.size.id, x, top);
  }
}

/** Who is at a place of the view, or null; a finger's width off is near enough. */
export function vehicleAt(camera, seen, left, top, spare = 12) {
  let [found, nearest] = [null, Infinity];
  for (const pose of seen) {
    const [x, y] = camera.toScreen(pose.x, pose.y);
    const distance = Math.hypot(x - left, y - top) - (pose.size.lengthM * camera.scale) / 2;
    if (distance < Math.min(nearest, spare)) [found, nearest] = [pose.vehicle, distance];
  }
  return found;
}
