// The view as a picture (PNG) or, while it plays, as a film (WebM).

const CAPTION_PX = 30;
const FILM_FPS = 30;
const FORMATS = ["video/webm;codecs=vp9", "video/webm;codecs=vp8", "video/webm"];

export function canRecord() {
  return typeof MediaRecorder !== "undefined" && typeof HTMLCanvasElement.prototype.captureStream === "function";
}

/** Draw all stages side by side onto a canvas, with a line below that says who, when and how fast. */
export function compose(canvas, stages, captions, palette) {
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

export function offer(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

export function savePicture(canvas, name) {
  canvas.toBlob((blob) => offer(blob, name), "image/png");
}

/** Record a canvas from now on; `finished` is given the film once `stop` was called. */
export function recorderOf(canvas, finished) {
  const mimeType = FORMATS.find((format) => MediaRecorder.isTypeSupported(format));
  const recorder = new MediaRecorder(canvas.captureStream(FILM_FPS), { mimeType, videoBitsPerSecond: 8_000_000 });
  const parts = [];
  recorder.addEventListener("dataavailable", (event) => parts.push(event.data));
  recorder.addEventListener("stop", () => finished(new Blob(parts, { type: "video/webm" })));
  recorder.start(1000);
  return recorder;
}
