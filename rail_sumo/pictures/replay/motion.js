// Where somebody is between two frames.

import { spanAt } from "./decode.js";

const LEAP_M = 15;
const AT_MOST_OF_CHORD = 1.5;

export const FULL_TURN = 2 * Math.PI;

/** From one angle towards another, the short way round. */
export function turned(from, to, share) {
  const difference = ((to - from + Math.PI) % FULL_TURN + FULL_TURN) % FULL_TURN - Math.PI;
  return from + share * difference;
}

/**
 * Put into `out` where the vehicle of a span is at a frame with its fraction: x and y in metres from the page's origin,
 * heading in radians, speed in m/s. On a frame it is what the film says, in between a curve that leaves and arrives
 * along the headings. Who leaps, as SUMO's teleports do, stays until it has leapt.
 */
export function poseInSpan(film, span, frame, out) {
  const { quanta } = film;
  const whole = Math.floor(frame);
  const row = film.spans.row[span] + whole - film.spans.first[span];
  const share = frame - whole;
  out.x = film.x[row] * quanta.position_m;
  out.y = film.y[row] * quanta.position_m;
  out.heading = film.heading[row] * quanta.heading_rad;
  out.speed = film.speed[row] * quanta.speed_mps;
  const isLast = whole - film.spans.first[span] + 1 >= film.spans.length[span];
  if (!share || isLast) return out;
  const [dx, dy] = [film.x[row + 1] * quanta.position_m - out.x, film.y[row + 1] * quanta.position_m - out.y];
  const chord = Math.hypot(dx, dy);
  const nextSpeed = film.speed[row + 1] * quanta.speed_mps;
  if (chord > LEAP_M + 2 * Math.max(out.speed, nextSpeed) * film.stepS) return out;
  const nextHeading = film.heading[row + 1] * quanta.heading_rad;
  const leaves = tangent(out.heading, out.speed * film.stepS, dx, dy, chord);
  const arrives = tangent(nextHeading, nextSpeed * film.stepS, dx, dy, chord);
  const [s2, s3] = [share * share, share * share * share];
  const [begin, end, along] = [s3 - 2 * s2 + share, s3 - s2, 3 * s2 - 2 * s3]; // Hermite's cubic
  out.x += along * dx + begin * leaves[0] + end * arrives[0];
  out.y += along * dy + begin * leaves[1] + end * arrives[1];
  out.heading = turned(out.heading, nextHeading, share);
  out.speed += share * (nextSpeed - out.speed);
  return out;
}

/** How the curve sets out or arrives: along the heading where that agrees with where it goes, else straight there. */
function tangent(heading, length, dx, dy, chord) {
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  if (chord < 1e-6 || (cos * dx + sin * dy) / chord < 0.5) return [dx, dy];
  const bounded = Math.min(length, AT_MOST_OF_CHORD * chord);
  return [bounded * cos, bounded * sin];
}

/** The same of a vehicle, or null where it is not there. */
export function poseOf(film, vehicle, frame, out = {}) {
  const span = vehicle === null ? -1 : spanAt(film, vehicle, Math.floor(frame));
  return span < 0 ? null : poseInSpan(film, span, frame, out);
}

/** How far a vehicle has driven by each frame, leaps left out. */
export function drivenDistance(film, vehicle) {
  const distance = new Float64Array(film.nFrames);
  const { spans, quanta } = film;
  for (let span = 0; span < spans.first.length; span += 1) {
    if (spans.vehicle[span] !== vehicle) continue;
    for (let k = 1; k < spans.length[span]; k += 1) {
      const row = spans.row[span] + k;
      const metres = Math.hypot(film.x[row] - film.x[row - 1], film.y[row] - film.y[row - 1]) * quanta.position_m;
      const fastest = Math.max(film.speed[row], film.speed[row - 1]) * quanta.speed_mps;
      if (metres <= LEAP_M + 2 * fastest * film.stepS) distance[spans.first[span] + k] += metres;
    }
  }
  for (let k = 1; k < film.nFrames; k += 1) distance[k] += distance[k - 1];
  return distance;
}

/** A vehicle's speed in each frame, NaN where it is not there. */
export function speedsOf(film, vehicle) {
  const speeds = new Float64Array(film.nFrames).fill(NaN);
  const { spans, quanta } = film;
  for (let span = 0; span < spans.first.length; span += 1) {
    if (spans.vehicle[span] !== vehicle) continue;
    for (let k = 0; k < spans.length[span]; k += 1) {
      speeds[spans.first[span] + k] = film.speed[spans.row[span] + k] * quanta.speed_mps;
    }
  }
  return speeds;
}
