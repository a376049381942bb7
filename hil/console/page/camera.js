// The camera's picture with its overlay, or, where none comes, what the camera must have in view by the encoders.

import { prepare } from "/page/chart.js";
import { lampsInView } from "/page/scene.js";

const GOOD = "#56b4e9", BAD = "#e69f00";

export class Camera {
  constructor(canvas, text) {
    this.canvas = canvas;
    this.text = text;
    this.picture = null; // the newest, decoded
    this.decoding = false;
  }

  // Take the picture of a message; while one is being decoded further ones are left out.
  async take(header, jpeg) {
    if (this.decoding) return;
    this.decoding = true;
    try {
      const image = jpeg.byteLength ? await createImageBitmap(new Blob([jpeg], { type: "image/jpeg" })) : null;
      if (this.picture && this.picture.image) this.picture.image.close();
      this.picture = { ...header, image, came_ms: performance.now() };
    } catch {
      this.picture = { ...header, image: null, came_ms: performance.now() };
    } finally {
      this.decoding = false;
    }
  }

  draw(bench, pose) {
    const [c, width, height] = prepare(this.canvas);
    const picture = this.picture;
    if (picture) {
      const put = this.fit(c, width, height, picture.width_px, picture.height_px);
      if (picture.image) c.drawImage(picture.image, ...put(0, 0), ...put.size);
      for (const shape of picture.overlay) this.shape(c, put, shape);
      const age_s = (performance.now() - picture.came_ms) / 1000;
      this.text.textContent = `${picture.name} at ${picture.t_s.toFixed(2)} s, ${age_s.toFixed(1)} s ago`;
      this.text.className = age_s > 1 ? "stale" : "";
      return;
    }
    if (!bench || !bench.camera || !pose) {
      this.text.textContent = "camera: no picture";
      return;
    }
    const put = this.fit(c, width, height, bench.camera.width_px, bench.camera.height_px);
    for (const lamp of lampsInView(bench, pose)) if (lamp) this.shape(c, put, { kind: "circle", at: lamp, radius: 14, good: true });
    this.shape(c, put, { kind: "cross", at: [bench.camera.width_px / 2, bench.camera.height_px / 2], good: false });
    this.text.textContent = "no picture: lamps by the encoders";
  }

  fit(c, width, height, across, down) {
    const scale = Math.min(width / across, height / down);
    const left = (width - scale * across) / 2, top = (height - scale * down) / 2;
    c.strokeStyle = "#3a4654";
    c.strokeRect(left + 0.5, top + 0.5, scale * across - 1, scale * down - 1);
    const put = (u, v) => [left + scale * u, top + scale * v];
    put.size = [scale * across, scale * down];
    put.scale = scale;
    return put;
  }

  shape(c, put, shape) {
    c.strokeStyle = c.fillStyle = shape.good ? GOOD : BAD;
    c.lineWidth = 2;
    c.beginPath();
    if (shape.kind === "circle") c.arc(...put(...shape.at), Math.max(2, shape.radius * put.scale), 0, 2 * Math.PI);
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
    if (shape.kind === "text") {
      c.font = '700 13px "DejaVu Sans", sans-serif';
      c.fillText(shape.text, ...put(...shape.at));
    }
  }
}
