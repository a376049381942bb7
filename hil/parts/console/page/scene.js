// Three-dimensional view: rails, turntable, chaser, target ring, corridor and path.

import { prepare } from "/page/chart.js";
import { apply, applyBack, matrix, norm, plus } from "/page/space.js";

const X = "#e69f00", Y = "#56b4e9", Z = "#cc79a7", WHITE = "#f4f6f8", DIM = "#3a4654", TARGET = "#009e73";
const TURN = 0.08;

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.azimuth = -1.05;
    this.elevation = 0.42;
    this.span = 0;
    canvas.addEventListener("keydown", (event) => {
      const turn = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] }[event.key];
      if (!turn) return;
      event.preventDefault();
      event.stopPropagation();
      this.turn(...turn);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons & 1) this.turn(event.movementX * 0.01, event.movementY * 0.01);
    });
  }

  turn(azimuth, elevation) {
    this.azimuth += azimuth;
    this.elevation = Math.min(1.5, Math.max(-0.2, this.elevation + elevation));
  }

  // pose: {r, q, rail}; unknown parts are omitted
  draw(bench, pose, store, stale) {
    const [c, width, height] = prepare(this.canvas);
    if (!bench || !bench.axes) return;
    const r = pose ? pose.r : bench.start_m;
    const wanted = Math.max(0.7, 1.15 * norm(r) + 0.35);
    this.span = this.span ? this.span + 0.1 * (wanted - this.span) : wanted;
    this.centre = plus([0, 0, 0], r, 0.5);
    this.project = this.camera(width, height);
    this.c = c;
    this.rails(bench, pose);
    this.corridor(bench);
    this.ring(bench);
    this.way(store);
    if (pose) this.chaser(bench, pose, stale);
    this.frame([0, 0, 0], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], 0.12 * this.span, 1);
    c.fillStyle = "#a9b4c0";
    c.font = '12px "DejaVu Sans", sans-serif';
    c.textBaseline = "top";
    c.textAlign = "left";
    c.fillText("target: ring, axes x y z of H", 6, 4);
  }

  // z of H points downwards, as in the view
  camera(width, height) {
    const ca = Math.cos(this.azimuth), sa = Math.sin(this.azimuth), ce = Math.cos(this.elevation), se = Math.sin(this.elevation);
    const distance = 2.6 * this.span, focal = 2.4 * Math.min(width * 0.62, height);
    return (p) => {
      const [x, y, z] = plus(p, this.centre, -1);
      const side = -sa * x + ca * y, ahead = ca * x + sa * y;
      const depth = distance - (ce * ahead - se * z);
      const up = -(se * ahead + ce * z);
      return [width / 2 + (focal * side) / Math.max(depth, 0.1), height * 0.52 - (focal * up) / Math.max(depth, 0.1)];
    };
  }

  path(points, color, width = 1, dash = []) {
    const c = this.c;
    c.beginPath();
    points.forEach((p, i) => c[i ? "lineTo" : "moveTo"](...this.project(p)));
    c.strokeStyle = color;
    c.lineWidth = width;
    c.setLineDash(dash);
    c.stroke();
    c.setLineDash([]);
  }

  rails(bench, pose) {
    const [x0, x1] = bench.axes["rails.x"], [y0, y1] = bench.axes["rails.y"], [z0, z1] = bench.axes["rails.z"];
    for (const y of [y0, y1]) this.path([[x0, y, z1], [x1, y, z1]], DIM, 2);
    for (const x of [x0, x1]) this.path([[x, y0, z1], [x, y1, z1]], DIM, 1);
    for (const [y, z] of [[y0, z0], [y1, z0]]) this.path([[x0, y, z], [x1, y, z]], DIM, 1, [2, 4]);
    if (!pose || !pose.rail) return;
    const [x, y, z] = pose.rail;
    this.path([[x, y0, z1], [x, y1, z1]], "#7d8b99", 3);
    this.path([[x, y, z1], [x, y, z]], "#7d8b99", 4);
  }

  corridor(bench) {
    const { axis, half_angle_deg, minimum_radius_m } = bench.corridor;
    const tan = Math.tan((half_angle_deg * Math.PI) / 180), length = this.span;
    const side = Math.abs(axis[2]) < 0.9 ? [0, 0, 1] : [0, 1, 0];
    const u = cross(axis, side).map((v, _, all) => v / norm(all)), w = cross(axis, u);
    const at = (along, turn) => {
      const radius = Math.max(minimum_radius_m, along * tan);
      return axis.map((v, i) => v * along + radius * (u[i] * Math.cos(turn) + w[i] * Math.sin(turn)));
    };
    for (let k = 0; k < 4; k++) {
      const turn = Math.PI / 4 + (k * Math.PI) / 2;
      this.path([at(0, turn), at(Math.min(length, minimum_radius_m / tan), turn), at(length, turn)], "#8a7a2a", 1, [4, 4]);
    }
    const p = bench.ready_point_m, s = 0.02 * this.span;
    this.path([plus(p, [0, s, 0]), plus(p, [0, -s, 0])], "#f0e442", 2);
    this.path([plus(p, [0, 0, s]), plus(p, [0, 0, -s])], "#f0e442", 2);
  }

  ring(bench) {
    const lamps = bench.ring_m.map((p) => plus(bench.ring_station_m, applyBack(bench.ring_axes, p)));
    this.path([...lamps, lamps[0]], TARGET, 2);
    this.c.fillStyle = TARGET;
    for (const lamp of lamps) {
      const [x, y] = this.project(lamp);
      this.c.fillRect(x - 2, y - 2, 4, 4);
    }
  }

  way(store) {
    const step = Math.max(1, store.count >> 8), points = [];
    for (let row = 0; row < store.count; row += step) {
      const p = ["x", "y", "z"].map((axis) => store.at(row, `bench_m.${axis}`));
      if (p.every(Number.isFinite)) points.push(p);
    }
    if (points.length > 1) this.path(points, "#56b4e9", 1.5);
  }

  chaser(bench, pose, stale) {
    const a = matrix(pose.q), at = (p) => plus(pose.r, applyBack(a, p));
    const size = 0.05 * this.span, color = stale ? "#6d7884" : WHITE;
    const corner = (i) => at([i & 1 ? 0 : 2 * size, i & 2 ? size : -size, i & 4 ? size : -size]);
    for (const [i, j] of [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]]) {
      this.path([corner(i), corner(j)], color, 1.5);
    }
    this.path([at(bench.camera_station_m), [0, 0, 0]], "#56606c", 1, [2, 5]);
    if (!stale) this.frame(pose.r, a, 0.16 * this.span, 2.5);
  }

  // axes: rows are the unit vectors of the frame, in H
  frame(origin, axes, length, width) {
    [X, Y, Z].forEach((color, i) => {
      const end = plus(origin, axes[i], length);
      this.path([origin, end], color, width);
      this.c.fillStyle = color;
      this.c.font = '700 11px "DejaVu Sans", sans-serif';
      this.c.textBaseline = "middle";
      this.c.fillText("xyz"[i], ...this.project(plus(origin, axes[i], 1.15 * length)));
    });
  }
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

// LEDs in the image of a camera of the vision unit, in pixels, computed from the pose of the bench.
export function ledsInView(bench, pose) {
  const { focal_px, width_px, height_px } = bench.camera;
  const a = matrix(pose.q);
  return bench.ring_m.map((p) => {
    const h = plus(bench.ring_station_m, applyBack(bench.ring_axes, p));
    const seen = plus(apply(a, plus(h, pose.r, -1)), bench.camera_station_m, -1);
    const [x, y, z] = apply(bench.camera_axes, seen);
    return z > 0 ? [width_px / 2 + (focal_px * x) / z, height_px / 2 + (focal_px * y) / z] : null;
  });
}
