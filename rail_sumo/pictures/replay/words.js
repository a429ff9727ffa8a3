// What the page says in words. Numbers come with their units.

export const KMH = 3.6;
const STANDING_MPS = 0.1; // as SUMO counts
const STEADY_MPS = 0.3; // a speed that is no farther from where it is to be is there

export const ACTION_LABELS = { keep: "keep", accelerate: "accelerate", decelerate: "decelerate", left: "left", right: "right" };
export const ACTION_SIGNS = { keep: "=", accelerate: "+", decelerate: "−", left: "↰", right: "↱" };

const REFUSALS = {
  "no lane": "refused, there is no lane on that side",
  line: "refused, the line between the lanes is solid",
  gap: "refused, the gap is too short",
  room: "refused, too little road is left for it",
  "lane ends": "refused, that lane soon ends or leads elsewhere",
  "just left": "refused, it has only just come from that lane",
  "no gain": "refused, it would get no farther in that lane",
  "under way": "not begun, a lane change is under way",
};

const STAYS = {
  lowest: "no effect, the set speed stays at its lowest",
  highest: "no effect, the set speed stays at its highest",
  same: "no effect, the set speed stays the same",
};

const HOLDINGS = {
  "set speed": "drives at the set speed",
  limit: "keeps to the speed limit",
  "limit ahead": "slows down for a lower speed limit ahead",
  "top speed": "drives as fast as its own vehicle can (maxSpeed)",
  "vehicle ahead": "follows the vehicle ahead",
  emergency: "brakes in an emergency",
  signal: "stops for the signal",
  "right of way": "gives way",
  "lane end": "slows for the end of its lane",
  "gap beside": "falls in for a gap in the lane beside",
  "vehicle joining": "leaves a gap for a vehicle that joins its lane",
  "vehicle across": "makes room for a vehicle across its way",
  SUMO: "is driven by SUMO, which chooses its speed and lane",
};

const ENDS = {
  course: "end of the course",
  duration: "its time was up",
  collision: "collision",
  "end of road": "end of the road",
  standstill: "the host stood still for minutes",
  "left the road": "the host left its road",
  "not begun": "it could not begin",
  "SUMO stopped": "SUMO stopped",
};

// Each kind has a shape of its own, so that colour only helps. Paths lie in a square from -6 to 6.
export const MARKS = {
  "lane change": { label: "lane change begun", path: "M0-5 5 4H-5Z", colour: "--mark-change" },
  refused: { label: "refused", path: "M-4-4 4 4M4-4-4 4", colour: "--mark-refused", line: true },
  reversed: { label: "reversed", path: "M0 5 5-4H-5Z", colour: "--mark-refused" },
  "hard braking": { label: "hard braking", path: "M-4-4.5H4V4.5H-4Z", colour: "--mark-danger" },
  overtake: { label: "overtake", path: "M0-5 5 0 0 5-5 0Z", colour: "--mark-pass" },
  overtaken: { label: "overtaken", path: "M0-4.5 4.5 0 0 4.5-4.5 0Z", colour: "--mark-pass", line: true },
  "lane end": { label: "end of lane", path: "M-4-5H-1V5H-4ZM1-5H4V5H1Z", colour: "--mark-change" },
  collision: { label: "collision", path: "M0-6 1.6-1.8 6 0 1.6 1.8 0 6-1.6 1.8-6 0-1.6-1.8Z", colour: "--mark-danger" },
  struck: { label: "struck", path: "M5 0A5 5 0 1 1-5 0 5 5 0 1 1 5 0M-2.6-2.6 2.6 2.6M2.6-2.6-2.6 2.6", colour: "--mark-danger", line: true },
};

/** What was made of a decision, in a sentence such as "left: refused, the gap is too short". */
export function outcome(decision) {
  const asked = ACTION_LABELS[decision.asked];
  if (decision.why) return `${asked}: ${REFUSALS[decision.why]}`;
  if (decision.stays) return `${asked}: ${STAYS[decision.stays]}`;
  if (decision.asked === decision.carriedOut) {
    return decision.asked === "keep" ? "keep: nothing changes" : `${asked}: carried out`;
  }
  return `${asked}: carried out as ${ACTION_LABELS[decision.carriedOut]}`;
}

/** What the host's speed follows, and whether it is there yet. */
export function holdingSentence(holding, speedMps, { setMps, limitMps }) {
  const [goal, name] = { "set speed": [setMps, "set speed"], limit: [Math.min(setMps, limitMps), "speed limit"] }[holding] ?? [];
  if (holding === "vehicle ahead" && speedMps < STANDING_MPS) return "stands behind the vehicle ahead";
  if (speedMps < goal - STEADY_MPS) return `speeds up to the ${name}`;
  if (speedMps > goal + STEADY_MPS) return `slows down to the ${name}`;
  return HOLDINGS[holding] ?? holding;
}

/** That and why an episode ended, in two parts such as "The episode ended at 9.5 s" and "end of the course". */
export function ending(reason, when) {
  return reason ? [`The episode ended at ${when}`, ENDS[reason] ?? reason] : [`The film ends at ${when}`];
}

export function kmh(mps) {
  return `${(mps * KMH).toFixed(0)} km/h`;
}

export function signed(value, digits = 0) {
  const text = Math.abs(value).toFixed(digits);
  const zero = Number(text) === 0;
  return `${zero ? "±" : value < 0 ? "−" : "+"}${text}`;
}

/** A moment as the clock shows it: seconds, or where it is long, hours, minutes and seconds. */
export function clock(seconds, { long = false } = {}) {
  if (!long) return `${seconds.toFixed(1)} s`;
  const tenths = Math.round(seconds * 10);
  const parts = [Math.floor(tenths / 36000), Math.floor(tenths / 600) % 60];
  const rest = ((tenths % 600) / 10).toFixed(1).padStart(4, "0");
  return `${parts.map((part) => String(part).padStart(2, "0")).join(":")}:${rest}`;
}

/** The same below an axis, as short as it can be told. */
export function tick(seconds, { long = false } = {}) {
  if (!long) return `${+seconds.toFixed(2)}`;
  return clock(seconds, { long }).replace(/\.0$/, "").replace(/^00:/, "");
}

export function counted(number, one, many = `${one}s`) {
  return `${number.toLocaleString("en")} ${number === 1 ? one : many}`;
}
