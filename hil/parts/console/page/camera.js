// Camera image with its overlay, or, without an image, the expected LEDs computed from the encoders.

import { prepare } from "/page/chart.js";
import { ledsInView } from "/page/scene.js";

const GOOD = "#56b4e9", BAD = "#e69f00";
// parts with their own colour; bad ones keep the colour of bad
const PARTS = { region: "#a9b4c0", search: "#cc79a7", edge: "#009e73", cross: "#f0e442", number: "#f4f6f8" };
const NAMES = { "vmu.left": ["VMU left", "Left"], "vmu.right": ["VMU right", "Right"], monitor: ["Monitor", "Monitor"] };

export const nameOf = (camera) => (NAMES[camera] || [camera])[0];
export const shortNameOf = (camera) => (NAMES[camera] || [camera, camera])[1];

export class Camera {
  constructor(canvas, text) {
    this.canvas = canvas;
    this.text = text;
    this.picture = null; // the newest, decoded
    this.decoding = false;
    this.waiting = null;
    this.wanted = ""; // camera that this page watches
    this.dragged = null; // rectangle that is being dragged, [[u, v], [u, v]] of two corners
    this.place = null; // of the image on the canvas
  }

  clear() {
    if (this.picture && this.picture.image) this.picture.image.close();
    this.picture = null;
  }

  // Receive the image of a message; of those received while one is being decoded the newest is next.
  async receive(header, data) {
    this.waiting = { header, data, received_ms: performance.now() };
    if (this.decoding) return;
    this.decoding = true;
    while (this.waiting) {
      const next = this.waiting;
      this.waiting = null;
      await this.decode(next);
    }
    this.decoding = false;
  }

  async decode({ header, data, received_ms }) {
    let image = null, status = header.status;
    try {
      if (data.byteLength) image = await createImageBitmap(new Blob([data], { type: `image/${header.encoding}` }));
    } catch {
      status = "cannot be decoded";
    }
    this.clear();
    this.picture = { ...header, status, image, received_ms };
  }

  age_s() {
    return this.picture.age_s + (performance.now() - this.picture.received_ms) / 1000;
  }

  draw(bench, pose) {
    const [c, width, height] = prepare(this.canvas);
    const picture = this.picture;
    if (picture) {
      const age_s = this.age_s(), stale = age_s > (bench.picture_stale_s || 1);
      const put = (this.place = this.fit(c, width, height, picture.width_px, picture.height_px));
      c.filter = stale ? "grayscale(1) brightness(0.6)" : "none";
      if (picture.image) c.drawImage(picture.image, ...put(-0.5, -0.5), ...put.size); // pixel centres at integers
      // the monitor's numbers are shown next to its image
      const shapes = picture.name === "monitor" ? picture.overlay.filter((shape) => shape.part !== "number") : picture.overlay;
      this.overlay(c, put, shapes, height);
      if (this.dragged) this.rectangle(c, put, this.dragged);
      c.filter = "none";
      const at = picture.t_s === null ? "before the run" : `at ${picture.t_s.toFixed(2)} s`;
      const status = picture.status ? ` \u00b7 ${picture.status}` : "";
      this.caption(`${nameOf(picture.name)} ${at}, ${age_s.toFixed(1)} s old${stale ? ": STALE" : ""}${status}`, stale);
      return;
    }
    if (!bench || !bench.camera || !pose) return this.caption("no image", false);
    const put = this.fit(c, width, height, bench.camera.width_px, bench.camera.height_px);
    for (const led of ledsInView(bench, pose)) if (led) this.shape(c, put, { kind: "circle", at: led, radius: 14, good: true });
    this.shape(c, put, { kind: "cross", at: [bench.camera.width_px / 2, bench.camera.height_px / 2], good: false });
    this.caption("no image: expected LEDs from the encoders", false);
  }

  caption(text, stale) {
    this.text.textContent = text;
    this.text.classList.toggle("stale", stale);
  }

  fit(c, width, height, across, down) {
    const scale = Math.min(width / across, height / down);
    const left = (width - scale * across) / 2, top = (height - scale * down) / 2;
    c.strokeStyle = "#3a4654";
    c.strokeRect(left + 0.5, top + 0.5, scale * across - 1, scale * down - 1);
    const put = (u, v) => [left + scale * (u + 0.5), top + scale * (v + 0.5)];
    put.size = [scale * across, scale * down];
    put.scale = scale;
    put.corner = [left, top];
    return put;
  }

  // Point of the image, px, at a point of the canvas; pixels count from the upper left corner.
  pointAt(x, y) {
    const { corner, scale } = this.place, { width_px, height_px } = this.picture;
    const within = (value, most) => Math.round(Math.min(Math.max(value, 0), most));
    return [within((x - corner[0]) / scale, width_px), within((y - corner[1]) / scale, height_px)];
  }

  rectangle(c, put, [one, other]) {
    const [x0, y0] = put(one[0] - 0.5, one[1] - 0.5), [x1, y1] = put(other[0] - 0.5, other[1] - 0.5);
    c.strokeStyle = PARTS.search;
    c.lineWidth = 2;
    c.setLineDash([6, 4]);
    c.strokeRect(Math.min(x0, x1), Math.min(y0, y1), Math.abs(x1 - x0), Math.abs(y1 - y0));
    c.setLineDash([]);
  }

  // Texts keep a readable size, one per line; a small image shows none.
  overlay(c, put, shapes, height) {
    const size = 16, [left, top] = put(0, 0);
    let line = 0;
    for (const shape of shapes) {
      if (shape.kind !== "text") this.shape(c, put, shape);
      else if (height > 300) this.label(c, shape, left + 8, top + (++line) * (size + 5), size);
    }
  }

  label(c, shape, x, y, size) {
    c.font = `700 ${size}px "DejaVu Sans", sans-serif`;
    c.textAlign = "left";
    c.textBaseline = "alphabetic";
    c.lineWidth = 3;
    c.strokeStyle = "#000";
    c.strokeText(shape.text, x, y);
    c.fillStyle = this.color(shape);
    c.fillText(shape.text, x, y);
  }

  color(shape) {
    return shape.good ? PARTS[shape.part] || GOOD : BAD;
  }

  shape(c, put, shape) {
    c.strokeStyle = c.fillStyle = this.color(shape);
    c.lineWidth = shape.part === "edge" ? 1 : 2;
    c.beginPath();
    if (shape.kind === "circle") c.arc(...put(...shape.at), Math.max(shape.part === "edge" ? 1 : 2, shape.radius * put.scale), 0, 2 * Math.PI);
    if (shape.kind === "line") {
      c.moveTo(...put(...shape.from));
      c.lineTo(...put(...shape.to));
    }
    if (shape.kind === "cross") {
      const [x, y] = put(...shape.at);
      c.moveTo(x - 5, y);
      c.lineTo(x + 5, y);
      c.moveTo(x, y - 5);
      c.lineTo(x, y + 5);
    }
    c.stroke();
  }
}
