// The clock, and what lies on it. `elapsed` is in seconds since a film's first frame.

export const RATES = [0.25, 0.5, 1, 2, 4, 8, 16];

export function durationOf(film) {
  return (film.nFrames - 1) * film.stepS;
}

/** What the clock shows at `elapsed` 0: of an episode 0, as in its tables; else the simulation's time, if all begin at the same. */
export function clockBase(films) {
  if (films.some(({ driven }) => driven)) return 0;
  return films.every((film) => film.startS === films[0].startS) ? films[0].startS : 0;
}

const NO_TIME_S = 1e-6; // less than any step

/** Whether a film's last frame is past: then `frameAt` still tells that one. */
export function hasEnded(film, elapsed) {
  return elapsed > durationOf(film) + NO_TIME_S;
}

/** The frame of a moment, with its fraction; never outside the film. */
export function frameAt(film, elapsed) {
  const frame = elapsed / film.stepS;
  const nearest = Math.round(frame);
  const exact = Math.abs(frame - nearest) < 1e-6 ? nearest : frame; // 0.3 / 0.1 is no whole number
  return Math.min(Math.max(exact, 0), film.nFrames - 1);
}

/** How many of the entries, sorted by frame, lie at or before a frame. */
export function countUntil(entries, frame) {
  let [low, high] = [0, entries.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (entries[middle].frame <= frame) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The decision that is in force at a frame, or null before the first. */
export function decisionAt(decisions, frame) {
  const count = countUntil(decisions, Math.floor(frame));
  return count ? decisions[count - 1] : null;
}

/** The moments of all films' entries that pass, in order and each once. */
export function momentsOf(films, entriesOf, passes = () => true) {
  const moments = films.flatMap((film) => entriesOf(film).filter(passes).map((entry) => entry.frame * film.stepS));
  return [...new Set(moments)].sort((one, other) => one - other);
}

const AS_GOOD_AS_THERE_S = 1e-3;

/** The first of the sorted moments after `elapsed`, or the last before it; null if there is none. */
export function neighbour(moments, elapsed, direction) {
  if (direction > 0) return moments.find((moment) => moment > elapsed + AS_GOOD_AS_THERE_S) ?? null;
  return moments.findLast((moment) => moment < elapsed - AS_GOOD_AS_THERE_S) ?? null;
}

/** How often what a mark stands for happened: a mark of several overtakes at once says how many they were. */
export function timesOf({ text }) {
  return /^\d+$/.test(text) ? Number(text) : 1;
}

/** The overtakes among marks, each vehicle's one entry. */
export function overtakesOf(marks) {
  return marks.filter(({ kind }) => kind === "overtake").flatMap((mark) => Array(timesOf(mark)).fill(mark));
}

/** SUMO's letter at a frame, from the list of changes; "" before the first. */
export function letterAt(changes, frame) {
  let letter = "";
  for (const [since, next] of changes) {
    if (since > frame) break;
    letter = next;
  }
  return letter;
}

/** The moment that a link such as "#t=123.4" names, or null. */
export function linkedMoment(hash) {
  const found = /(?:^#|&)t=(-?\d+(?:\.\d+)?)(?:&|$)/.exec(hash);
  return found ? Number(found[1]) : null;
}
