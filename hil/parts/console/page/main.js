// Page of the console: receives messages and draws the newest state in the browser's animation frames.

import { Camera } from "/page/camera.js";
import { Controls } from "/page/controls.js";
import { closeDialog, openDialog } from "/page/dialogs.js";
import { forgetKey, keepKey, keptKey } from "/page/keys.js";
import { Link } from "/page/link.js";
import { ages, alarms, header, isStale, log, reach, waived } from "/page/panels.js";
import { Plots } from "/page/plots.js";
import { Scene } from "/page/scene.js";
import { Store } from "/page/store.js";
import { View } from "/page/view.js";

const $ = (id) => document.getElementById(id);
const SLOW_PERIOD_MS = 500, DRAW_PERIOD_MS = 90;

const store = new Store();
const plots = new Plots($("plots"));
const scene = new Scene($("scene"));
const camera = new Camera($("camera"), $("camera_text"));
let keyed = false, now = null, page = null, drawn = -1, drawn_ms = 0, slow_ms = 0;

const link = new Link({
  message(header, rows, data) {
    now = header.now;
    if (header.page) {
      if (page && page.session !== header.page.session) camera.clear();
      page = header.page;
      store.name(page.columns);
      plots.describe(page.bench);
      alarms(page);
      waived(page);
    }
    store.add(rows, header.rows, header.first);
    if (header.portions) store.extend(store.portions, header.portions);
    if (header.offsets) store.extend(store.offsets, header.offsets);
    if (header.picture) camera.receive(header.picture, data);
  },
  async required(what) {
    keyed = what === "key";
    const key = keyed && (await keptKey());
    const name = localStorage.getItem("hil.name") || "";
    if (keyed ? key : name) return key ? { key } : { name, token: token() };
    whoIs(keyed ? "Operator: choose your key file" : "Operator");
    return null;
  },
  refused(text) {
    sessionStorage.removeItem("hil.token");
    whoIs(text);
  },
  opened() {
    controls.reconnected();
    if (camera.wanted) link.send({ do: "watch", camera: camera.wanted });
  },
  lost() {
    link.received_ms = -Infinity;
  },
});
const controls = new Controls(link);
const view = new View(camera, controls);
window.hil = { store, link, camera, get now() { return now; }, get page() { return page; }, get frames() { return frames; } };

function poseNow() {
  const at = now.relative || now; // of a target that is rotated, relative to it
  const q = [0, 1, 2, 3].map((i) => store.last(`q_bench_${i}`));
  if (now.rail_m && (isRunning(now.mode) || !now.open) && q.every(Number.isFinite)) return { r: store.vector("bench_m"), q, rail: at.rail_m };
  if (!now.rail_m || !page.bench.axes) return null;
  // outside a run there are no rows: pose from the newest encoder values, yaw pitch roll
  const [roll, pitch, yaw] = at.gimbal_deg.map((v) => (v * Math.PI) / 360);
  const s = [roll, pitch, yaw].map(Math.sin), k = [roll, pitch, yaw].map(Math.cos);
  const q_CH = [
    s[0] * k[1] * k[2] - k[0] * s[1] * s[2],
    k[0] * s[1] * k[2] + s[0] * k[1] * s[2],
    k[0] * k[1] * s[2] - s[0] * s[1] * k[2],
    k[0] * k[1] * k[2] + s[0] * s[1] * s[2],
  ];
  return { r: at.rail_m, q: q_CH, rail: at.rail_m };
}

for (const event of ["keydown", "click", "pointermove"]) document.addEventListener(event, () => (drawn = -1));

const isRunning = (mode) => mode === "running" || mode === "hold";
let frames = 0;

function draw(time_ms) {
  requestAnimationFrame(draw);
  if (now && page) link.seen_s = now.wall_s; // drawn below
  reach(link);
  if (!now || !page) return;
  const stale = isStale(now) || link.old;
  header(now, page, store);
  controls.show(now, page);
  view.show(now, page, store);
  if (time_ms - slow_ms > SLOW_PERIOD_MS) {
    slow_ms = time_ms;
    ages(now, page, link.age_s);
    log(page, now.wall_s);
    plots.stale = stale;
    drawn = -1; // changes without new rows: sizes, ages, jogged axes
  }
  if (drawn === store.version || time_ms - drawn_ms < DRAW_PERIOD_MS) return;
  drawn = store.version;
  drawn_ms = time_ms;
  frames++;
  plots.draw(store);
  const pose = poseNow();
  scene.draw(page.bench, pose, store, stale);
  camera.draw(page.bench, pose);
}

const token = () => new URLSearchParams(location.hash.slice(1)).get("token") || sessionStorage.getItem("hil.token") || "";

// Ask who is at this page. text: why.
function whoIs(text) {
  $("who_text").textContent = text;
  for (const part of document.querySelectorAll("[data-for]")) part.hidden = (part.dataset.for === "key") !== keyed;
  openDialog($("who"));
}

$("who").addEventListener("submit", async () => {
  closeDialog($("who"));
  const [file] = $("key_file").files;
  try {
    if (keyed && file) await keepKey(await file.text());
  } catch (error) {
    return whoIs(error.message);
  } finally {
    $("key_file").value = "";
  }
  if (!keyed) {
    localStorage.setItem("hil.name", $("name").value.trim() || "operator");
    sessionStorage.setItem("hil.token", $("token").value);
  }
  link.open();
});
$("leave").onclick = async () => {
  if (now && now.lease.mine && now.open) return controls.notify("release the command first");
  await forgetKey().catch(() => {});
  localStorage.removeItem("hil.name");
  sessionStorage.removeItem("hil.token");
  link.close();
  whoIs("Signed out. Operator:");
};
$("name").value = localStorage.getItem("hil.name") || "";
link.open();
requestAnimationFrame(draw);
