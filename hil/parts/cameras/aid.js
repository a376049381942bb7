"use strict";
const element = (id) => document.getElementById(id);
const shown = (value, digits, unit) => (value === null || value === undefined ? "-" : value.toFixed(digits) + unit);

function showSide(name, side, number) {
  const advice = element(`${name}-advice`);
  advice.textContent = side === null ? "packets lost: lower the rate or the packet size" : side.advice;
  advice.className = `advice ${side !== null && side.advice === "ok" ? "ok" : "change"}`;
  if (side === null) return;
  element(name).src = `${name}.jpg?${number}`;
  const rows = [
    ["spots", side.spots], ["saturated", side.saturated], ["width", shown(side.width_px, 2, " px")],
    ["peak (median)", shown(side.peak, 0, " of 255")], ["background", shown(side.background, 0, "")],
    ["shutter", side.shutter || "not stated"],
  ];
  element(`${name}-numbers`).replaceChildren(...rows.flatMap(([term, text]) => {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = term;
    dd.textContent = text;
    return [dt, dd];
  }));
}

let last = 0;
async function look() {
  try {
    const state = await (await fetch("state.json", { cache: "no-store" })).json();
    if (state.number !== last) {
      last = state.number;
      showSide("left", state.left, last);
      showSide("right", state.right, last);
      const pose = state.status ? `, ${state.status}, epipolar ${shown(state.epipolar_px, 3, " px")}, range ${shown(state.range_m, 3, " m")}` : "";
      const skew = state.skew_s === null ? "no time stamps" : `skew ${(1e6 * state.skew_s).toFixed(0)} us`;
      const mtu = Math.max(...state.packet_bytes);
      const network = mtu ? `, needs an MTU of ${mtu} bytes` : "";
      element("pair").textContent = `pair ${last}${pose}, ${skew}, lost ${state.lost[0]} and ${state.lost[1]}${network}`;
      element("saved").textContent = state.saved === null ? "" : `${state.saved} pairs saved`;
    }
  } catch {
    element("pair").textContent = "no connection: has the command ended?";
  }
  setTimeout(look, 150);
}
element("save").addEventListener("click", () => fetch("save", { method: "POST", headers: { "X-Camera-Aid": "1" } }));
look();
