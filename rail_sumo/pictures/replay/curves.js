// Curves below the road, on the same clock: uPlot's, and decisions as a strip of five rows.

import { ACTION_LABELS, KMH, tick } from "./words.js";
import { svgElement } from "./marks.js";
import { durationOf } from "./timeline.js";
import { forEachPresent } from "./decode.js";
import { speedsOf } from "./motion.js";

const ROWS = ["left", "accelerate", "keep", "decelerate", "right"]; // from above
const ROW_PX = 11; // labels of 9 px, one below the other
const [PLOT_PX, LOW_PLOT_PX, LOW_SPEED_PX, AXIS_PX] = [68, 46, 56, 22]; // low where two films share the page: all fit below them
const [APART_PX, LOW_APART_PX] = [22, 15]; // an axis's numbers, at least
const LEGEND = 0.4; // of what is drawn, so much above it for the legend
const TICKS_S = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 30, 60, 120, 300, 600, 1200, 1800, 3600, 7200, 14400, 43200, 86400];
const STEPPED = "stepped";

/** Read a colour of style.css. */
export function colourOf(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

/** How many are on the road, and their mean speed in km/h, in each frame. */
export function crowdOf(film) {
  const [count, mean] = [new Float64Array(film.nFrames), new Float64Array(film.nFrames)];
  for (let frame = 0; frame < film.nFrames; frame += 1) {
    let sum = 0;
    forEachPresent(film, frame, (_, row) => {
      count[frame] += 1;
      sum += film.speed[row];
    });
    mean[frame] = count[frame] ? (sum / count[frame]) * film.quanta.speed_mps * KMH : NaN;
  }
  return { count, mean };
}

function inKmh(values) {
  return Float64Array.from(values, (value) => value * KMH);
}

/** Which curves there are: a list of panels, each with a title, and series of values by film. */
export function panelsOf(films, chosen) {
  const several = films.length > 1;
  const named = (film, what) => (several ? `${"AB"[films.indexOf(film)]} ${what}` : what);
  const colour = (film) => (films.indexOf(film) ? "--second" : "--first");
  const speed = { title: "speed, km/h", series: [], from: null };
  const gap = { title: "gap ahead, m", series: [], from: 0 };
  const judged = { title: "judge’s score", series: [], from: 0, to: 1 };
  const crowd = { title: "vehicles", series: [], from: 0 };
  films.forEach((film, number) => {
    const { driven } = film;
    if (driven) {
      speed.series.push({ film, label: named(film, "speed"), colour: colour(film), values: inKmh(speedsOf(film, driven.vehicle)) });
      if (driven.setMps.some(Number.isFinite)) speed.series.push({ film, label: named(film, "set"), colour: colour(film), dash: [2, 3], width: 1.2, shape: STEPPED, values: inKmh(driven.setMps) });
      if (!number) speed.series.push({ film, label: named(film, "limit"), colour: "--limit", dash: [8, 4], width: 1.2, shape: STEPPED, values: inKmh(driven.limitMps) });
      gap.series.push({ film, label: named(film, "gap"), colour: colour(film), values: driven.gapM });
      if (driven.decisions.some((decision) => decision.judged !== null)) {
        const values = new Float64Array(film.nFrames).fill(NaN);
        driven.decisions.forEach((decision, k) => {
          if (decision.judged !== null) values.fill(decision.judged, decision.frame, driven.decisions[k + 1]?.frame);
        });
        judged.series.push({ film, label: named(film, "score"), colour: colour(film), shape: STEPPED, values });
      }
    } else {
      const { count, mean } = crowdOf(film);
      crowd.series.push({ film, label: named(film, "on the road"), colour: colour(film), shape: STEPPED, values: count });
      speed.series.push({ film, label: named(film, "mean of all"), colour: colour(film), values: mean });
    }
    if (chosen[number] !== null && chosen[number] !== driven?.vehicle) {
      const values = inKmh(speedsOf(film, chosen[number]));
      speed.series.push({ film, label: named(film, film.vehicles[chosen[number]].id), colour: "--accent", dash: [5, 2], values });
    }
  });
  return [speed, gap, judged, crowd].filter((panel) => panel.series.length);
}

/** The clock's readings at each frame of the longest film, and a film's values on them. */
function onOneClock(films, base, panel) {
  const longest = films.reduce((one, other) => (durationOf(other) > durationOf(one) ? other : one));
  const finest = Math.min(...films.map((film) => film.stepS));
  const count = Math.round(durationOf(longest) / finest) + 1;
  const times = Float64Array.from({ length: count }, (_, k) => base + k * finest);
  const values = panel.series.map(({ film, values: own }) =>
    Array.from(times, (time) => {
      const value = own[Math.round((time - base) / film.stepS)];
      return Number.isFinite(value) ? value : null;
    }),
  );
  return [times, ...values];
}

/** What a panel's axis spans: from 0, or where `from` is null from a little below the lowest value. */
export function rangeOf(panel, lowest, highest) {
  const from = panel.from ?? Math.max(Math.floor(lowest / 10) * 10 - 10, 0);
  return [from, panel.to ?? Math.max(highest + LEGEND * (highest - from), from + 1)];
}

/** Where an axis has numbers: round ones, as many as there is room for. */
export function ticksOf(low, high, most) {
  for (let unit = 0.1; ; unit *= 10) {
    for (const step of [1, 2, 2.5, 5].map((one) => one * unit)) {
      const [first, last] = [Math.ceil(low / step), Math.floor(high / step)];
      if (last - first < Math.max(most, 1)) return Array.from({ length: last - first + 1 }, (_, k) => (first + k) * step);
    }
  }
}

export class Curves {
  /** `page` has films, base, duration, chosen() and seek(elapsed). */
  constructor(element, page) {
    this.element = element;
    this.page = page;
    this.plots = [];
    this.strips = [];
  }

  /** Draw all of it anew: the page, the theme, or who is chosen has changed. */
  build() {
    for (const { plot } of this.plots) plot.destroy();
    this.element.replaceChildren();
    this.strips = this.page.films.filter((film) => film.driven?.decisions.length).map((film) => this._strip(film));
    const panels = panelsOf(this.page.films, this.page.chosen());
    this.plots = panels.map((panel, number) => this._plot(panel, number === panels.length - 1));
    this.resize();
  }

  resize() {
    const width = this.element.clientWidth;
    if (!width) return;
    for (const { plot, height } of this.plots) plot.setSize({ width, height });
    for (const strip of this.strips) this._drawStrip(strip, width);
  }

  _gutters() {
    return ["--left", "--right"].map((name) => parseFloat(colourOf(name)));
  }

  _plot(panel, isLast) {
    const element = document.createElement("div");
    element.className = "curve";
    element.append(this._legend(panel));
    this.element.append(element);
    const [left, right] = this._gutters();
    const { base, duration, films, long } = this.page;
    const [soft, hair] = [colourOf("--soft"), colourOf("--hair")];
    const axis = { stroke: soft, font: "11px system-ui, sans-serif", grid: { stroke: hair, width: 1 }, ticks: { show: false } };
    const isLow = films.length > 1;
    const apart = isLow ? LOW_APART_PX : APART_PX;
    const height = (!isLow ? PLOT_PX : panel.from === null ? LOW_SPEED_PX : LOW_PLOT_PX) + (isLast ? AXIS_PX : 0);
    const plot = new uPlot(
      {
        width: Math.max(this.element.clientWidth, 100),
        height,
        padding: [8, right, isLast ? 0 : 7, 0],
        legend: { show: false },
        cursor: { y: false, drag: { x: false, y: false }, points: { show: false } },
        scales: {
          x: { time: false, range: [base, base + Math.max(duration, 1e-3)] },
          y: { range: (_, lowest, highest) => rangeOf(panel, lowest, highest) },
        },
        axes: [
          { ...axis, show: isLast, size: AXIS_PX, gap: 2, grid: { show: false }, space: 64, incrs: TICKS_S, values: (_, splits) => splits.map((split) => (long && split > base + 0.96 * duration ? "" : tick(split, { long }))) },
          { ...axis, size: left, gap: 6, space: apart, splits: ({ bbox }, _, low, high) => (panel.to ? [0, 0.5, 1] : ticksOf(low, high, Math.floor(bbox.height / devicePixelRatio / apart))) },
        ],
        series: [
          {},
          ...panel.series.map(({ label, colour, dash, width, shape }) => ({
            label,
            stroke: colourOf(colour),
            width: width ?? 1.6,
            dash,
            points: { show: false },
            paths: shape === STEPPED ? uPlot.paths.stepped({ align: 1 }) : undefined,
          })),
        ],
      },
      onOneClock(films, base, panel),
      element,
    );
    this._seeks(plot.over, (offset) => plot.posToVal(offset, "x") - base);
    return { plot, height };
  }

  _legend(panel) {
    const legend = document.createElement("p");
    legend.append(panel.title);
    for (const { label, colour, dash } of panel.series.length > 1 || this.page.films.length > 1 ? panel.series : []) {
      const entry = document.createElement("span");
      const svg = svgElement("svg", { viewBox: "0 0 18 6", "aria-hidden": "true" }, entry);
      svgElement("path", { d: "M0 3H18", stroke: `var(${colour})`, "stroke-dasharray": (dash ?? []).join(" ") }, svg);
      entry.append(label);
      legend.append(entry);
    }
    return legend;
  }

  _strip(film) {
    const canvas = document.createElement("canvas");
    canvas.className = "strip";
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `Decisions of ${film.name}: filled where carried out, pale where that changes nothing, hollow where refused`);
    this.element.append(canvas);
    const [left, right] = this._gutters();
    this._seeks(canvas, (offset) => ((offset - left) / (canvas.clientWidth - left - right)) * this.page.duration);
    return { canvas, film };
  }

  _drawStrip({ canvas, film }, width) {
    const ratio = window.devicePixelRatio || 1;
    const [left, right] = this._gutters();
    const height = ROWS.length * ROW_PX + 4;
    [canvas.width, canvas.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    canvas.style.height = `${height}px`;
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.textBaseline = "middle";
    const unit = (width - left - right) / Math.max(this.page.duration, 1e-3);
    const number = this.page.films.indexOf(film);
    const [colour, refused] = [colourOf(number ? "--second" : "--first"), colourOf("--mark-refused")];
    if (this.page.films.length > 1) {
      context.fillStyle = colour;
      context.textAlign = "left";
      context.font = "bold 12px system-ui, sans-serif";
      context.fillText("AB"[number], 5, height / 2);
    }
    context.font = "9px system-ui, sans-serif";
    context.textAlign = "right";
    ROWS.forEach((action, row) => {
      const top = 2 + row * ROW_PX;
      context.fillStyle = colourOf("--soft");
      context.fillText(ACTION_LABELS[action], left - 8, top + ROW_PX / 2);
      context.fillStyle = colourOf("--hair");
      context.fillRect(left, top + ROW_PX / 2, width - left - right, 0.5);
    });
    const { decisions } = film.driven;
    decisions.forEach((decision, k) => {
      const from = left + decision.frame * film.stepS * unit;
      const until = left + (decisions[k + 1]?.frame ?? film.nFrames - 1) * film.stepS * unit;
      const wide = Math.max(Math.min(until - from - 0.6, 14), 1.6);
      const top = 2 + ROWS.indexOf(decision.asked) * ROW_PX + 1.5;
      if (decision.why) {
        context.strokeStyle = refused;
        context.lineWidth = 1;
        context.strokeRect(from + 0.5, top + 0.5, Math.max(wide - 1, 2), ROW_PX - 4);
      } else {
        context.fillStyle = colour;
        context.globalAlpha = decision.asked === "keep" || decision.stays ? 0.45 : 1;
        context.fillRect(from, top, wide, ROW_PX - 3);
        context.globalAlpha = 1;
      }
    });
  }

  _seeks(element, elapsedAt) {
    const seek = (event) => this.page.seek(elapsedAt(event.clientX - element.getBoundingClientRect().left));
    element.addEventListener("pointerdown", (event) => {
      if (event.button > 0) return;
      element.setPointerCapture(event.pointerId);
      seek(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (element.hasPointerCapture(event.pointerId)) seek(event);
    });
  }
}
