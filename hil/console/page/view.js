// Camera view, small or large, and the numbers of the docking monitor next to its image.

import { nameOf, shortNameOf } from "/page/camera.js";

const $ = (id) => document.getElementById(id);
const OLD_S = 3;

export class View {
  constructor(camera, link) {
    this.camera = camera;
    this.link = link;
    this.cameras = [];
    $("camera_large").onclick = () => this.large();
    $("camera_next").onclick = () => this.next();
    $("camera").onclick = () => this.large();
    $("view").addEventListener("keydown", (event) => {
      if (event.key === "Escape") this.large(false);
    });
  }

  large(wanted = !$("view").classList.contains("big")) {
    $("view").classList.toggle("big", wanted);
    $("camera_large").firstChild.textContent = wanted ? "Small" : "Large";
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
