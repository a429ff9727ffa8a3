// Unpacks the films, owns the clock, and lets everything be drawn.

import { Card } from "./card.js";
import { Curves } from "./curves.js";
import { Difference } from "./difference.js";
import { FORMAT, Unfit, bytesOf, filmOf, groundOf, inflate } from "./decode.js";
import { Link } from "./link.js";
import { Road } from "./road.js";
import { Stage } from "./stage.js";
import { Timeline } from "./marks.js";
import { KMH, MARKS, clock } from "./words.js";
import { Saver, canRecord } from "./save.js";
import { clockBase, durationOf, linkedMoment, momentsOf, neighbour } from "./timeline.js";
import { listen } from "./controls.js";
import { presentPalette, switchTheme, watchTheme } from "./theme.js";

const LONG_CLOCK_S = 3600; // from here on the clock shows hours and minutes
const LONGEST_STEP_S = 0.25; // a page that was in the background goes on where it was

const byId = (id) => document.getElementById(id);

async function unpack() {
  const head = JSON.parse(byId("head").textContent);
  if (head.format !== FORMAT) throw new Unfit("its data are of another version");
  const raw = (id) => inflate(bytesOf(byId(id).textContent));
  const ground = groundOf(await raw("ground"), head.quanta);
  const films = [];
  while (byId(`film-${films.length}`)) films.push(filmOf(await raw(`film-${films.length}`), head));
  return { head, ground, films };
}

class Page {
  constructor({ head, ground, films }) {
    [this.head, this.ground, this.films] = [head, ground, films];
    this.base = clockBase(films);
    this.duration = Math.max(...films.map(durationOf));
    this.begins = [...new Set(films.map(({ startS }) => startS))].filter((startS) => startS !== this.base); // by the simulation's time
    this.long = this.base + this.duration >= LONG_CLOCK_S;
    this.hidden = new Set(); // kinds of marks that are left out
    this.elapsed = 0;
    this.playing = false;
    this.isUntouched = this.duration > 0; // until it plays or another moment is gone to
    this.rate = 1;
    this.saver = new Saver(this);
    this.link = new Link(() => this.base + this.elapsed);
    const hasHost = films.some((film) => film.driven);
    this.options = { follows: hasHost, rays: true, names: !hasHost, palette: presentPalette(), topMps: topSpeed(films) };
    this._build();
    const has = {
      decisions: films.some((film) => film.driven?.decisions.length),
      marks: films.some((film) => film.driven?.marks.length),
      rays: hasHost,
      recorder: canRecord(),
    };
    listen((name, value) => this.act(name, value), has);
    this._watch();
  }

  _build() {
    const { films, head } = this;
    const app = byId("app");
    app.hidden = false;
    byId("message").hidden = true;
    app.classList.toggle("two", films.length > 1);
    byId("title").textContent = head.title;
    fillList(byId("about").querySelector("dl"), head.about);
    byId("about").hidden = !Object.keys(head.about).length;
    const leftOut = films.map((film) => film.leftOut).filter(Boolean);
    byId("left-out").hidden = !leftOut.length;
    byId("left-out").textContent = [...new Set(leftOut)].join(" ");
    byId("difference").hidden = films.length < 2;
    this.difference = films.length > 1 ? new Difference(byId("difference"), films) : null;
    const road = () => new Road(this.ground); // each keeps a picture of its own view
    this.stages = films.map((film, number) => this._stage(film, number, road()));
    this.timeline = new Timeline(byId("track"), byId("filters"), this);
    this.curves = new Curves(byId("curves"), this);
  }

  _stage(film, number, road) {
    const figure = byId("stage-template").content.cloneNode(true).firstElementChild;
    const view = document.createElement("div");
    view.className = "view";
    view.append(...figure.children);
    figure.append(view);
    const name = this.films.length > 1 ? `${"AB"[number]}  ${film.name}` : film.name;
    figure.querySelector("figcaption").textContent = name;
    figure.querySelector("canvas").setAttribute("aria-label", `The road from above: ${film.name}`);
    figure.querySelector(".legend .top").textContent = `${(this.options.topMps * KMH).toFixed(0)} km/h`;
    byId("stages").append(figure);
    const endLabel = `Ended at ${clock(this.base + durationOf(film), { long: this.long })}`;
    const stage = new Stage(view, film, road, this.options, endLabel, (change) => this._moved(change));
    const card = byId("card-template").content.cloneNode(true).firstElementChild;
    (this.films.length > 1 ? figure : byId("cards")).append(card);
    stage.card = new Card(card, stage, this.head.actions, this);
    return stage;
  }

  /** Draw the first picture, then what takes longer. */
  start() {
    const linked = linkedMoment(location.hash);
    if (linked !== null) this.elapsed = this._within(linked - this.base);
    this.curves.build(); // before the stages are measured: they are given what is left
    this._lay();
    this._showControls();
    this.draw();
    this.firstFrameMs = performance.now();
  }

  /** Fit everything to the page's size. */
  _lay() {
    for (const stage of this.stages) {
      stage.resize();
      if (!stage.isMoved) stage.reset();
    }
    this.timeline.place();
    byId("playhead").style.top = `${byId("track").offsetTop}px`;
  }

  chosen() {
    return this.stages.map((stage) => stage.target);
  }

  refiltered() {
    this.invalidate();
  }

  act(name, value) {
    const actions = {
      toggle: () => this._toggle(value),
      rate: () => (this.rate = value),
      decision: () => this._jump(momentsOf(this.films, (film) => film.driven?.decisions ?? []), value),
      mark: () => this._jumpToMark(value),
      skip: () => this.seek(this.elapsed + value),
      seek: () => this.seek(value),
      zoom: () => this._moved({ stage: this.stages[0], zoom: value }),
      whole: () => this._whole(),
      picture: () => this.saver.picture(),
      record: () => this._record(),
      theme: () => this._switchTheme(),
      help: () => (byId("keys").open ? byId("keys").close() : byId("keys").showModal()),
    };
    actions[name]();
    this._showControls();
    this.invalidate();
  }

  seek(elapsed) {
    if (this.isUntouched) this._touch();
    this.elapsed = this._within(elapsed);
    this.invalidate();
    this.link.follow();
  }

  _touch() {
    this.isUntouched = false;
    this._showControls();
  }

  _within(elapsed) {
    return Math.min(Math.max(elapsed, 0), this.duration);
  }

  _toggle(what) {
    if (what === "playing") {
      this.playing = !this.playing;
      this.isUntouched = false;
      if (this.playing && this.elapsed >= this.duration) this.elapsed = 0;
      this.before = null;
      if (!this.playing) this.link.follow();
    } else if (what === "follows") {
      this.options.follows = !this.options.follows;
      if (this.options.follows) this.stages.forEach((stage) => (stage.target ??= stage.host));
    } else this.options[what] = !this.options[what];
  }

  _jump(moments, direction) {
    const moment = neighbour(moments, this.elapsed, direction);
    if (moment === null) return;
    this.playing = false;
    this.seek(moment);
  }

  _jumpToMark(direction) {
    this._jump(momentsOf(this.films, (film) => film.driven?.marks ?? [], (mark) => !this.hidden.has(mark.kind)), direction);
    const here = this.films.flatMap((film) =>
      (film.driven?.marks ?? []).filter((mark) => Math.abs(mark.frame * film.stepS - this.elapsed) < 1e-3),
    );
    byId("status").textContent = here.map((mark) => [MARKS[mark.kind].label, mark.text].filter(Boolean).join(": ")).join("; ");
  }

  _whole() {
    this.options.follows = false;
    for (const stage of this.stages) stage.showAll();
  }

  /** A finger or a mouse has moved a view, or chosen somebody. Two films are looked at alike. */
  _moved({ stage, zoom, left, top, pan, chosen }) {
    for (const other of this.stages) other.isMoved = true;
    if (chosen !== undefined) {
      if (chosen === null) return;
      stage.target = chosen;
      this.options.follows = true;
      this.curves.build();
    }
    if (pan) {
      if (this.options.follows && !zoom) this.options.follows = false;
      if (!this.options.follows) {
        const { camera } = stage;
        for (const other of this.stages) {
          other.camera.x -= pan[0] / camera.scale;
          other.camera.y += pan[1] / camera.scale;
        }
      }
    }
    if (zoom) for (const other of this.stages) other.zoom(zoom, left, top);
    this._showControls();
    this.invalidate();
  }

  invalidate() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame((now) => {
      this.waiting = false;
      this._advance(now);
      this.draw();
      if (this.playing) this.invalidate();
    });
  }

  _advance(now) {
    if (!this.playing) return;
    if (this.before !== null) {
      const step = Math.min((now - this.before) / 1000, LONGEST_STEP_S);
      this.elapsed = this._within(this.elapsed + step * this.rate);
      this.link.follow();
    }
    this.before = now;
    if (this.elapsed < this.duration) return;
    this.playing = false;
    this.saver.stop();
    this._showControls();
  }

  draw() {
    const { elapsed } = this;
    for (const stage of this.stages) {
      stage.draw(elapsed);
      stage.card.show(elapsed);
    }
    this.timeline.show(elapsed);
    const share = this.duration ? elapsed / this.duration : 0;
    byId("playhead").style.transform = `translateX(${(share * byId("track").clientWidth).toFixed(2)}px)`;
    this._showClock();
    this.difference?.show(elapsed);
    this.saver.drawn();
  }

  _showClock() {
    const text = clock(this.base + this.elapsed, { long: this.long });
    if (text === this.clockText) return;
    this.clockText = text;
    const of = document.createElement("small");
    of.textContent = ` of ${clock(this.base + this.duration, { long: this.long })}`;
    byId("clock").replaceChildren(text, of);
    byId("simulation").hidden = !this.begins.length;
    byId("simulation").textContent = `simulation ${this.begins.map((startS) => clock(startS + this.elapsed)).join(" and ")}`;
  }

  _showControls() {
    byId("app").classList.toggle("playing", this.playing);
    byId("app").classList.toggle("untouched", this.isUntouched);
    byId("play").setAttribute("aria-label", this.playing ? "Pause (Space)" : "Play (Space)");
    for (const [id, on] of [["follow", this.options.follows], ["rays", this.options.rays], ["names", this.options.names], ["record", this.saver.isRecording]]) {
      byId(id).setAttribute("aria-pressed", String(on));
    }
    byId("record").textContent = this.saver.isRecording ? "Stop" : "WebM";
    byId("rate").value = String(this.rate);
  }

  _record() {
    if (this.saver.isRecording) {
      this.saver.stop();
      return;
    }
    this.saver.record();
    if (!this.playing) this._toggle("playing");
  }

  _switchTheme() {
    switchTheme();
    this._readTheme();
  }

  _readTheme() {
    this.options.palette = presentPalette();
    this.curves.build();
  }

  _watch() {
    watchTheme(() => {
      this._readTheme();
      this.invalidate();
    });
    addEventListener("hashchange", () => {
      const linked = linkedMoment(location.hash);
      if (linked === null) return;
      this.playing = false;
      this.elapsed = this._within(linked - this.base);
      this._touch();
      this.invalidate();
    });
    new ResizeObserver(() => {
      this.curves.resize();
      this._lay();
      this.draw();
    }).observe(byId("stages"));
  }

  /** What is on screen, for tests and the curious. */
  state() {
    return {
      elapsed: this.elapsed,
      clock: this.base + this.elapsed,
      playing: this.playing,
      rate: this.rate,
      follows: this.options.follows,
      rays: this.options.rays,
      names: this.options.names,
      hiddenKinds: [...this.hidden],
      recording: this.saver.isRecording,
      firstFrameMs: this.firstFrameMs,
      views: this.stages.map(({ camera, target, seen, sensed, ended }) => ({
        x: camera.x,
        y: camera.y,
        scale: camera.scale,
        target,
        drawn: seen.length,
        sensed: sensed.size,
        ended,
      })),
    };
  }
}

/** What the speeds' colours end at: a round number that nearly everybody stays below. */
function topSpeed(films) {
  let top = 0;
  for (const film of films) {
    const sorted = Int32Array.from({ length: Math.min(film.speed.length, 20_000) }, (_, k) => film.speed[Math.floor((k * film.speed.length) / Math.min(film.speed.length, 20_000))]).sort();
    if (sorted.length) top = Math.max(top, sorted[Math.floor(0.99 * (sorted.length - 1))] * film.quanta.speed_mps);
  }
  return Math.max(Math.ceil((top * KMH) / 10) * 10, 30) / KMH;
}

function fillList(list, entries) {
  for (const [name, value] of Object.entries(entries)) {
    const [term, description] = [document.createElement("dt"), document.createElement("dd")];
    term.textContent = name;
    description.textContent = value;
    list.append(term, description);
  }
}

async function begin() {
  try {
    if (typeof DecompressionStream === "undefined") {
      throw new Unfit("this browser cannot unpack it; any of 2023 or later will do");
    }
    const page = new Page(await unpack());
    page.start();
    window.replay = page;
  } catch (error) {
    byId("app").hidden = true;
    byId("message").hidden = false;
    byId("message").textContent = `The film cannot be shown: ${error instanceof Unfit ? error.message : "its data are damaged"}.`;
    console.warn(error);
  }
}

begin();
