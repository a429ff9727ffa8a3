// One film's view: canvas, camera, and what fingers and mice do to it.

import { Camera } from "./camera.js";
import { boxOf } from "./road.js";
import { drawHits, drawNames, drawRays, drawSignals, drawVehicles, everybodyAt, hitsOf, seenFrom, vehicleAt } from "./vehicles.js";
import { frameAt, hasEnded } from "./timeline.js";
import { poseOf } from "./motion.js";

const STILL_PX = 5; // a press that moved less is a click
const SPARE_M = 30; // who is outside the view by less is drawn: part of it may be inside
const END_FADES = 0.55; // how much of the picture the ground's colour covers once the film has ended
const AHEAD_OF_HOST = 0.14; // of the view: there is more to see ahead than behind

export class Stage {
  /**
   * `options` is the page's: follows, rays, names, palette, topMps. `endLabel` is written over the film's last frame
   * once that is past. `changed` is called after the view was moved.
   */
  constructor(element, film, road, options, endLabel, changed) {
    this.element = element;
    this.canvas = element.querySelector("canvas");
    this.context = this.canvas.getContext("2d", { alpha: false });
    this.film = film;
    this.road = road;
    this.options = options;
    this.endLabel = endLabel;
    this.changed = changed;
    this.camera = new Camera();
    this.host = film.driven ? film.driven.vehicle : null;
    this.target = this.host; // whom the camera follows
    this.seen = [];
    this.sensed = new Set(); // on whom rays end
    this.ended = false; // whether the film's last frame is past
    this.isMoved = false; // until then the view is fitted anew when the page's size changes
    this.pointers = new Map();
    this._listen();
  }

  resize() {
    const { width, height } = this.element.getBoundingClientRect();
    const ratio = window.devicePixelRatio || 1;
    const { camera, canvas } = this;
    [camera.width, camera.height, camera.ratio] = [Math.max(width, 1), Math.max(height, 1), ratio];
    const [pixelsWide, pixelsHigh] = [Math.round(camera.width * ratio), Math.round(camera.height * ratio)];
    if (canvas.width !== pixelsWide) canvas.width = pixelsWide;
    if (canvas.height !== pixelsHigh) canvas.height = pixelsHigh;
  }

  /** The first view: about 140 m around the host, or everything. */
  reset() {
    if (this.host === null) {
      this.camera.fit(this._everything());
      return;
    }
    this.camera.scale = Math.min(Math.max(this.camera.width / 140, 3), 9);
    const pose = this._firstPose();
    if (pose) [this.camera.x, this.camera.y] = [pose.x, pose.y];
  }

  _firstPose() {
    const { vehicle, row } = this.film.spans;
    const at = row[vehicle.indexOf(this.host)];
    const { position_m: unit } = this.film.quanta;
    return at === undefined ? null : { x: this.film.x[at] * unit, y: this.film.y[at] * unit };
  }

  /** Show the whole road. */
  showAll() {
    this.isMoved = true;
    this.camera.fit(this._everything());
  }

  _everything() {
    if (this.road.box) return this.road.box;
    if (!this.film.x.length) return { left: -50, right: 50, bottom: -50, top: 50 };
    const unit = this.film.quanta.position_m;
    const box = boxOf(this.film.x, this.film.y);
    return { left: box.left * unit, right: box.right * unit, bottom: box.bottom * unit, top: box.top * unit };
  }

  draw(elapsed) {
    const { camera, context, film, options } = this;
    const frame = frameAt(film, elapsed);
    const followed = this.target === null ? null : poseOf(film, this.target, frame);
    if (options.follows && followed) this._follow(followed);
    const { palette } = options;
    const everybody = everybodyAt(film, frame);
    const seen = seenFrom(everybody, camera.view(SPARE_M));
    const host = everybody.find((pose) => pose.vehicle === this.host);
    const hits = options.rays && host ? hitsOf(film, frame, host, everybody) : [];
    this.sensed = new Set(hits.filter((hit) => hit.on).map((hit) => hit.on.vehicle));
    const look = {
      palette,
      topMps: options.topMps,
      host: this.host,
      chosen: this.target === this.host ? null : this.target,
      sensed: this.sensed,
    };
    this.seen = seen;
    this.road.draw(context, camera, palette);
    context.setTransform(camera.ratio, 0, 0, camera.ratio, 0, 0);
    drawSignals(context, camera, film, this.road.stopLines, frame);
    if (host) drawRays(context, camera, palette, host, hits);
    drawVehicles(context, camera, seen, look);
    drawHits(context, camera, palette, hits);
    if (options.names) drawNames(context, camera, seen, look);
    this.ended = hasEnded(film, elapsed);
    if (this.ended) this._drawEnd();
    this._drawScale();
  }

  _drawEnd() {
    const { camera, context, endLabel } = this;
    const { palette } = this.options;
    context.fillStyle = palette.ground;
    context.globalAlpha = END_FADES;
    context.fillRect(0, 0, camera.width, camera.height);
    context.globalAlpha = 1;
    context.font = "600 14px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    const [middle, top, half] = [camera.width / 2, 0.28 * camera.height, context.measureText(endLabel).width / 2 + 10];
    context.fillStyle = palette.ink;
    context.fillRect(middle - half, top - 14, 2 * half, 28);
    context.fillStyle = palette.ground;
    context.fillText(endLabel, middle, top);
  }

  _follow(pose) {
    const { camera } = this;
    const reach = (AHEAD_OF_HOST * Math.min(camera.width, 2 * camera.height)) / camera.scale;
    camera.x = pose.x + (this.target === this.host ? reach * Math.cos(pose.heading) : 0);
    camera.y = pose.y + (this.target === this.host ? reach * Math.sin(pose.heading) : 0);
  }

  _drawScale() {
    const { camera, context } = this;
    const most = Math.min(140, 0.3 * camera.width) / camera.scale;
    const ten = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].find((times) => times * ten <= most) * ten;
    const [left, bottom, length] = [16, camera.height - 16, metres * camera.scale];
    context.fillStyle = this.options.palette.paper;
    context.fillRect(left - 6, bottom - 20, length + 12, 27);
    context.strokeStyle = this.options.palette.ink;
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(left, bottom - 4);
    context.lineTo(left, bottom);
    context.lineTo(left + length, bottom);
    context.lineTo(left + length, bottom - 4);
    context.stroke();
    context.fillStyle = this.options.palette.ink;
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "left";
    context.textBaseline = "bottom";
    context.fillText(metres >= 1000 ? `${metres / 1000} km` : `${metres} m`, left, bottom - 4);
  }

  zoom(factor, left, top) {
    if (this.options.follows && this.target !== null) this.camera.zoom(factor); // around whom it follows
    else this.camera.zoom(factor, left, top);
  }

  _listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => this._press(event));
    canvas.addEventListener("pointermove", (event) => this._move(event));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => this._release(event));
    canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        const lines = event.deltaMode === 1 ? 16 : 1;
        const [left, top] = this._place(event);
        this.changed({ stage: this, zoom: Math.exp(-event.deltaY * lines * 0.0016), left, top });
      },
      { passive: false },
    );
  }

  _place(event) {
    const box = this.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  _press(event) {
    if (event.button > 0) return;
    this.canvas.setPointerCapture(event.pointerId);
    const [left, top] = this._place(event);
    this.pointers.set(event.pointerId, { left, top });
    this.moved = this.pointers.size > 1 ? STILL_PX : 0;
  }

  _move(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const [left, top] = this._place(event);
    const before = this._spread();
    this.moved += Math.hypot(left - pointer.left, top - pointer.top);
    const pan = [(left - pointer.left) / this.pointers.size, (top - pointer.top) / this.pointers.size];
    this.pointers.set(event.pointerId, { left, top });
    const after = this._spread();
    if (before && after) {
      this.changed({ stage: this, zoom: after.distance / Math.max(before.distance, 1), left: after.left, top: after.top, pan });
    } else if (this.moved >= STILL_PX) this.changed({ stage: this, pan });
  }

  _release(event) {
    if (!this.pointers.delete(event.pointerId) || event.type === "pointercancel" || this.moved >= STILL_PX) return;
    const [left, top] = this._place(event);
    this.changed({ stage: this, chosen: vehicleAt(this.camera, this.seen, left, top) });
  }

  _spread() {
    if (this.pointers.size < 2) return null;
    const [one, other] = [...this.pointers.values()];
    return {
      distance: Math.hypot(one.left - other.left, one.top - other.top),
      left: (one.left + other.left) / 2,
      top: (one.top + other.top) / 2,
    };
  }
}
