// How the second film's driver does compared with the first's, told in a line.

import { KMH, signed } from "./words.js";
import { countUntil, frameAt, hasEnded, overtakesOf } from "./timeline.js";
import { drivenDistance, poseOf } from "./motion.js";

const NOTHING = "–";

export class Difference {
  constructor(element, films) {
    this.element = element;
    this.films = films;
    this.distances = films.map((film) => (film.driven ? drivenDistance(film, film.driven.vehicle) : null));
    this.passes = films.map((film) => overtakesOf(film.driven?.marks ?? []));
    this.shown = "";
  }

  show(elapsed) {
    const pieces = this._pieces(elapsed);
    const text = JSON.stringify(pieces);
    if (text === this.shown) return; // most frames change nothing that is read
    this.shown = text;
    const lead = document.createElement("span");
    lead.textContent = "B compared with A:";
    this.element.replaceChildren(lead, ...pieces.map(([what, value]) => piece(what, value)));
  }

  _pieces(elapsed) {
    const [a, b] = this.films.map((film, number) => this._of(film, number, elapsed));
    const difference = (of, unit) => (Number.isFinite(b[of] - a[of]) ? `${signed(b[of] - a[of])} ${unit}` : NOTHING);
    return [
      ["speed", difference("kmh", "km/h")],
      ["driven", difference("driven", "m")],
      ["overtakes so far", `${b.passed} to ${a.passed} (${signed(b.passed - a.passed)})`],
    ];
  }

  /** After its film's end somebody has no speed; what was driven by then, and who was overtaken, stays. */
  _of(film, number, elapsed) {
    const frame = frameAt(film, elapsed);
    const pose = film.driven && !hasEnded(film, elapsed) ? poseOf(film, film.driven.vehicle, frame) : null;
    return {
      kmh: pose ? pose.speed * KMH : NaN,
      driven: this.distances[number]?.[Math.floor(frame)] ?? NaN,
      passed: countUntil(this.passes[number], frame),
    };
  }
}

function piece(what, value) {
  const [made, strong] = [document.createElement("span"), document.createElement("b")];
  strong.textContent = value;
  made.append(`${what} `, strong);
  return made;
}
