// Strip charts on canvas: lines, dots, a band about zero, and a bound.

const TEXT = "#f4f6f8", DIM = "#a9b4c0", GRID = "#2c3743";
const FONT = '"DejaVu Sans", Verdana, sans-serif';

// Scale the canvas to the resolution of the screen; return its context, width and height in CSS pixels.
export function prepare(canvas) {
  const scale = window.devicePixelRatio || 1;
  const width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * scale) || canvas.height !== Math.round(height * scale)) {
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
  }
  const context = canvas.getContext("2d");
  context.setTransform(scale, 0, 0, scale, 0, 0);
  context.clearRect(0, 0, width, height);
  return [context, width, height];
}

// 1, 2 or 5 times a power of ten, for about n steps in the range
export function niceStep(range, n) {
  const rough = range / n, power = 10 ** Math.floor(Math.log10(rough));
  const digit = rough / power;
  return (digit < 1.5 ? 1 : digit < 3.5 ? 2 : digit < 7.5 ? 5 : 10) * power;
}

export function shown(value) {
  if (!Number.isFinite(value)) return "-";
  const size = Math.abs(value);
  return value.toFixed(size >= 100 ? 0 : size >= 10 ? 1 : size >= 1 ? 2 : size >= 0.1 ? 3 : 4);
}

export class Chart {
  // series: {name, column, color, dash, dots, minus, scale}, or {name, color, points(store)} for separate [t, value] points; bands: {column, color} about zero; bound: {value, text}
  constructor(canvas, { title, series, bands = [], bound = null, log = false, low = 0, shows = null }) {
    Object.assign(this, { canvas, title, series, bands, bound, log, low, shows });
  }

  draw(store, t0, t1, stale) {
    const [c, width, height] = prepare(this.canvas);
    const box = { left: 46, right: width - 6, top: 21, bottom: height - 15 };
    this.heading(c, store, width, stale);
    if (!store.count || box.bottom - box.top < 20) return;
    const first = Math.max(0, store.from(t0) - 1);
    const step = Math.max(1, Math.floor((store.count - first) / Math.max(60, box.right - box.left)));
    const [low, high] = this.range(store, first, step, t0);
    const x = (t) => box.left + ((t - t0) / (t1 - t0)) * (box.right - box.left);
    const to = this.log ? Math.log10 : (v) => v;
    const y = (v) => box.bottom - ((to(v) - to(low)) / (to(high) - to(low))) * (box.bottom - box.top);
    this.grid(c, box, t0, t1, low, high, x, y);
    c.save();
    c.beginPath();
    c.rect(box.left, box.top - 1, box.right - box.left, box.bottom - box.top + 2);
    c.clip();
    for (const band of this.bands) this.band(c, store, first, step, band, x, y);
    for (const series of this.series) this.line(c, store, first, step, series, x, y);
    if (this.bound && this.bound.value) this.limit(c, box, y(this.bound.value));
    c.restore();
  }

  heading(c, store, width, stale) {
    c.font = `700 14px ${FONT}`;
    c.textBaseline = "top";
    c.textAlign = "left";
    c.fillStyle = TEXT;
    c.fillText(this.title, 6, 3);
    const left = 12 + c.measureText(this.title).width;
    c.textAlign = "right";
    let right = width - 6;
    for (const series of [...this.series].reverse()) {
      if (!series.name) continue;
      const value = this.shows === "last" ? shown(this.value(store, store.count - 1, series)) : "";
      const text = `${series.name}${value ? ` ${value}` : ""}`;
      if (right - c.measureText(text).width < left) break;
      c.fillStyle = stale ? "#8f9ba8" : series.color;
      c.fillText(text, right, 3);
      right -= c.measureText(text).width + 9;
    }
  }

  value(store, row, series) {
    if (row < 0 || series.points) return NaN;
    const value = store.at(row, series.column) * (series.scale || 1);
    return series.minus ? value - store.at(row, series.minus) * (series.scale || 1) : value;
  }

  range(store, first, step, t0) {
    let low = Infinity, high = -Infinity;
    const take = (v) => {
      if (Number.isFinite(v) && (!this.log || v > 0)) {
        if (v < low) low = v;
        if (v > high) high = v;
      }
    };
    for (const series of this.series) {
      if (series.free) continue; // does not set the scale
      if (series.points) {
        for (const [t, v] of series.points(store)) if (t >= t0) take(v);
        continue;
      }
      for (let row = first; row < store.count; row += series.dots ? 1 : step) take(this.value(store, row, series));
    }
    for (const band of this.bands) {
      // the settled half: the wide band at the start would hide the rest
      for (let row = first + ((store.count - first) >> 1); row < store.count; row += step) {
        take(store.at(row, band.column));
        take(-store.at(row, band.column));
      }
    }
    if (this.bound && this.bound.value) take(this.bound.value * 1.2);
    if (this.log) return [Math.min(0.05, low), Math.max(50, high * 1.5)];
    if (!(high > low)) [low, high] = Number.isFinite(low) ? [low - 1e-3, low + 1e-3] : [-1, 1];
    const margin = 0.06 * (high - low) + this.low;
    return [low - margin, high + margin];
  }

  grid(c, box, t0, t1, low, high, x, y) {
    c.strokeStyle = GRID;
    c.lineWidth = 1;
    c.fillStyle = DIM;
    c.font = `12px ${FONT}`;
    c.textAlign = "right";
    c.textBaseline = "middle";
    c.beginPath();
    const ticks = [];
    if (this.log) for (let v = 10 ** Math.ceil(Math.log10(low)); v <= high; v *= 10) ticks.push(v);
    else {
      const step = niceStep(high - low, (box.bottom - box.top) / 26);
      for (let v = Math.ceil(low / step) * step; v <= high; v += step) ticks.push(Math.abs(v) < step * 1e-6 ? 0 : v);
    }
    for (const v of ticks) {
      c.moveTo(box.left, y(v));
      c.lineTo(box.right, y(v));
      c.fillText(String(Number(v.toPrecision(4))), box.left - 3, y(v));
    }
    c.textAlign = "center";
    c.textBaseline = "top";
    const step = niceStep(t1 - t0, (box.right - box.left) / 70);
    for (let t = Math.ceil(t0 / step) * step; t <= t1; t += step) {
      c.moveTo(x(t), box.top);
      c.lineTo(x(t), box.bottom);
      c.fillText(`${Number(t.toPrecision(6))}`, x(t), box.bottom + 2);
    }
    c.stroke();
  }

  band(c, store, first, step, band, x, y) {
    c.beginPath();
    let begun = false;
    const end = store.count - 1;
    const known = (row) => Number.isFinite(store.at(row, band.column));
    for (let row = first; row <= end; row += step) {
      if (!known(row)) continue;
      c[begun ? "lineTo" : "moveTo"](x(store.at(row, "t_s")), y(store.at(row, band.column)));
      begun = true;
    }
    for (let row = end; row >= first; row -= step) {
      if (known(row)) c.lineTo(x(store.at(row, "t_s")), y(-store.at(row, band.column)));
    }
    if (!begun) return;
    c.fillStyle = band.color;
    c.globalAlpha = 0.16;
    c.fill();
    c.globalAlpha = 0.8;
    c.strokeStyle = band.color;
    c.setLineDash([2, 3]);
    c.lineWidth = 1;
    c.stroke();
    c.setLineDash([]);
    c.globalAlpha = 1;
  }

  line(c, store, first, step, series, x, y) {
    c.strokeStyle = c.fillStyle = series.color;
    c.lineWidth = series.width || 2;
    if (series.points) {
      for (const [t, v] of series.points(store)) this.diamond(c, x(t), y(v));
      return;
    }
    if (series.dots) {
      for (let row = first; row < store.count; row++) {
        const v = this.value(store, row, series);
        if (Number.isFinite(v)) c.fillRect(x(store.at(row, "t_s")) - 1.5, y(v) - 1.5, 3, 3);
      }
      return;
    }
    c.setLineDash(series.dash || []);
    c.beginPath();
    let pen = false;
    for (let row = first - (first % step); row < store.count; row += step) {
      const v = this.value(store, Math.max(row, 0), series);
      if (Number.isFinite(v)) c[pen ? "lineTo" : "moveTo"](x(store.at(row, "t_s")), y(v));
      pen = Number.isFinite(v);
    }
    c.stroke();
    c.setLineDash([]);
  }

  diamond(c, x, y) {
    c.beginPath();
    c.moveTo(x - 4, y);
    c.lineTo(x, y - 4);
    c.lineTo(x + 4, y);
    c.lineTo(x, y + 4);
    c.fill();
  }

  limit(c, box, at) {
    c.strokeStyle = c.fillStyle = "#e66a0a";
    c.lineWidth = 2;
    c.beginPath();
    c.moveTo(box.left, at);
    c.lineTo(box.right, at);
    c.stroke();
    c.font = `700 12px ${FONT}`;
    c.textAlign = "left";
    const below = at - box.top < 14; // no space above it
    c.textBaseline = below ? "top" : "bottom";
    c.fillText(this.bound.text, box.left + 3, at - 1);
  }
}

// Thruster firings over time, one row per thruster.
export class Firings {
  constructor(canvas) {
    this.canvas = canvas;
    this.thrusters = 12;
  }

  draw(store, t0, t1) {
    const [c, width, height] = prepare(this.canvas);
    const box = { left: 46, right: width - 6, top: 21, bottom: height - 15 };
    c.font = `700 14px ${FONT}`;
    c.textBaseline = "top";
    c.textAlign = "left";
    c.fillStyle = TEXT;
    c.fillText("Thrusters open", 6, 3);
    if (!store.count) return;
    const x = (t) => box.left + ((t - t0) / (t1 - t0)) * (box.right - box.left);
    const pitch = (box.bottom - box.top) / this.thrusters;
    const each = Math.max(1, Math.ceil(9 / pitch));
    c.font = `12px ${FONT}`;
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (let i = 0; i < this.thrusters; i++) {
      c.fillStyle = i % 2 ? "#10161d" : "#1a222c";
      c.fillRect(box.left, box.top + i * pitch, box.right - box.left, pitch);
      c.fillStyle = DIM;
      if (i % each === 0) c.fillText(String(i + 1), box.left - 3, box.top + (i + 0.5) * pitch);
    }
    c.fillStyle = "#f0e442";
    for (let row = store.from(t0); row < store.count; row++) {
      const open = store.at(row, "thrusters");
      if (!open) continue;
      const from = x(store.at(row, "t_s"));
      const until = row + 1 < store.count ? x(store.at(row + 1, "t_s")) : from + 1;
      for (let i = 0; i < this.thrusters; i++) {
        if ((open >> i) & 1) c.fillRect(from, box.top + i * pitch + 1, Math.max(1, until - from), Math.max(1, pitch - 2));
      }
    }
  }
}

// Histogram of the lateness of cycles, on logarithmic scales.
export class Lateness {
  constructor(canvas) {
    this.canvas = canvas;
    this.limit_us = 1000;
    this.restart();
  }

  restart() {
    this.bins = new Uint32Array(18); // < 1 us, < 2, ... < 65536, beyond
    this.taken = 0;
    this.largest = 0;
  }

  take(store) {
    if (store.count < this.taken) this.restart();
    for (; this.taken < store.count; this.taken++) {
      const us = store.at(this.taken, "lateness_us");
      this.bins[us < 1 ? 0 : Math.min(17, Math.floor(Math.log2(us)) + 1)]++;
      if (us > this.largest) this.largest = us;
    }
  }

  draw(store) {
    this.take(store);
    const [c, width, height] = prepare(this.canvas);
    const box = { left: 46, right: width - 6, top: 21, bottom: height - 15 };
    c.font = `700 14px ${FONT}`;
    c.textBaseline = "top";
    c.textAlign = "left";
    c.fillStyle = TEXT;
    c.fillText(`Lateness us${this.taken ? `; worst ${this.largest < 1 ? "below 1" : shown(this.largest)}` : ""}`, 6, 3);
    const most = Math.max(10, ...this.bins), wide = (box.right - box.left) / this.bins.length;
    const y = (n) => box.bottom - (Math.log10(1 + n) / Math.log10(1 + most)) * (box.bottom - box.top);
    c.font = `12px ${FONT}`;
    this.bins.forEach((n, i) => {
      const at = box.left + i * wide;
      c.fillStyle = 2 ** i > this.limit_us ? "#d55e00" : "#56b4e9";
      if (n) c.fillRect(at + 1, y(n), wide - 2, box.bottom - y(n));
      c.fillStyle = DIM;
      c.textAlign = "right";
      c.textBaseline = "top";
      if (i % (wide < 15 ? 6 : 3) === 0 && i < 17) c.fillText(`<${2 ** i}`, at + wide, box.bottom + 2);
    });
    c.textBaseline = "middle";
    for (let n = 1; n <= most; n *= 10) c.fillText(String(n), box.left - 3, y(n));
  }
}
