// From metres, y upwards, to pixels of the page, y downwards.

export const CLOSEST = 40; // pixels a metre
export const FARTHEST = 0.002;

export class Camera {
  constructor() {
    this.x = 0; // what the middle of the view shows
    this.y = 0;
    this.scale = 6; // pixels a metre
    this.width = 1;
    this.height = 1;
    this.ratio = 1; // device pixels a pixel
  }

  /** The middle that is drawn: on a whole device pixel, so that the road's picture may be moved instead of redrawn. */
  get middle() {
    const unit = this.scale * this.ratio;
    return [Math.round(this.x * unit) / unit, Math.round(this.y * unit) / unit];
  }

  toScreen(x, y) {
    const [middleX, middleY] = this.middle;
    return [this.width / 2 + (x - middleX) * this.scale, this.height / 2 - (y - middleY) * this.scale];
  }

  toWorld(left, top) {
    const [middleX, middleY] = this.middle;
    return [middleX + (left - this.width / 2) / this.scale, middleY - (top - this.height / 2) / this.scale];
  }

  /** Zoom by a factor; what lies under the given place stays there. */
  zoom(factor, left = this.width / 2, top = this.height / 2) {
    const scale = Math.min(Math.max(this.scale * factor, FARTHEST), CLOSEST);
    const [awayX, awayY] = [(left - this.width / 2) / this.scale, (top - this.height / 2) / this.scale];
    const kept = 1 - this.scale / scale;
    this.x += awayX * kept;
    this.y -= awayY * kept;
    this.scale = scale;
  }

  /** Show a box of metres as a whole. */
  fit({ left, right, bottom, top }, margin = 0.06) {
    this.x = (left + right) / 2;
    this.y = (bottom + top) / 2;
    const room = 1 - 2 * margin;
    const scale = Math.min((room * this.width) / Math.max(right - left, 1), (room * this.height) / Math.max(top - bottom, 1));
    this.scale = Math.min(Math.max(scale, FARTHEST), 12);
  }

  /** The box that is in view, wider by some metres on each side. */
  view(more = 0) {
    const [halfX, halfY] = [this.width / 2 / this.scale + more, this.height / 2 / this.scale + more];
    const [x, y] = this.middle;
    return { left: x - halfX, right: x + halfX, bottom: y - halfY, top: y + halfY };
  }
}
