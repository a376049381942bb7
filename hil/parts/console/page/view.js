// Camera view, small or large, and the numbers of the docking monitor next to its image.

import { nameOf, shortNameOf } from "/page/camera.js";

const $ = (id) => document.getElementById(id);
const OLD_S = 3;
const DRAG_PX = 6; // shorter ones are clicks
const WARNINGS = { rejected_fields: "frames hold two fields: set fields in the scene" };

export class View {
  constructor(camera, controls) {
    this.camera = camera;
    this.controls = controls;
    this.link = controls.link;
    this.cameras = [];
    this.start = null; // of a drag on the canvas
    $("camera_large").onclick = () => this.large();
    $("camera_next").onclick = () => this.next();
    $("whole").onclick = () => controls.ask({ do: "search", region: null });
    $("camera").addEventListener("pointerdown", (event) => this.press(event));
    $("camera").addEventListener("pointermove", (event) => this.drag(event));
    $("camera").addEventListener("pointerup", (event) => this.release(event));
    $("camera").addEventListener("pointercancel", () => this.drop());
    $("view").addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.large(false);
    });
  }

  large(wanted = !$("view").classList.contains("big")) {
    $("view").classList.toggle("big", wanted);
    $("camera_large").firstChild.textContent = wanted ? "Small" : "Large";
  }

  // On the docking monitor's image a drag selects the region of search; a click makes the view large or small.
  press(event) {
    if (event.button !== 0) return;
    this.start = [event.offsetX, event.offsetY];
    this.camera.canvas.setPointerCapture(event.pointerId);
  }

  drag(event) {
    const shown = this.camera.picture && this.camera.picture.name === "monitor" && this.camera.place;
    if (!this.start || !shown) return;
    const [x, y] = this.start;
    if (!this.camera.dragged && Math.hypot(event.offsetX - x, event.offsetY - y) < DRAG_PX) return;
    this.camera.dragged = [this.camera.pointAt(x, y), this.camera.pointAt(event.offsetX, event.offsetY)];
  }

  release(event) {
    if (!this.start) return;
    this.drag(event);
    const dragged = this.camera.dragged;
    this.drop();
    if (!dragged) return this.large();
    const [[u0, v0], [u1, v1]] = dragged;
    this.controls.ask({ do: "search", region: [Math.min(u0, u1), Math.min(v0, v1), Math.abs(u1 - u0), Math.abs(v1 - v0)] });
  }

  drop() {
    this.start = this.camera.dragged = null;
  }

  next() {
    if (!this.cameras.length) return;
    this.choose(this.cameras[(this.cameras.indexOf(this.watched()) + 1) % this.cameras.length]);
  }

  // Also after a reconnection: the console receives only changes of the choice, so send it again.
  choose(name) {
    this.camera.wanted = name;
    this.link.send({ do: "watch", camera: name });
  }

  watched() {
    return this.cameras.includes(this.camera.wanted) ? this.camera.wanted : this.cameras[0];
  }

  show(now, page, store) {
    if (now.cameras.join() !== this.cameras.join()) {
      this.cameras = now.cameras;
      $("camera_choice").replaceChildren(...this.cameras.map((name) => this.button(name)));
    }
    if (!this.cameras.length && this.camera.picture) this.camera.clear();
    $("camera_next").disabled = this.cameras.length < 2;
    $("whole").hidden = $("whole").disabled = !page.search || !now.open;
    for (const button of $("camera_choice").children) button.ariaPressed = String(button.dataset.camera === this.watched());
    this.numbers(now, page.bench.monitor || [], store.portions.at(-1));
  }

  button(name) {
    const button = document.createElement("button");
    button.textContent = shortNameOf(name);
    button.ariaLabel = `watch ${nameOf(name)}`;
    button.dataset.camera = name;
    button.onclick = () => this.choose(name);
    return button;
  }

  // Status, time and all numbers with their sigmas; in the small view the two main ones.
  numbers(now, shown, portion) {
    $("monitor").hidden = !shown.length;
    if (!shown.length) return;
    const age_s = portion ? now.run_s - portion.t_s : NaN;
    const stale = !(age_s <= OLD_S);
    $("monitor").classList.toggle("stale", stale);
    $("monitor_status").textContent = portion ? `${portion.status.replace("_", " ")}, ${portion.frames} frames` : "docking monitor: no result yet";
    $("monitor_warning").textContent = (portion && WARNINGS[portion.status]) || "";
    $("monitor_status").classList.toggle("bad", Boolean(portion && portion.frames === 0));
    $("monitor_age").textContent = portion ? `at ${portion.t_s.toFixed(2)} s${stale ? `, ${age_s.toFixed(0)} s ago` : ""}` : "";
    const body = $("monitor_numbers");
    if (body.children.length !== shown.length) {
      body.replaceChildren(...shown.map(({ name }) => {
        const row = document.createElement("tr");
        row.innerHTML = "<th></th><td></td><td></td><td></td>";
        row.firstChild.textContent = name;
        return row;
      }));
    }
    shown.forEach(({ at, unit, scale, decimals }, i) => {
      const value = portion ? portion.values[at] : null, sigma = portion ? portion.sigmas[at] : null;
      const cells = body.children[i].children;
      cells[1].textContent = value === null ? "-" : (value * scale).toFixed(decimals);
      cells[2].textContent = sigma === null ? "" : `\u00b1 ${Number((sigma * scale).toPrecision(2))}`;
      cells[3].textContent = unit === "deg" ? "\u00b0" : unit;
    });
  }
}
