// Received rows, newest last, with columns by name.

const KEPT = 40000;

export class Store {
  constructor() {
    this.names = [];
    this.index = {};
    this.count = 0;
    this.data = new Float32Array(0);
    this.version = 0;
    this.portions = []; // of the docking monitor: {t_s, status, frames, values, sigmas, r_m}
    this.offsets = []; // of trackers: {name, t_s, off_m}
  }

  // first: number of the first of them, 0 replaces all
  extend(kept, { first, list }) {
    kept.length = Math.min(first, kept.length);
    kept.push(...list);
    this.version++;
  }

  name(columns) {
    if (columns.length === this.names.length) return;
    this.names = columns;
    this.index = Object.fromEntries(columns.map((name, i) => [name, i]));
    this.clear();
  }

  clear() {
    this.count = 0;
    this.version++;
  }

  // rows: Float32Array of n rows; first: number of the first of them, 0 replaces all
  add(rows, n, first) {
    if (first === 0) this.clear();
    const width = this.names.length;
    if (!n || !width) return;
    if (this.count + n > KEPT) {
      const dropped = Math.max(KEPT >> 2, n);
      this.data.copyWithin(0, dropped * width, this.count * width);
      this.count = Math.max(0, this.count - dropped);
    }
    const needed = (this.count + n) * width;
    if (needed > this.data.length) {
      const grown = new Float32Array(Math.max(needed, 2 * this.data.length));
      grown.set(this.data.subarray(0, this.count * width));
      this.data = grown;
    }
    this.data.set(rows, this.count * width);
    this.count += n;
    this.version++;
  }

  at(row, name) {
    return this.data[row * this.names.length + this.index[name]];
  }

  last(name) {
    return this.count ? this.at(this.count - 1, name) : NaN;
  }

  vector(name) {
    return ["x", "y", "z"].map((axis) => this.last(`${name}.${axis}`));
  }

  // the number of the first row at or after t
  from(t) {
    let low = 0, high = this.count;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle, "t_s") < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }
}
