// The plots and their time window.

import { Chart, Firings, Lateness } from "/page/chart.js";

const GREEN = "#009e73";
const X = "#e69f00", Y = "#56b4e9", Z = "#cc79a7", WHITE = "#f4f6f8", YELLOW = "#f0e442";
const AXES = [["x", X], ["y", Y], ["z", Z]];
// largest term of the level that is nearest its limit, as in SUPERVISION
const TERMS = ["", "noise", "undetected fault", "age of the pose", "reopened gate", "second sensor"];
const WINDOWS_S = [Infinity, 120, 30];

const lines = (column, more = {}) => AXES.map(([axis, color]) => ({ name: axis, column: `${column}.${axis}`, color, ...more }));
const quiet = (column, more) => lines(column, more).map((series) => ({ ...series, name: "" }));

export class Plots {
  constructor(where) {
    this.where = where;
    this.window = 0;
    this.axis = 0;
    this.tracked = "";
    this.stale = true;
    this.nis = { value: 0, text: "3 sigma" };
    this.compared = new Chart(this.canvas("compare"), { title: "", series: [], low: 0.2 });
    const chart = (id, options) => new Chart(this.canvas(id), { shows: "last", ...options });
    this.charts = [
      chart("position", {
        title: "Position m", low: 0.01,
        series: [...lines("estimate_m"), ...quiet("bench_m", { dash: [3, 3], width: 1 }), ...quiet("reference_m", { dash: [1, 4], width: 1 })],
      }),
      this.compared,
      chart("velocity", { title: "Velocity m/s", low: 0.001, series: [...lines("velocity_estimate_mps"), ...quiet("velocity_truth_mps", { dash: [3, 3], width: 1 })] }),
      chart("position_error", { title: "Error mm, 3\u03c3", low: 0.2, series: lines("position_error_mm", { width: 1.5 }), bands: AXES.map(([axis, color]) => ({ column: `position_band_mm.${axis}`, color })) }),
      chart("attitude", {
        title: "Attitude deg", low: 0.05,
        series: [...lines("angle_estimate_deg"), ...quiet("angle_bench_deg", { dash: [3, 3], width: 1 })],
      }),
      chart("attitude_error", { title: "Error deg, 3\u03c3", low: 0.005, series: lines("angle_error_deg", { width: 1.5 }), bands: AXES.map(([axis, color]) => ({ column: `angle_band_deg.${axis}`, color })) }),
      chart("rate", { title: "Rates deg/s", low: 0.01, series: [...lines("rate_estimate_degps"), ...quiet("rate_truth_degps", { dash: [3, 3], width: 1 })] }),
      chart("nis", {
        title: "NIS", log: true, bound: this.nis, shows: null,
        series: [{ name: "position", column: "nis_position", color: X, dots: true }, { name: "attitude", column: "nis_attitude", color: Y, dots: true }],
      }),
    ];
    this.levels = chart("level", {
      title: "Level / limit", log: true, bound: { value: 1, text: "limit" }, shows: null,
      series: [{ name: "along", column: "level_along", color: X }, { name: "across", column: "level_across", color: Y }, { name: "attitude", column: "level_attitude", color: Z }],
    });
    this.charts.push(this.levels);
    this.firings = new Firings(this.canvas("thrusters"));
    this.lateness = new Lateness(this.canvas("lateness"));
    this.compare(0);
    document.addEventListener("keydown", (event) => this.key(event));
  }

  canvas(id) {
    const canvas = document.createElement("canvas");
    canvas.id = `plot_${id}`;
    canvas.tabIndex = 0;
    canvas.ariaLabel = `${id}: Enter enlarges it`;
    canvas.onclick = () => canvas.classList.toggle("big");
    canvas.onkeydown = (event) => {
      if (event.key === "Enter") canvas.classList.toggle("big");
      if (event.key === "Escape") canvas.classList.remove("big");
    };
    this.where.append(canvas);
    return canvas;
  }

  // Deviation of one axis from the plan: encoders, vision unit and filter in one plot.
  compare(axis) {
    this.axis = axis;
    const name = "xyz"[axis];
    const off = (what, more) => ({ column: `${what}_m.${name}`, minus: `reference_m.${name}`, scale: 1000, ...more });
    this.compared.title = `${name} \u2212 plan mm [v]`;
    this.compared.series = [
      off("vision", { name: "VMU", color: YELLOW, dots: true }),
      ...(this.monitored ? [{ name: "monitor", color: GREEN, points: (store) => this.monitor(store, axis) }] : []),
      ...(this.tracked ? [{ name: this.tracked, color: X, points: (store) => this.tracker(store, axis) }] : []),
      off("bench", { name: "bench", color: WHITE, width: 2.5 }),
      off("estimate", { name: "filter", color: Y, width: 1.5, dash: [6, 2] }),
    ];
  }

  // Deviation of the docking monitor's position from the plan, mm: [t, value] of each batch with a pose.
  monitor(store, axis) {
    return this.points(store, store.portions, ({ r_m }, row) => r_m && r_m[axis] - store.at(row, `reference_m.${"xyz"[axis]}`));
  }

  // The same of a tracker, which shows how far off the encoders are.
  tracker(store, axis) {
    const name = "xyz"[axis];
    return this.points(store, store.offsets, ({ off_m }, row) => off_m[axis] + store.at(row, `bench_m.${name}`) - store.at(row, `reference_m.${name}`));
  }

  // [t, value in mm] of each of a list for which value, in m, is a number.
  points(store, list, value) {
    const shown = [];
    for (const each of list) {
      const row = Math.min(store.from(each.t_s), store.count - 1);
      const metres = row < 0 ? null : value(each, row);
      if (Number.isFinite(metres)) shown.push([each.t_s, 1000 * metres]);
    }
    return shown;
  }

  key(event) {
    if (/^(INPUT|SELECT)$/.test(event.target.tagName) || event.ctrlKey || event.altKey) return;
    if (event.key === "v") this.compare((this.axis + 1) % 3);
    if (event.key === "w") this.window = (this.window + 1) % WINDOWS_S.length;
  }

  describe(bench) {
    if (!bench.thrusters) return;
    this.monitored = bench.monitor.length > 0;
    this.compare(this.axis);
    this.firings.thrusters = bench.thrusters;
    this.nis.value = bench.nis_bound;
    this.nis.text = `3 sigma: ${bench.nis_bound.toFixed(1)}`;
    this.lateness.limit_us = bench.late_us;
  }

  draw(store) {
    const tracked = store.offsets.length ? store.offsets[0].name : "";
    if (tracked !== this.tracked) {
      this.tracked = tracked;
      this.compare(this.axis);
    }
    const end = store.count ? store.last("t_s") : 1;
    const first = store.count ? store.at(0, "t_s") : 0;
    const t0 = Math.max(first, end - WINDOWS_S[this.window]);
    const t1 = Math.max(end, t0 + 1);
    const term = store.count ? TERMS[store.last("level_term")] : "";
    this.levels.title = term ? `Level/limit: ${term}` : "Level / limit";
    for (const chart of this.charts) chart.draw(store, t0, t1, this.stale);
    this.firings.draw(store, t0, t1);
    this.lateness.draw(store);
  }
}
