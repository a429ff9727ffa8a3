// From what packed.py packed to typed arrays. The counterpart of rail_sumo/pictures/packed.py: see there for the format.

export const FORMAT = 2;
const FRAMES_IN_BUCKET = 64;

/** Why a film cannot be shown, as the page says it. */
export class Unfit extends Error {}

/** Base64 text -> bytes. */
export function bytesOf(base64) {
  const text = atob(base64.trim());
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at += 1) bytes[at] = text.charCodeAt(at);
  return bytes;
}

export async function inflate(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Inflated bytes -> the header, and a function that returns a stream of integers by its name. */
export function opened(raw) {
  const headLength = new DataView(raw.buffer, raw.byteOffset).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(raw.subarray(4, 4 + headLength)));
  const places = new Map();
  let offset = 4 + headLength;
  for (const [name, [count, size]] of Object.entries(header.streams)) {
    places.set(name, { count, from: offset, to: offset + size });
    offset += size;
  }
  if (offset !== raw.length) throw new Unfit("its data are cut off");
  const stream = (name) => {
    const { count, from, to } = places.get(name);
    return varints(raw.subarray(from, to), count);
  };
  return { header, stream };
}

/** Seven bits a byte, the lowest first; the sign in the lowest bit. Sums, not shifts: they hold beyond 32 bits. */
export function varints(bytes, count) {
  const values = new Int32Array(count);
  let at = 0;
  for (let k = 0; k < count; k += 1) {
    let value = 0;
    let unit = 1;
    let byte;
    do {
      byte = bytes[at];
      at += 1;
      value += (byte & 0x7f) * unit;
      unit *= 128;
    } while (byte >= 0x80);
    values[k] = value % 2 ? -(value + 1) / 2 : value / 2;
  }
  if (at !== bytes.length) throw new Unfit("its data are damaged");
  return values;
}

/** Sum differences up in place, anew from each start. */
export function summed(values, starts) {
  for (let s = 0; s < starts.length; s += 1) {
    const end = s + 1 < starts.length ? starts[s + 1] : values.length;
    for (let k = starts[s] + 1; k < end; k += 1) values[k] += values[k - 1];
  }
  return values;
}

/** Sum second differences up in place, anew from each start. */
export function summedTwice(values, starts) {
  for (let s = 0; s < starts.length; s += 1) {
    const end = s + 1 < starts.length ? starts[s + 1] : values.length;
    let step = 0;
    for (let k = starts[s] + 1; k < end; k += 1) {
      step += values[k];
      values[k] = values[k - 1] + step;
    }
  }
  return values;
}

function startsOf(lengths) {
  const starts = new Int32Array(lengths.length);
  for (let k = 1; k < lengths.length; k += 1) starts[k] = starts[k - 1] + lengths[k - 1];
  return starts;
}

function scaled(values, quantum) {
  return Float64Array.from(values, (value) => value * quantum);
}

/** The ground: coordinates in metres from the page's origin. */
export function groundOf(raw, quanta) {
  const { header, stream } = opened(raw);
  const counts = stream("counts");
  const starts = startsOf(counts);
  const filled = starts.filter((_, k) => counts[k] > 0);
  const xs = scaled(summed(stream("x"), filled), quanta.position_m);
  const ys = scaled(summed(stream("y"), filled), quanta.position_m);
  const shape = (k) => ({ x: xs.subarray(starts[k], starts[k] + counts[k]), y: ys.subarray(starts[k], starts[k] + counts[k]) });
  const lanes = header.lanes.map(([id, width, isOpen, isInside, leftLine], k) => ({
    id,
    widthM: width * quanta.size_m,
    isOpen: Boolean(isOpen),
    isInside: Boolean(isInside),
    leftLine,
    ...shape(k),
  }));
  const junctions = Array.from(counts.subarray(lanes.length), (_, k) => shape(lanes.length + k));
  const [stopX, stopY] = [scaled(stream("stop_x"), quanta.position_m), scaled(stream("stop_y"), quanta.position_m)];
  const stopLines = header.stop_lines.map((lane, k) => ({
    lane,
    ends: [stopX[2 * k], stopY[2 * k], stopX[2 * k + 1], stopY[2 * k + 1]],
  }));
  return { name: header.name, isLeftHand: header.is_left_hand, lanes, junctions, stopLines };
}

/** A film: columns of whole quanta, one row per vehicle and frame, the rows of a span in a row. */
export function filmOf(raw, head) {
  const { header, stream } = opened(raw);
  const { quanta } = head;
  const spanVehicle = stream("span_vehicle");
  if (spanVehicle.length) summed(spanVehicle, [0]);
  const length = stream("span_length");
  const row = startsOf(length);
  const spans = { vehicle: spanVehicle, first: stream("span_first"), length, row };
  const heading = summed(stream("heading"), row);
  for (let k = 0; k < heading.length; k += 1) heading[k] = ((heading[k] % 36000) + 36000) % 36000;
  return {
    name: header.name,
    startS: header.start_s,
    stepS: header.step_s,
    nFrames: header.n_frames,
    leftOut: header.left_out,
    vehicles: header.vehicles.map(([id, kind, long, wide]) => ({
      id,
      vclass: header.vclasses[kind],
      lengthM: long * quanta.size_m,
      widthM: wide * quanta.size_m,
    })),
    signals: header.signals,
    spans,
    buckets: bucketsOf(spans, header.n_frames),
    x: summedTwice(stream("x"), row),
    y: summedTwice(stream("y"), row),
    heading,
    speed: summed(stream("speed"), row),
    quanta,
    driven: header.driven && drivenOf(header, stream, head),
  };
}

function drivenOf(header, stream, head) {
  const { driven, n_frames: nFrames } = header;
  const { quanta, actions, holdings } = head;
  const rayStarts = Array.from({ length: nFrames ? driven.n_rays : 0 }, (_, ray) => ray * nFrames);
  const withGaps = (name, quantum) => {
    const isThere = summed(stream(`has_${name}`), [0]);
    return Float64Array.from(summed(stream(name), [0]), (value, k) => (isThere[k] ? value * quantum : NaN));
  };
  return {
    vehicle: driven.vehicle,
    nRays: driven.n_rays,
    rangeM: driven.range_m,
    ray: summed(stream("ray"), rayStarts), // ray by ray
    setMps: withGaps("set", quanta.speed_mps),
    limitMps: scaled(summed(stream("limit"), [0]), quanta.speed_mps),
    gapM: withGaps("gap", quanta.gap_m),
    holding: Array.from(summed(stream("holding"), [0]), (index) => holdings[index]),
    decisions: driven.decisions.map(([frame, asked, carriedOut, why, open, probabilities, judged, stays]) => ({
      frame,
      asked: actions[asked],
      carriedOut: actions[carriedOut],
      why,
      open: open.map(Boolean),
      probabilities: probabilities.map((share) => share * quanta.probability),
      judged: judged === null ? null : judged * quanta.probability,
      stays,
    })),
    endReason: driven.end_reason,
    marks: driven.marks.map(([frame, kind, text]) => ({ frame, kind, text })),
  };
}

/** For each 64 frames, the spans that reach into them: so that a frame finds who is there without asking everybody. */
export function bucketsOf(spans, nFrames) {
  const buckets = Array.from({ length: Math.ceil(nFrames / FRAMES_IN_BUCKET) }, () => []);
  for (let span = 0; span < spans.first.length; span += 1) {
    const last = spans.first[span] + spans.length[span] - 1;
    for (let b = Math.floor(spans.first[span] / FRAMES_IN_BUCKET); b * FRAMES_IN_BUCKET <= last; b += 1) {
      buckets[b].push(span);
    }
  }
  return buckets;
}

/** Call `each(span, row)` for everybody who is there in a whole frame. */
export function forEachPresent(film, frame, each) {
  const { first, length, row } = film.spans;
  for (const span of film.buckets[Math.floor(frame / FRAMES_IN_BUCKET)] ?? []) {
    const since = frame - first[span];
    if (since >= 0 && since < length[span]) each(span, row[span] + since);
  }
}

/** The span in which a vehicle is there in a whole frame, or -1. */
export function spanAt(film, vehicle, frame) {
  const { first, length } = film.spans;
  for (const span of film.buckets[Math.floor(frame / FRAMES_IN_BUCKET)] ?? []) {
    const since = frame - first[span];
    if (film.spans.vehicle[span] === vehicle && since >= 0 && since < length[span]) return span;
  }
  return -1;
}
