// A run seen from above, on a canvas: x to the right, y upward, a metre the same both ways.

const SPACE_M = 0.7;
/** A robot that is farther from where it was a moment ago was put there. */
const JUMP_M = 0.35;
const SMALLEST_PX = 1.3;

const colours = () => {
  const style = getComputedStyle(document.documentElement);
  const names = ["surface", "crop", "weed", "leaf", "litter", "bad", "path", "robot", "lidar", "line", "row", "muted"];
  return Object.fromEntries(names.map((name) => [name, style.getPropertyValue(`--${name}`).trim()]));
};

/** What has to be seen of a run \[m\]. */
function bounds({ field, poses }) {
  const points = [...field.crop, ...field.weeds, ...field.rows.flat(), ...poses];
  const box = { left: Infinity, right: -Infinity, bottom: Infinity, top: -Infinity };
  for (const [x, y] of points) {
    box.left = Math.min(box.left, x - SPACE_M);
    box.right = Math.max(box.right, x + SPACE_M);
    box.bottom = Math.min(box.bottom, y - SPACE_M);
    box.top = Math.max(box.top, y + SPACE_M);
  }
  return box;
}

/** The last index whose time is not after `time`, or -1. */
function lastUntil(list, time) {
  let [low, high] = [0, list.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (list[middle].time_s <= time) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** The pose at `time`, between two recorded ones. */
export function poseAt({ poses, step_s: step }, time) {
  const place = Math.min(time / step, poses.length - 1);
  const [i, part] = [Math.floor(place), place % 1];
  const [a, b] = [poses[i], poses[Math.min(i + 1, poses.length - 1)]];
  if (Math.hypot(b[0] - a[0], b[1] - a[1]) > JUMP_M) return a;
  return a.map((value, k) => value + part * (b[k] - value));
}

/** Distance driven until each pose \[m\]. */
export function distances({ poses }) {
  let sum = 0;
  return poses.map(([x, y], i) => {
    const moved = i > 0 ? Math.hypot(x - poses[i - 1][0], y - poses[i - 1][1]) : 0;
    sum += moved > JUMP_M ? 0 : moved;
    return sum;
  });
}

export class Scene {
  constructor(canvas, replay) {
    this.canvas = canvas;
    this.replay = replay;
    this.box = bounds(replay);
    this.follow = false;
    this.reach_m = 4;
    this.damaged = new Set(replay.field.damaged);
    this.shows = { lidar: true, lines: true, rows: true };
  }

  get aspect() {
    return (this.box.top - this.box.bottom) / (this.box.right - this.box.left);
  }

  /** Where the world is on the canvas. */
  aim([x, y]) {
    const [width, height] = [this.canvas.width, this.canvas.height];
    const { left, right, bottom, top } = this.box;
    const scale = this.follow
      ? Math.min(width, height * 1.6) / (2 * this.reach_m)
      : Math.min(width / (right - left), height / (top - bottom));
    const [centreX, centreY] = this.follow ? [x, y] : [(left + right) / 2, (bottom + top) / 2];
    this.scale = scale;
    this.px = (worldX) => width / 2 + (worldX - centreX) * scale;
    this.py = (worldY) => height / 2 - (worldY - centreY) * scale;
    const [halfX, halfY] = [width / 2 / scale + 0.5, height / 2 / scale + 0.5];
    this.visible = (worldX, worldY) => Math.abs(worldX - centreX) < halfX && Math.abs(worldY - centreY) < halfY;
  }

  draw(time) {
    const context = this.canvas.getContext("2d");
    const pose = poseAt(this.replay, time);
    this.colours = colours();
    this.dot = window.devicePixelRatio || 1;
    this.aim(pose);
    context.fillStyle = this.colours.surface;
    context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    context.lineCap = "round";
    context.lineJoin = "round";
    if (this.shows.rows) this.drawRows(context);
    this.drawField(context);
    this.drawPath(context, time);
    this.drawInterventions(context, time);
    this.drawScans(context, time);
    this.drawRobot(context, pose);
    this.drawMeasure(context);
  }

  stroke(context, colour, width) {
    context.strokeStyle = colour;
    context.lineWidth = width * this.dot;
    context.stroke();
  }

  drawRows(context) {
    context.beginPath();
    for (const row of this.replay.field.rows)
      row.forEach(([x, y], i) =>
        i === 0 ? context.moveTo(this.px(x), this.py(y)) : context.lineTo(this.px(x), this.py(y)),
      );
    context.setLineDash([4 * this.dot, 5 * this.dot]);
    this.stroke(context, this.colours.row, 1);
    context.setLineDash([]);
  }

  drawField(context) {
    const { field } = this.replay;
    const ribbons = (list, colour) => {
      context.beginPath();
      for (const [x1, y1, x2, y2] of list) {
        if (!this.visible(x1, y1)) continue;
        context.moveTo(this.px(x1), this.py(y1));
        context.lineTo(this.px(x2), this.py(y2));
      }
      this.stroke(context, colour, 1.5);
    };
    ribbons(field.litter, this.colours.litter);
    ribbons(field.leaves, this.colours.leaf);
    this.stems(context, field.weeds, this.colours.weed);
    this.stems(context, field.crop, this.colours.crop);
    this.stems(
      context,
      field.crop.filter((_, i) => this.damaged.has(i)),
      this.colours.bad,
      2,
    );
  }

  stems(context, list, colour, times = 1) {
    context.beginPath();
    for (const [x, y, radius] of list) {
      if (!this.visible(x, y)) continue;
      const size = times * Math.max(radius * this.scale, SMALLEST_PX * this.dot);
      context.moveTo(this.px(x) + size, this.py(y));
      context.arc(this.px(x), this.py(y), size, 0, 2 * Math.PI);
    }
    context.fillStyle = colour;
    context.fill();
  }

  drawPath(context, time) {
    const { poses, step_s: step } = this.replay;
    const last = Math.min(Math.floor(time / step), poses.length - 1);
    context.beginPath();
    for (let i = 0; i <= last; i += 1) {
      const [x, y] = poses[i];
      const jumped = i === 0 || Math.hypot(x - poses[i - 1][0], y - poses[i - 1][1]) > JUMP_M;
      if (jumped) context.moveTo(this.px(x), this.py(y));
      else context.lineTo(this.px(x), this.py(y));
    }
    this.stroke(context, this.colours.path, 2);
  }

  drawInterventions(context, time) {
    context.beginPath();
    for (const {
      time_s: when,
      at_m: [x, y],
    } of this.replay.interventions) {
      if (when > time) break;
      const [px, py, size] = [this.px(x), this.py(y), 5 * this.dot];
      context.moveTo(px - size, py - size);
      context.lineTo(px + size, py + size);
      context.moveTo(px + size, py - size);
      context.lineTo(px - size, py + size);
    }
    this.stroke(context, this.colours.bad, 2);
  }

  drawScans(context, time) {
    const { scans } = this.replay;
    const last = lastUntil(scans, time);
    for (let i = last; i >= 0 && scans[i].time_s === scans[last].time_s; i -= 1)
      this.drawScan(context, scans[i]);
  }

  drawScan(context, { world_from_lidar: [x, y, heading], points_cm: points, lines_cm: lines }) {
    const [sin, cos] = [Math.sin(heading) / 100, Math.cos(heading) / 100];
    const at = (u, v) => [this.px(x + cos * u - sin * v), this.py(y + sin * u + cos * v)];
    if (this.shows.lines) {
      context.beginPath();
      for (const [u1, v1, u2, v2] of lines) {
        context.moveTo(...at(u1, v1));
        context.lineTo(...at(u2, v2));
      }
      this.stroke(context, this.colours.line, 2.5);
    }
    if (!this.shows.lidar) return;
    context.fillStyle = this.colours.lidar;
    const size = 2.2 * this.dot;
    for (let i = 0; i + 1 < points.length; i += 2) {
      const [px, py] = at(points[i], points[i + 1]);
      context.fillRect(px - size / 2, py - size / 2, size, size);
    }
  }

  drawRobot(context, [x, y, heading]) {
    const [length, width] = this.replay.body_m.map((metres) => metres * this.scale);
    context.save();
    context.translate(this.px(x), this.py(y));
    context.rotate(-heading);
    context.beginPath();
    context.roundRect(-length / 2, -width / 2, length, width, Math.min(width / 4, 6 * this.dot));
    context.fillStyle = this.colours.robot;
    context.globalAlpha = 0.85;
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    context.moveTo(length / 2, 0);
    context.lineTo(length / 8, -width / 3);
    context.lineTo(length / 8, width / 3);
    context.closePath();
    context.fillStyle = this.colours.surface;
    context.fill();
    context.restore();
  }

  /** A metre, to compare with. */
  drawMeasure(context) {
    const metres = [0.5, 1, 2, 5, 10].find((length) => length * this.scale > 50 * this.dot) ?? 20;
    const [x, y, length] = [12 * this.dot, this.canvas.height - 12 * this.dot, metres * this.scale];
    context.globalAlpha = 0.85;
    context.fillStyle = this.colours.surface;
    context.fillRect(x - 6 * this.dot, y - 20 * this.dot, length + 12 * this.dot, 26 * this.dot);
    context.globalAlpha = 1;
    context.beginPath();
    context.moveTo(x, y - 4 * this.dot);
    context.lineTo(x, y);
    context.lineTo(x + length, y);
    context.lineTo(x + length, y - 4 * this.dot);
    this.stroke(context, this.colours.muted, 1.5);
    context.fillStyle = this.colours.muted;
    context.font = `${12 * this.dot}px system-ui, sans-serif`;
    context.fillText(`${metres} m`, x + 4 * this.dot, y - 6 * this.dot);
  }
}
