// Displayed values: header, ages, alarms, log.

import { norm } from "/page/space.js";

const $ = (id) => document.getElementById(id);
const STATUS_OLD_S = 0.5;

export function isStale(now) {
  return !now.ready || now.status_age_s === undefined || now.status_age_s > STATUS_OLD_S;
}

// Show whether keys and orders reach the bench; no button looks alive while they do not.
export function reach(link) {
  const lost = link.lost, old = link.old, away = !document.hasFocus();
  document.body.classList.toggle("lost", old);
  document.body.classList.toggle("away", away);
  const waits = link.seen_s === null ? "Nothing received from the console yet" : `No connection to the console: values are ${link.age_s.toFixed(1)} s old`;
  const late = `Values are ${link.age_s.toFixed(1)} s old: STOP may be late, use the emergency stop; other commands are off`;
  const text = lost ? `${waits}: STOP may not arrive, use the emergency stop` : old ? late : "Keys do not reach this window: click into it";
  $("reach").textContent = old || away ? text : "";
}

export function header(now, page, store) {
  const stale = isStale(now);
  document.body.classList.toggle("old", stale);
  $("mode").textContent = now.mode;
  $("mode").dataset.mode = now.mode;
  $("run_s").textContent = now.run_s === undefined || now.run_s === null ? "-" : now.run_s.toFixed(1);
  const r = store.vector("estimate_m"), v = store.vector("velocity_estimate_mps");
  const range = norm(r), closing = -(r[0] * v[0] + r[1] * v[1] + r[2] * v[2]) / range;
  $("range").textContent = Number.isFinite(range) ? range.toFixed(3) : "-";
  $("closing").textContent = Number.isFinite(closing) ? (1000 * closing).toFixed(1) : "-";
  const margin = store.last("corridor_margin_m");
  $("margin").textContent = Number.isFinite(margin) ? margin.toFixed(3) : "-";
  const phase = store.last("phase");
  const names = page.bench.phases ? [...page.bench.phases, "brake", "retreat", "hold"] : [];
  $("phase").textContent = store.last("aborted") > 0 ? `ABORT ${names[phase] || ""}` : names[phase] || "-";
  $("share").value = now.mode === "running" && page.bench.duration_s ? now.run_s / page.bench.duration_s : now.share || 0;
  $("holder").textContent = now.lease.mine ? "You have command" : now.lease.holder ? `${now.lease.holder} has command` : "no operator has command";
  $("leave").textContent = "Sign out";
  $("leave").title = `Sign out ${now.me.name}${now.me.key ? `, key ${now.me.key}` : ""}, may ${now.me.rights}`;
  $("word").textContent = statusText(now, page);
  recording(now.recording);
  $("share").hidden = $("recording").hidden = !now.open; // leaves space for the result
}

// State of the recording: size and losses.
function recording(found) {
  const [state, rest] = $("recording").children;
  state.textContent = !found ? "-" : found.trouble ? "REC \u2715" : "REC \u25cf";
  const size = found && `${(found.size_bytes / 1e6).toFixed(1)} MB`;
  rest.textContent = !found ? "not recorded" : found.trouble ? "NOT RECORDED" : `${size}, ${found.lost} lost`;
  $("recording").className = `value ${found ? (found.trouble || found.lost ? "bad" : "good") : ""}`;
  $("recording").title = found ? found.trouble || found.file : "";
}

function statusText(now, page) {
  if (now.mode === "hold" && page.hold_reason) return page.hold_reason;
  if (page.ended && !now.open) {
    const { accepted, stop } = page.ended;
    return `${accepted === null ? "" : accepted ? "PASS. " : "FAIL. "}${page.word || stop}`;
  }
  return page.word || (page.ended ? page.ended.stop : `${page.choice.scenario} on ${page.choice.rig}, seed ${page.choice.seed}`);
}

// link_age_s: time since the last message
export function ages(now, page, link_age_s) {
  const stale = page.bench.stale_s || {};
  const sensors = (now.sensors || []).map(({ name, age_s, sigmas, state }) => {
    const text = state || (sigmas === null ? "" : `${sigmas.toFixed(1)} \u03c3`);
    return [text ? `${name} ${text}` : name, age_s, page.bench.sensors[name], state];
  });
  const entries = [
    ...(page.bench.stale_s ? Object.keys(stale) : ["rails", "turntable", "vmu", "io"]).map((name) => [name, now.ages_s ? now.ages_s[name] : null, stale[name]]),
    ...sensors,
    ["loop", now.status_age_s ?? null, STATUS_OLD_S],
    ["link", link_age_s, STATUS_OLD_S],
  ];
  fill($("ages"), entries, "div", (row, [name, age_s, limit_s, state]) => {
    if (!row.firstChild) row.innerHTML = "<span></span><b></b>";
    row.firstChild.textContent = name;
    row.lastChild.textContent = age_s === null || age_s === undefined ? "-" : age_s < 100 ? `${Math.max(0, age_s).toFixed(2)} s` : "old";
    row.firstChild.className = state ? "old" : "";
    const old = limit_s && age_s > limit_s;
    row.lastChild.className = old ? "old" : age_s === null || age_s === undefined ? "stale" : "";
  });
}

export function alarms(page) {
  const rank = { high: 0, medium: 1, low: 2 };
  const order = [...page.alarms].sort((a, b) => b.latched - a.latched || rank[a.priority] - rank[b.priority] || b.t_s - a.t_s);
  fill($("alarmlist"), order, "li", (row, alarm) => {
    row.className = `${alarm.latched ? "latched" : ""} ${alarm.acknowledged || alarm.shelved_until_s ? "" : "new"} ${alarm.priority}`;
    row.dataset.number = alarm.number;
    row.title = "click: acknowledge; with shift: shelve for 10 min";
    const stands = alarm.shelved_until_s ? "shelved" : alarm.priority === "high" ? (alarm.latched ? "latched" : "reset") : alarm.active ? "active" : "normal again";
    text(row, `${alarm.t_s.toFixed(2)} s ${alarm.priority}, ${stands}, ${alarm.acknowledged ? "acknowledged" : "NEW"}`, alarm.text);
  });
  const first = order.find((alarm) => alarm.latched && !alarm.shelved_until_s);
  $("alarmline").textContent = first ? `\u26a0 ${first.text}${first.acknowledged ? " (acknowledged)" : ""}` : page.stop_reason && `\u26a0 ${page.stop_reason}`;
  $("alarmline").classList.toggle("seen", Boolean(first && first.acknowledged));
}

export function waived(page) {
  fill($("waived"), page.bench.waived || [], "li", (row, waiver) => text(row, `WAIVED ${waiver.key} = ${waiver.value}`, waiver.takes_away));
}

export function log(page, wall_s) {
  const events = page.events.map((event) => ({ when: `run ${event.t_s.toFixed(1)} s`, text: event.text }));
  const lines = page.log.map((line) => ({ when: `${Math.max(0, wall_s - line.wall_s).toFixed(0)} s ago`, text: line.text }));
  fill($("loglist"), [...lines.reverse().slice(0, 20), ...events.reverse()], "li", (row, line) => text(row, line.when, line.text));
}

function text(row, small, words) {
  if (!row.firstChild) row.append(document.createElement("small"), "");
  row.firstChild.textContent = small;
  row.lastChild.textContent = words;
}

// Keep as many children as entries, and let show(child, entry) fill each.
function fill(list, entries, tag, show) {
  while (list.children.length > entries.length) list.lastChild.remove();
  while (list.children.length < entries.length) list.append(document.createElement(tag));
  entries.forEach((entry, i) => show(list.children[i], entry));
}
