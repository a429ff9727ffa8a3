// Draws the ground: once into a picture wider than the view, which is then moved along until the view leaves it.

const MARGIN = 0.35; // of the view's width and height, on each side
const DETAILED = 1.2; // pixels a metre, from which markings are drawn
const DASH_M = [3, 5];

/** A line beside another, to its left where metres are positive. */
export function beside(x, y, metres) {
  const [shiftedX, shiftedY] = [new Float64Array(x.length), new Float64Array(x.length)];
  for (let k = 0; k < x.length; k += 1) {
    const before = direction(x, y, Math.max(k - 1, 0));
    const after = direction(x, y, Math.min(k, x.length - 2));
    const [normalX, normalY] = [-(before[1] + after[1]), before[0] + after[0]];
    const squared = Math.max(normalX * normalX + normalY * normalY, 1); // sharp bends are cut
    shiftedX[k] = x[k] + (2 * metres * normalX) / squared;
    shiftedY[k] = y[k] + (2 * metres * normalY) / squared;
  }
  return { x: shiftedX, y: shiftedY };
}

function direction(x, y, k) {
  const [dx, dy] = [x[k + 1] - x[k], y[k + 1] - y[k]];
  const length = Math.hypot(dx, dy) || 1;
  return [dx / length, dy / length];
}

/** The box around points, as the camera's views are. */
export function boxOf(x, y) {
  const box = { left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity };
  for (let k = 0; k < x.length; k += 1) {
    box.left = Math.min(box.left, x[k]);
    box.right = Math.max(box.right, x[k]);
    box.bottom = Math.min(box.bottom, y[k]);
    box.top = Math.max(box.top, y[k]);
  }
  return box;
}

function around(one, other) {
  return {
    left: Math.min(one.left, other.left),
    right: Math.max(one.right, other.right),
    bottom: Math.min(one.bottom, other.bottom),
    top: Math.max(one.top, other.top),
  };
}

function meet(one, other) {
  return one.left <= other.right && one.right >= other.left && one.bottom <= other.top && one.top >= other.bottom;
}

function trace(path, { x, y }) {
  for (let k = 0; k < x.length; k += 1) {
    if (k) path.lineTo(x[k], y[k]);
    else path.moveTo(x[k], y[k]);
  }
}

function line(shape) {
  const path = new Path2D();
  trace(path, shape);
  return path;
}

export class Road {
  constructor(ground) {
    // SUMO calls left what is away from the kerb, on either kind of road.
    this.leftwards = ground.isLeftHand ? -1 : 1;
    this.stopLines = ground.stopLines;
    this.lanes = ground.lanes.filter((lane) => lane.x.length > 1).map((lane) => ({ ...lane, box: boxOf(lane.x, lane.y) }));
    this.junctions = ground.junctions.map((area) => ({ ...area, box: boxOf(area.x, area.y) }));
    this.box = [...this.lanes, ...this.junctions].reduce((whole, { box }) => (whole ? around(whole, box) : box), null);
    const outermost = new Map();
    for (const lane of this.lanes) {
      const { edge, index } = placeOf(lane.id);
      outermost.set(edge, Math.max(outermost.get(edge) ?? 0, index));
    }
    for (const lane of this.lanes) {
      const { edge, index } = placeOf(lane.id);
      lane.isRightmost = index === 0;
      lane.isLeftmost = index === outermost.get(edge);
    }
    this.picture = document.createElement("canvas");
    this.drawn = null; // where the picture lies, and what it was drawn with
  }

  /** Draw what is in view, with the canvas's transformation left at the device's pixels. */
  draw(context, camera, palette) {
    const unit = camera.scale * camera.ratio;
    const [middleX, middleY] = camera.middle;
    const [width, height] = [context.canvas.width, context.canvas.height];
    const [spareX, spareY] = [Math.ceil(width * MARGIN), Math.ceil(height * MARGIN)];
    let shift = this.drawn && this._shift(middleX, middleY, unit);
    const stale =
      !shift ||
      this.drawn.unit !== unit ||
      this.drawn.palette !== palette ||
      this.drawn.width !== width ||
      this.drawn.height !== height ||
      Math.abs(shift[0]) > spareX ||
      Math.abs(shift[1]) > spareY;
    if (stale) {
      this.drawn = { middleX, middleY, unit, palette, width, height };
      this._paint(width + 2 * spareX, height + 2 * spareY);
      shift = [0, 0];
    }
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.drawImage(this.picture, -spareX - shift[0], -spareY + shift[1]);
  }

  _shift(middleX, middleY, unit) {
    return [Math.round((middleX - this.drawn.middleX) * unit), Math.round((middleY - this.drawn.middleY) * unit)];
  }

  _paint(width, height) {
    const { picture, drawn } = this;
    const { unit, palette, middleX, middleY } = drawn;
    if (picture.width !== width || picture.height !== height) [picture.width, picture.height] = [width, height];
    const context = picture.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = palette.ground;
    context.fillRect(0, 0, width, height);
    context.setTransform(unit, 0, 0, -unit, width / 2 - middleX * unit, height / 2 + middleY * unit);
    const [halfX, halfY] = [width / 2 / unit + 5, height / 2 / unit + 5];
    const view = { left: middleX - halfX, right: middleX + halfX, bottom: middleY - halfY, top: middleY + halfY };
    const lanes = this.lanes.filter((lane) => meet(lane.box, view));
    const areas = this.junctions.filter((area) => meet(area.box, view));
    context.lineJoin = "round";
    context.lineCap = "butt";
    this._paintAsphalt(context, lanes, areas);
    if (unit >= DETAILED) this._paintLines(context, lanes);
  }

  _paintAsphalt(context, lanes, areas) {
    const { palette, unit } = this.drawn;
    const all = new Path2D();
    for (const area of areas) {
      trace(all, area);
      all.closePath();
    }
    context.fillStyle = palette.asphalt;
    context.fill(all);
    const thinnest = 1.4 / unit;
    const batches = new Map(); // one stroke for all lanes that look alike
    for (const lane of lanes) {
      if (lane.isInside && unit < 0.3) continue;
      const colour = lane.isOpen ? palette.asphalt : palette.closed;
      const key = `${colour} ${Math.max(lane.widthM + 0.06, thinnest)}`;
      if (!batches.has(key)) batches.set(key, { colour, width: Math.max(lane.widthM + 0.06, thinnest), path: new Path2D() });
      trace(batches.get(key).path, lane);
    }
    for (const { colour, width, path } of batches.values()) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.stroke(path);
    }
  }

  _paintLines(context, lanes) {
    const { palette, unit } = this.drawn;
    context.lineWidth = Math.max(0.15, 1 / unit);
    context.strokeStyle = palette.marking;
    for (const lane of lanes) {
      if (lane.leftLine === "none" || lane.isLeftmost) continue;
      context.setLineDash(lane.leftLine === "dashed" ? DASH_M : []);
      context.stroke(this._side(lane, 1));
    }
    context.setLineDash([]);
    context.lineWidth = Math.max(0.22, 1 / unit);
    context.strokeStyle = palette.border;
    for (const lane of lanes) {
      if (lane.isInside) continue;
      if (lane.isRightmost) context.stroke(this._side(lane, -1));
      if (lane.isLeftmost) context.stroke(this._side(lane, 1));
    }
  }

  _side(lane, side) {
    const name = side > 0 ? "leftPath" : "rightPath";
    lane[name] ??= line(beside(lane.x, lane.y, (side * this.leftwards * lane.widthM) / 2));
    return lane[name];
  }
}

function placeOf(laneId) {
  const at = laneId.lastIndexOf("_");
  return { edge: laneId.slice(0, at), index: Number(laneId.slice(at + 1)) };
}
