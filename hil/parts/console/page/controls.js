// Buttons, keys, jogging, fault injection: all requests of the page.

import { closeDialog, openDialog, openInPage } from "/page/dialogs.js";
import { Settings } from "/page/settings.js";

const $ = (id) => document.getElementById(id);
const SHELVED_S = 600;
const JOG_MS = 60;
const ANSWER_MS = 6000;
const HALT_MS = 400;

const YES_AFTER_MS = 400; // who has just clicked or pressed a key does not confirm by the second of a pair
const SAME_ACT_MS = 1000; // a press of a pointer and its click
const HALT = { KeyX: "stop", x: "stop", F8: "stop", KeyH: "hold", h: "hold", F2: "hold" };

export class Controls {
  constructor(link) {
    this.link = link;
    this.now = {};
    this.page = {};
    this.jogging = null;
    this.axis = 0;
    $("orders").append(Object.assign(document.createElement("button"), { id: "settings_open", textContent: "Settings" }));
    $("settings_open").dataset.key = "p";
    for (const button of document.querySelectorAll("button[data-key]")) button.innerHTML += `<kbd>${button.dataset.key}</kbd>`;
    for (const key of document.querySelectorAll("button kbd")) key.ariaHidden = true; // of no button's name
    this.settings = new Settings(this);
    $("take").onclick = () => this.takeOrRelease();
    $("open").onclick = () => this.open();
    for (const order of ["stop", "hold"]) {
      const button = $(order === "stop" ? "stop" : "order_hold");
      let pressed_ms = -Infinity;
      button.onpointerdown = () => {
        pressed_ms = performance.now();
        this.halt(order);
      };
      button.onclick = () => performance.now() - pressed_ms > SAME_ACT_MS && this.halt(order); // by a key or an aid
    }
    document.querySelectorAll("select").forEach(openInPage);
    document.addEventListener("contextmenu", (event) => event.preventDefault()); // an open menu keeps keys from the page
    $("acknowledge").onclick = () => this.ask({ do: "acknowledge" });
    $("alarmlist").onclick = (event) => {
      const row = event.target.closest("li");
      if (!row || !this.now.lease.mine) return;
      const alarm = Number(row.dataset.number);
      this.ask(event.shiftKey ? { do: "shelve", alarm, lasting_s: SHELVED_S } : { do: "acknowledge", alarm });
    };
    $("commission").onclick = () => this.open({ commission: true });
    $("reply_yes").onclick = () => isDeliberate(this.asked_ms) && this.reply(true);
    $("reply_no").onclick = () => this.reply(false);
    $("second").onclick = () => isDeliberate(this.second_ms) && this.ask({ do: "second", order: this.now.second_person.order });
    $("fault_device").onchange = () => this.faultKinds();
    $("fault_kind").onchange = () => this.faultAxes();
    $("fault_on").onclick = () => this.switchFault();
    $("fault_clear").onclick = () => this.ask({ do: "fault", device: $("fault_device").value, line: "clear" });
    $("no").onclick = () => closeDialog($("confirm"));
    window.addEventListener("keydown", (event) => this.keyDown(event), true);
    document.addEventListener("keyup", (event) => {
      if (event.key === "ArrowLeft" || event.key === "ArrowRight") this.jog(null);
    });
    for (const event of ["blur", "pointerup", "pointercancel"]) window.addEventListener(event, () => this.jog(null));
    document.addEventListener("visibilitychange", () => this.jog(null));
  }

  // Add the buttons of the commands, once the console has sent them.
  addOrders(orders) {
    for (const [order, text, key] of orders) {
      const button = document.createElement("button");
      button.id = `order_${order}`;
      button.innerHTML = `${text}<kbd aria-hidden="true">${key}</kbd>`;
      button.dataset.key = key;
      button.onclick = () => this.ask({ do: "order", order });
      $("settings_open").before(button);
    }
  }

  // Send a request; if it requires confirmation, ask the operator first.
  async ask(message) {
    const why = this.link.lost ? "no connection" : `values are ${this.link.age_s.toFixed(1)} s old`;
    if (this.link.old) return this.notify(`${why}: ${message.order || message.do} was not sent`);
    const answer = await this.link.ask(message);
    if (!answer.ask) return this.notify(answer.ok ? "" : answer.text);
    this.notify("");
    $("question").textContent = answer.ask;
    const asked_ms = performance.now();
    $("yes").onclick = () => {
      if (!isDeliberate(asked_ms)) return;
      closeDialog($("confirm"));
      this.ask({ ...message, confirmed: true, mode: answer.mode });
    };
    openDialog($("confirm"));
  }

  // Send STOP or HOLD before anything else, whatever this page shows.
  async halt(order) {
    if (!this.link.connected) this.notify(`no connection: ${order.toUpperCase()} was not sent, use the emergency stop`);
    const answered = this.link.ask({ do: "order", order });
    closeDialog($("confirm"));
    const late = setTimeout(() => this.notify(`${order.toUpperCase()} is not confirmed yet: use the emergency stop`), HALT_MS);
    const answer = await answered;
    clearTimeout(late);
    if (answer.text !== "no connection") this.notify(answer.ok ? "" : answer.text);
  }

  notify(text) {
    $("answer").textContent = text;
    clearTimeout(this.clearing);
    if (text) this.clearing = setTimeout(() => this.notify(this.link.old ? text : ""), ANSWER_MS);
  }

  // After a gap in the connection what was answered stays for as long as if it had been answered now.
  reconnected() {
    this.notify($("answer").textContent);
  }

  takeOrRelease() {
    if (this.now.lease && this.now.lease.mine) this.ask({ do: "release" });
    else this.ask({ do: "take_over" });
  }

  open(more = {}) {
    this.ask({ do: "open", scenario: $("scenario").value, rig: $("rig").value, seed: Number($("seed").value), ...more });
  }

  // Answer the question of a commissioning that the page shows.
  reply(yes) {
    this.ask({ do: "reply", question: this.page.question.number, yes });
  }

  // STOP and HOLD first: by the place of the key and by its letter, whatever modifier, layout or focus.
  keyDown(event) {
    const halt = HALT[event.code] || HALT[String(event.key).toLowerCase()];
    const typing = /^(INPUT|SELECT)$/.test(event.target.tagName);
    if (halt && this.now.open !== false && (this.link.connected || !typing)) {
      event.preventDefault();
      event.stopPropagation();
      if (!event.repeat) this.halt(halt);
      return;
    }
    if (event.repeat && (event.key === "Enter" || event.key === " ")) event.preventDefault(); // a held key presses no button twice
    if (event.ctrlKey || event.altKey || event.metaKey || $("who").open) return;
    if ($("confirm").open) {
      if (event.key === "y" && !event.repeat) $("yes").click();
      if (event.key === "Escape") closeDialog($("confirm"));
      return;
    }
    if (event.key === "Escape" && typing) event.target.blur();
    if (typing) return;
    const rows = document.querySelectorAll(".axis").length;
    if (/^[1-9]$/.test(event.key) && Number(event.key) <= Math.max(6, rows)) this.choose(Number(event.key) - 1);
    else if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      event.preventDefault();
      if (!event.repeat) this.jog(this.axis, event.key === "ArrowLeft" ? -1 : 1);
    } else if (!event.repeat) {
      const button = document.querySelector(`button[data-key="${CSS.escape(event.key)}"]`);
      if (button && button.id !== "yes" && !button.disabled) button.click();
    }
  }

  choose(axis) {
    this.axis = axis;
    document.querySelectorAll(".axis").forEach((row, i) => row.classList.toggle("chosen", i === axis));
  }

  // Press the key of one axis, or release it: axis null.
  jog(axis, direction) {
    clearInterval(this.jogging);
    if (this.jogging) this.link.send({ do: "release_key" });
    this.jogging = null;
    if (axis === null || !this.page.bench.axes) return;
    if (this.tooSlowToJog()) return;
    const name = Object.keys(this.page.bench.axes)[axis];
    const press = async (first) => {
      const message = { do: "jog", axis: name, direction };
      if (!first) return this.link.send(message);
      const answer = await this.link.ask(message);
      if (!answer.ok) {
        this.jog(null);
        this.notify(answer.text);
      }
    };
    this.choose(axis);
    press(true);
    this.jogging = setInterval(() => press(false), JOG_MS);
  }

  // Whether a jog would be interrupted: the bench ends it so long after what was drawn. Shows the number.
  tooSlowToJog() {
    const ms = this.link.round_trip_ms, most_ms = 1000 * this.page.jog_round_trip_s;
    if (ms <= most_ms) return false;
    this.notify(`no jog: ${Number.isFinite(ms) ? `a round trip takes ${ms.toFixed(0)} ms` : "the round trip is not known yet"}, allowed ${most_ms} ms`);
    return true;
  }

  // Update the controls from the state of the console.
  show(now, page) {
    const changed = page !== this.page;
    if (!this.page.orders) this.addOrders(page.orders);
    this.now = now;
    this.page = page;
    const mine = now.lease.mine, open = now.open;
    for (const [order] of page.orders) {
      const allowed = open ? page.obeyed_in[order].includes(now.mode) : order === "reset" && page.alarms.some((a) => a.latched);
      $(`order_${order}`).disabled = !(mine && allowed && !page.commissioning);
    }
    $("open").disabled = $("commission").disabled = !mine || open;
    $("commission").hidden = open; // its room is for the axes
    if (changed) this.procedure(page);
    $("reply_yes").disabled = $("reply_no").disabled = !mine || !page.question;
    if (open) stayAwake();
    $("stop").disabled = $("order_hold").disabled = !open;
    const second = now.second_person;
    $("second").hidden = !second;
    const awaited = second ? `Second person: confirm ${second.order} of ${second.by}` : "";
    if ($("second").textContent !== awaited) this.second_ms = performance.now();
    $("second").textContent = awaited;
    $("acknowledge").disabled = !mine || !(page.stop_reason || page.alarms.some((alarm) => !alarm.acknowledged));
    this.settings.show(page, mine && open);
    const jogs = mine && open && !page.commissioning && ["standby", "jogging"].includes(now.mode);
    if (this.jogging && this.tooSlowToJog()) this.jog(null);
    for (const button of document.querySelectorAll(".axis button, #faults button")) button.disabled = !(button.closest(".axis") ? jogs : mine && page.faults && Object.keys(page.faults.menu).length);
    if (!jogs && this.jogging) this.jog(null);
    const text = now.lease.mine ? "Release" : now.lease.holder ? "Take over" : "Take command";
    if ($("take").firstChild.textContent !== text) $("take").firstChild.textContent = text;
    if (changed) this.lists(page, open);
    this.positions(now, page);
  }

  // Step and question of a commissioning; a new question comes into view.
  procedure(page) {
    $("procedure").hidden = !page.commissioning;
    $("step").textContent = page.word;
    const number = page.question ? page.question.number : 0;
    $("asked").textContent = page.question ? page.question.text : "";
    if (number && number !== this.asked) {
      this.asked_ms = performance.now();
      $("procedure").scrollIntoView({ block: "nearest" });
    }
    this.asked = number;
  }

  lists(page, open) {
    for (const [id, names] of [["scenario", page.scenarios], ["rig", page.rigs]]) {
      options($(id), names);
      if (open || $(id).dataset.set !== page.choice[id]) $(id).value = page.choice[id];
      $(id).dataset.set = page.choice[id];
      $(id).disabled = open;
    }
    if (open) $("seed").value = page.choice.seed;
    $("seed").disabled = open;
    options($("fault_device"), Object.keys(page.faults.menu));
    this.faultKinds();
    const on = Object.entries(page.faults.on).filter(([, list]) => list !== "none");
    const none = open ? "this rig has no emulated devices" : "available while an emulated bench is open";
    $("fault_list").textContent = Object.keys(page.faults.menu).length ? on.map(([device, list]) => `${device}: ${list}`).join("; ") : none;
    $("fault_list").classList.toggle("none", !on.length);
    const names = Object.keys(page.bench.axes || {});
    if (this.shown !== String(names)) this.axes(names);
  }

  // Rows of the axes: of another rig with or without those of the target and further ones.
  axes(names) {
    for (const row of document.querySelectorAll(".axis")) row.remove();
    this.shown = String(names);
    if (this.axis >= names.length) this.axis = 0;
    $("jog").firstChild.textContent = `Jog while held: 1..${Math.min(9, names.length || 6)}, then \u2190 \u2192`;
    names.forEach((name, i) => {
      const row = document.createElement("div");
      row.className = `axis ${i < 6 ? "" : "turned"} ${i === this.axis ? "chosen" : ""}`;
      const [group, axis] = name.split(".");
      row.innerHTML = `<span></span><span class="where"><b>-</b><i></i></span>`;
      row.firstChild.textContent = `${i < 9 ? i + 1 : ""} ${i < 6 ? "" : group === "target" ? "t." : `${group}.`}${axis}`;
      for (const [direction, sign] of [[-1, "\u2212"], [1, "+"]]) {
        const button = document.createElement("button");
        button.textContent = sign;
        button.ariaLabel = `jog ${name} ${direction < 0 ? "down" : "up"} while held`;
        button.disabled = true;
        button.onpointerdown = () => this.jog(i, direction);
        button.onpointerleave = () => this.jog(null);
        row.append(button);
      }
      $("jog").append(row);
    });
  }

  positions(now, page) {
    if (!now.rail_m) return;
    const further = Object.values(now.further_axes || {}), units = Object.keys(page.bench.axes).map((name) => page.bench.units[name.split(".")[0]]);
    const limits = Object.values(page.bench.axes);
    const values = [...now.rail_m, ...now.gimbal_deg, ...(now.target_deg || []), ...further.flatMap((group) => group.m || group.deg)];
    const rates = [...now.rail_mps, ...now.gimbal_degps, ...(now.target_degps || []), ...further.flatMap((group) => group.mps || group.degps)]; // shown from the seventh on
    document.querySelectorAll(".axis .where").forEach((where, i) => {
      if (values[i] === undefined) return; // of the session before
      const [low, high] = limits[i], value = values[i];
      const note = now.limit[i] ? " on limit switch" : now.homing[i] === 2 ? "" : " not homed";
      const turns = units[i] === "deg", unit = turns ? "\u00b0" : " m";
      where.firstChild.textContent = `${value === null ? "-" : value.toFixed(turns ? 2 : 3)} ${turns ? "\u00b0" : "m"}${note}`;
      where.classList.toggle("limit", Boolean(note));
      if (i >= 6 && !note && value !== null) where.firstChild.textContent = `${value.toFixed(turns ? 2 : 3)}${unit} ${(rates[i] ?? NaN).toFixed(turns ? 1 : 3)}${unit}/s`;
      where.title = `${limits[i].join(" to ")} ${turns ? "\u00b0" : "m"}`;
      where.lastChild.style.left = `${Math.min(97, Math.max(0, (100 * (value - low)) / (high - low)))}%`;
    });
  }

  kind() {
    const device = this.page.faults.menu[$("fault_device").value];
    return device && device.kinds[$("fault_kind").value];
  }

  faultKinds() {
    const device = this.page.faults.menu[$("fault_device").value];
    options($("fault_kind"), device ? Object.keys(device.kinds) : []);
    this.faultAxes();
  }

  faultAxes() {
    const device = this.page.faults.menu[$("fault_device").value], kind = this.kind();
    options($("fault_axis"), kind && kind.of_axis ? device.axes : []);
    $("fault_axis").disabled = !(kind && kind.of_axis);
    $("fault_value").disabled = !(kind && kind.value);
    $("fault_value").placeholder = kind && kind.value ? `${kind.value} (${kind.default})` : "";
  }

  switchFault() {
    const kind = this.kind();
    const words = ["on", $("fault_kind").value];
    if (kind && kind.of_axis) words.push($("fault_axis").value);
    if (kind && kind.value && $("fault_value").value !== "") words.push($("fault_value").value);
    this.ask({ do: "fault", device: $("fault_device").value, line: words.join(" ") });
  }
}

// Whether an answer to a question that was drawn at asked_ms is no second click or repeated key of the act before.
const isDeliberate = (asked_ms) => performance.now() - asked_ms > YES_AFTER_MS;

// Keep the screen of a phone or tablet on while a bench is open, where the browser can: on https pages.
let awake = null;
async function stayAwake() {
  if (awake || !navigator.wakeLock || document.visibilityState !== "visible") return;
  awake = navigator.wakeLock.request("screen").catch(() => null);
  const lock = await awake;
  if (lock) lock.addEventListener("release", () => (awake = null));
}

function options(select, names) {
  if ([...select.options].map((option) => option.value).join() === names.join()) return;
  const before = select.value;
  select.replaceChildren(...names.map((name) => new Option(name)));
  if (names.includes(before)) select.value = before;
}
