// The card beside the road: the decision that is in force, and what the host and the assistance layer do.

import { ACTION_LABELS, ACTION_SIGNS, clock, counted, ending, holdingSentence, kmh, outcome } from "./words.js";
import { decisionAt, durationOf, frameAt, hasEnded } from "./timeline.js";
import { forEachPresent } from "./decode.js";
import { poseOf } from "./motion.js";
import { svgElement } from "./marks.js";

const OVER = {}; // instead of a decision, once the film has ended

function element(name, text = "", className = "") {
  const made = document.createElement(name);
  made.textContent = text;
  if (className) made.className = className;
  return made;
}

function bar(share) {
  const made = element("span", "", "bar");
  const svg = svgElement("svg", { viewBox: "0 0 100 1", preserveAspectRatio: "none", "aria-hidden": "true" }, made);
  svgElement("rect", { width: (100 * share).toFixed(1), height: 1 }, svg);
  return made;
}

export class Card {
  constructor(root, stage, actions, page) {
    this.root = root;
    this.stage = stage;
    this.film = stage.film;
    this.actions = actions;
    this.page = page;
    [this.heading, this.outcome, this.choices, this.figures, this.who] = ["h2", ".outcome", "tbody", ".figures", ".who"].map(
      (selector) => root.querySelector(selector),
    );
    this.decision = undefined;
    this.shown = "";
    root.querySelector(".choices").hidden = !this.film.driven;
    this.ending = ending(this.film.driven?.endReason, clock(page.base + durationOf(this.film), { long: page.long }));
  }

  show(elapsed) {
    const frame = frameAt(this.film, elapsed);
    const { driven } = this.film;
    const isOver = hasEnded(this.film, elapsed);
    const decision = isOver ? OVER : decisionAt(driven?.decisions ?? [], frame);
    if (decision !== this.decision) this._showDecision(decision);
    const entries = isOver ? [] : driven ? this._ofHost(frame) : this._ofAll(frame);
    const who = this._ofChosen(isOver ? null : frame);
    const text = JSON.stringify([entries, who]);
    if (text === this.shown) return; // most frames change nothing that is read
    this.shown = text;
    this.figures.replaceChildren(
      ...entries.map(([name, value]) => {
        const entry = element("div", "", value === undefined ? "wide" : "");
        entry.append(...(value === undefined ? [element("dd", name)] : [element("dt", name), element("dd", value)]));
        return entry;
      }),
    );
    this.who.textContent = who;
  }

  _showDecision(decision) {
    this.decision = decision;
    this.outcome.hidden = !this.film.driven && decision !== OVER;
    this.root.classList.toggle("over", decision === OVER);
    this.outcome.classList.toggle("refused", Boolean(decision?.why));
    if (!decision || decision === OVER) {
      this.heading.textContent = decision ? this.film.name : this._withoutDecision();
      this.outcome.textContent = decision ? this.ending.join(": ") : "";
      this.choices.replaceChildren();
      return;
    }
    const { base, long } = this.page;
    this.heading.textContent = `Decision at ${clock(base + decision.frame * this.film.stepS, { long })}`;
    const [asked, ...rest] = outcome(decision).split(":");
    this.outcome.replaceChildren(element("b", asked), `:${rest.join(":")}`);
    const rows = this.actions.map((action, k) => this._choice(decision, action, k));
    if (decision.judged !== null) {
      const row = document.createElement("tr");
      row.className = "judged";
      row.append(element("th", "judge’s score"), ...this._shareCells(decision.judged, decision.judged.toFixed(2)));
      rows.push(row);
    }
    this.choices.replaceChildren(...rows);
  }

  _withoutDecision() {
    const { driven, name } = this.film;
    if (!driven) return name;
    if (driven.decisions.length) return "Before the first decision";
    return driven.holding.every((what) => what === "SUMO") ? "No decisions: SUMO’s own driver drives" : "No decisions";
  }

  _choice(decision, action, k) {
    const row = document.createElement("tr");
    const isOpen = decision.open[k] ?? true;
    const isAsked = action === decision.asked;
    row.className = [isOpen ? "open" : "closed", isAsked ? "asked" : ""].join(" ").trim();
    const header = document.createElement("th");
    const chip = element("span", "", "chip");
    chip.append(element("i", ACTION_SIGNS[action]), ACTION_LABELS[action]);
    chip.title = [isOpen ? "would be carried out" : "would be refused", isAsked ? "asked for" : ""].filter(Boolean).join(", ");
    header.append(chip, element("span", ` (${chip.title})`, "hidden"));
    row.append(header);
    const share = decision.probabilities[k];
    row.append(...(share === undefined ? [element("td"), element("td")] : this._shareCells(share, `${(100 * share).toFixed(0)} %`)));
    return row;
  }

  _shareCells(share, text) {
    const cell = document.createElement("td");
    cell.append(bar(share));
    return [cell, element("td", text, "share")];
  }

  _ofHost(frame) {
    const { driven } = this.film;
    const whole = Math.floor(frame);
    const pose = poseOf(this.film, driven.vehicle, frame);
    const gap = driven.gapM[whole];
    const isLast = frame === this.film.nFrames - 1;
    return [
      [pose ? `The host ${holdingSentence(driven.holding[whole], pose.speed, { setMps: driven.setMps[whole], limitMps: driven.limitMps[whole] })}.` : "The host is not on the road."],
      ["speed", pose ? kmh(pose.speed) : "–"],
      ["set speed", Number.isFinite(driven.setMps[whole]) ? kmh(driven.setMps[whole]) : "none"],
      ["limit", kmh(driven.limitMps[whole])],
      ["gap ahead", Number.isFinite(gap) ? `${gap.toFixed(1)} m` : "nobody in sight"],
      ...(isLast && driven.endReason ? [[`${this.ending.join(": ")}.`]] : []),
    ];
  }

  _ofAll(frame) {
    let [count, sum, standing] = [0, 0, 0];
    forEachPresent(this.film, Math.floor(frame), (_, row) => {
      const speed = this.film.speed[row] * this.film.quanta.speed_mps;
      count += 1;
      sum += speed;
      standing += speed < 0.1 ? 1 : 0;
    });
    return [
      ["on the road", counted(count, "vehicle")],
      ["mean speed", count ? kmh(sum / count) : "–"],
      ["standing", counted(standing, "vehicle")],
      ["in the whole film", counted(this.film.vehicles.length, "vehicle")],
    ];
  }

  /** Whom the view follows; without a frame, less what it does now. */
  _ofChosen(frame) {
    const { target, host } = this.stage;
    if (target === null) return "Click a vehicle to follow it.";
    if (target === host) return "";
    const { id, vclass, lengthM } = this.film.vehicles[target];
    const pose = frame === null ? null : poseOf(this.film, target, frame);
    const now = pose ? kmh(pose.speed) : frame === null ? null : "not on the road";
    return `Following ${id}: ${[vclass, `${lengthM.toFixed(1)} m long`, now].filter(Boolean).join(", ")}.`;
  }
}
