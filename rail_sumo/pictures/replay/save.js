// The view as a picture (PNG) or, while it plays, as a film (WebM).

import { clock, kmh } from "./words.js";
import { frameAt, hasEnded } from "./timeline.js";
import { poseOf } from "./motion.js";

const CAPTION_PX = 30;
const FILM_FPS = 30;
const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];

export function canRecord() {
  return typeof MediaRecorder !== "undefined" && typeof HTMLCanvasElement.prototype.captureStream === "function";
}

/** Draw all stages side by side onto a canvas, with a line below that says who, when and how fast. */
function compose(canvas, stages, captions, palette) {
  const ratio = stages[0].camera.ratio;
  const tallest = Math.max(...stages.map((stage) => stage.canvas.height));
  const width = stages.reduce((sum, stage) => sum + stage.canvas.width, 0);
  const height = tallest + Math.round(CAPTION_PX * ratio);
  const [evenWidth, evenHeight] = [width + (width % 2), height + (height % 2)]; // encoders want even sizes
  if (canvas.width !== evenWidth) canvas.width = evenWidth;
  if (canvas.height !== evenHeight) canvas.height = evenHeight;
  const context = canvas.getContext("2d", { alpha: false });
  context.fillStyle = palette.ground;
  context.fillRect(0, 0, evenWidth, evenHeight);
  context.fillStyle = palette.ink;
  context.font = `${13 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  let left = 0;
  stages.forEach((stage, number) => {
    context.drawImage(stage.canvas, left, 0);
    context.fillText(captions[number], left + 14 * ratio, tallest + (CAPTION_PX * ratio) / 2, stage.canvas.width - 28 * ratio);
    left += stage.canvas.width;
  });
  return canvas;
}

function offer(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Record a canvas from now on; `finished` is given the film once `stop` was called. */
function recorderOf(canvas, finished) {
  const mimeType = FORMATS.find((format) => MediaRecorder.isTypeSupported(format));
  const recorder = new MediaRecorder(canvas.captureStream(FILM_FPS), { mimeType, videoBitsPerSecond: 8_000_000 });
  const parts = [];
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  recorder.addEventListener("stop", () => finished(new Blob(parts, { type: "video/webm" })));
  recorder.start(1000);
  return recorder;
}

export class Saver {
  /** `page` has head, films, stages, options, base, long and elapsed. */
  constructor(page) {
    this.page = page;
    this.canvas = document.createElement("canvas");
    this.recorder = null;
  }

  get isRecording() {
    return this.recorder !== null;
  }

  picture() {
    const name = this._fileName("png");
    this._compose().toBlob((blob) => offer(blob, name), "image/png");
  }

  record() {
    const name = this._fileName("webm");
    this.recorder = recorderOf(this._compose(), (blob) => offer(blob, name));
  }

  stop() {
    this.recorder?.stop();
    this.recorder = null;
  }

  /** The view was drawn: while recording, it goes into the film. */
  drawn() {
    if (this.isRecording) this._compose();
  }

  _compose() {
    const { films, stages, options } = this.page;
    return compose(this.canvas, stages, films.map((film, number) => this._caption(film, stages[number])), options.palette);
  }

  _caption(film, stage) {
    const { base, elapsed, long } = this.page;
    const pose = hasEnded(film, elapsed) ? null : poseOf(film, stage.target, frameAt(film, elapsed));
    return [film.name, clock(base + elapsed, { long }), pose && kmh(pose.speed)].filter(Boolean).join("   ");
  }

  _fileName(suffix) {
    const { base, elapsed, head } = this.page;
    const plain = head.title.normalize("NFKD").replace(/[^\w-]+/g, "-").replace(/^-+|-+$/g, "") || "replay";
    return `${plain}-${(base + elapsed).toFixed(1)}s.${suffix}`;
  }
}
