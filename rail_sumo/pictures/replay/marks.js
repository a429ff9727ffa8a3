// The timeline: marks in rows, one a film, a rail that may be dragged, and buttons that leave kinds of marks out.

import { timesOf } from "./timeline.js";
import { MARKS, clock, counted } from "./words.js";

const SVG = "http://www.w3.org/2000/svg";
const NEAR_PX = 12;

export function svgElement(name, attributes, parent) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent?.append(element);
  return element;
}

function markShape(kind, parent, attributes = {}) {
  const { path, colour, line: isLine } = MARKS[kind];
  const painted = isLine ? { fill: "none", "stroke-width": 2 } : { fill: `var(${colour})`, "stroke-width": 1 };
  return svgElement("path", { d: path, stroke: `var(${colour})`, ...painted, ...attributes }, parent);
}

export class Timeline {
  /** `page` has films, base, duration, hidden (kinds left out), seek(elapsed) and refiltered(). */
  constructor(track, filters, page) {
    this.track = track;
    this.page = page;
    this.rows = page.films.map((film, number) => this._row(film, number));
    const rail = document.createElement("div");
    rail.className = "rail";
    this.done = document.createElement("i");
    rail.append(this.done);
    track.append(rail);
    track.setAttribute("aria-valuemax", page.duration.toFixed(1));
    this._filters(filters);
    this._listen();
  }

  _row(film, number) {
    const row = document.createElement("div");
    row.className = "row";
    if (this.page.films.length > 1) {
      const name = document.createElement("span");
      name.textContent = "AB"[number];
      row.append(name);
    }
    const svg = svgElement("svg", { role: "presentation" }, row);
    this.track.append(row);
    const marks = (film.driven?.marks ?? []).map((mark) => {
      const group = svgElement("g", {}, svg);
      const shape = markShape(mark.kind, group, { class: "mark", "data-kind": mark.kind });
      const elapsed = mark.frame * film.stepS;
      const when = clock(this.page.base + elapsed, { long: this.page.long });
      svgElement("title", {}, shape).textContent = [`${when} ${MARKS[mark.kind].label}`, mark.text].filter(Boolean).join(": ");
      return { mark, group, elapsed };
    });
    row.hidden = !marks.length;
    return { row, marks };
  }

  _filters(filters) {
    const counts = new Map();
    for (const { marks } of this.rows) for (const { mark } of marks) counts.set(mark.kind, (counts.get(mark.kind) ?? 0) + timesOf(mark));
    filters.hidden = counts.size === 0;
    for (const kind of Object.keys(MARKS).filter((known) => counts.has(known))) {
      const button = document.createElement("button");
      button.type = "button";
      button.dataset.kind = kind;
      button.setAttribute("aria-pressed", "true");
      button.setAttribute("aria-label", `Show ${counted(counts.get(kind), "mark")}: ${MARKS[kind].label}`);
      markShape(kind, svgElement("svg", { viewBox: "-7 -7 14 14", "aria-hidden": "true" }, button));
      button.append(`${MARKS[kind].label} ${counts.get(kind)}`);
      button.addEventListener("click", () => {
        const isHidden = !this.page.hidden.delete(kind);
        if (isHidden) this.page.hidden.add(kind);
        button.setAttribute("aria-pressed", String(!isHidden));
        this.place();
        this.page.refiltered();
      });
      filters.append(button);
    }
  }

  /** Put the marks where they belong, after the page's width or the filter has changed. */
  place() {
    const width = this.track.clientWidth;
    for (const { row, marks } of this.rows) {
      const middle = row.clientHeight / 2;
      for (const { mark, group, elapsed } of marks) {
        group.setAttribute("transform", `translate(${(this._share(elapsed) * width).toFixed(1)} ${middle})`);
        group.toggleAttribute("hidden", this.page.hidden.has(mark.kind));
        group.style.display = this.page.hidden.has(mark.kind) ? "none" : "";
      }
    }
  }

  show(elapsed) {
    this.done.style.transform = `scaleX(${this._share(elapsed)})`;
    const text = clock(this.page.base + elapsed, { long: this.page.long });
    if (this.text === text) return;
    this.text = text;
    this.track.setAttribute("aria-valuenow", elapsed.toFixed(1));
    this.track.setAttribute("aria-valuetext", text);
  }

  _share(elapsed) {
    return this.page.duration ? elapsed / this.page.duration : 0;
  }

  _listen() {
    const { track } = this;
    const elapsedAt = (event) => {
      const box = track.getBoundingClientRect();
      return (Math.min(Math.max(event.clientX - box.left, 0), box.width) / box.width) * this.page.duration;
    };
    track.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      const mark = this._markNear(event);
      this.page.seek(mark ? mark.elapsed : elapsedAt(event));
      if (!mark) track.setPointerCapture(event.pointerId);
    });
    track.addEventListener("pointermove", (event) => {
      if (track.hasPointerCapture(event.pointerId)) this.page.seek(elapsedAt(event));
    });
  }

  /** The mark that was meant: in the row that was pressed, the nearest of those that are shown. */
  _markNear(event) {
    for (const { row, marks } of this.rows) {
      const box = row.getBoundingClientRect();
      if (event.clientY < box.top || event.clientY > box.bottom) continue;
      const pressed = event.clientX - box.left;
      let [found, nearest] = [null, NEAR_PX];
      for (const candidate of marks) {
        const distance = Math.abs(this._share(candidate.elapsed) * box.width - pressed);
        if (!this.page.hidden.has(candidate.mark.kind) && distance < nearest) [found, nearest] = [candidate, distance];
      }
      return found;
    }
    return null;
  }
}
