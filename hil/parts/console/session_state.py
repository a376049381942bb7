"""State of a session for the clients: alarms, events, status, recording."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import numpy as np

from hil.checks.waivers import waivers
from hil.config.rig import BENCH_AXES, Rig
from hil.config.scenario import Scenario
from hil.core.modes import Mode
from hil.gnc.estimation.filter_monitor import nis_band
from hil.maths.limits import finite_or_none
from hil.params.sensors import sensors_of
from hil.parts.console.status import DEVICES, MODES, UNKNOWN, empty_status, status_of
from hil.parts.monitor.results import QUANTITIES
from hil.parts.monitor.screen.overlay import NUMBERS

_NIS_TAIL: Final = 0.0027  # probability beyond three sigma of a normal variable
SILENT_S: Final = 2.0
"""The recorder reports ten times per second; after this time without a report it counts as dead."""
_SHOWN_EVENTS: Final = 20
_SENSOR_PERIODS: Final = 3.0  # without a sample, after which a sensor is shown as silent
SENSOR_STATES: Final = ("", "suspect", "disagrees")
TARGET: Final = "target"
"""Device of the rotary manipulator, as in the names of its axes."""


class RecordingStatus:
    """Status of the recording into ``file``; "" if nothing is recorded."""

    def __init__(self, file: str = "") -> None:
        self.file = file
        self._size_bytes = self._lost = 0
        self._trouble = ""

    def update(self, state: np.ndarray, silent_s: float) -> list[str]:
        """Update from recorder.STATE (1,) and the time since the last report; return new lines for the log."""
        row = state[0]
        trouble = row["problem"].decode(errors="replace")
        if not trouble and silent_s > SILENT_S:
            trouble = f"no report of its process for {SILENT_S:g} s"
        lines = []
        if trouble and trouble != self._trouble:
            lines.append(f"recording: {self.file}: {trouble}: recording stopped, the bench continues")
        if self._trouble and not trouble:
            lines.append("recording: continues")
        lost = int(row["dropped"])
        if lost and not self._lost and not trouble:
            lines.append(f"recording: {self.file}: {lost} messages lost by overload, further losses are counted")
        self._size_bytes, self._lost, self._trouble = int(row["size_bytes"]), lost, trouble
        return lines

    def as_json(self) -> dict[str, Any] | None:
        """Return the recording's status for the page; None if nothing is recorded."""
        if not self.file:
            return None
        name = Path(self.file).name
        return {"file": name, "size_bytes": self._size_bytes, "lost": self._lost, "trouble": self._trouble}


class SessionState:
    """Alarms, events, status and messages of one session; after its end those of the last one.

    bench: description of bench and run for drawing. status_text: line shown on the page.
    """

    def __init__(self, bench: dict[str, Any], status_text: str) -> None:
        self.bench = bench
        self.status_text = status_text
        self.alarms: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.hold_reason = ""
        self.search: list[int] | None = None
        """Region of search of the docking monitor: u, v, width, height, px; None: the whole image."""
        self.ended: dict[str, Any] | None = None
        self.question: dict[str, Any] | None = None
        """Of a commissioning, to be answered: number and text."""
        self.recording = RecordingStatus()
        self.closing = False
        """Whether the loop has ended and only the files are still being closed."""
        self._status = empty_status()
        self._number = 0
        self._received_s = -math.inf

    def set_status(self, number: int, status: np.ndarray, now_s: float) -> None:
        """Set the newest STATUS (1,), the ``number``-th that was written."""
        if number != self._number:
            self._number, self._status, self._received_s = number, status, now_s

    @property
    def mode(self) -> Mode:
        """Mode of the last status; OFF before the first one."""
        mode: Mode = MODES[int(self._status["mode"][0])] if self._number else Mode.OFF
        return mode

    def apply(self, message: dict[str, Any]) -> list[str]:
        """Apply a message of the session; return new lines for the log."""
        lines: list[str] = []
        if "alarms" in message:
            latched = {alarm["text"] for alarm in self.alarms if alarm["latched"]}
            lines += [f"alarm: {alarm['text']}" for alarm in message["alarms"] if alarm["text"] not in latched]
            if message["hold_reason"] not in ("", self.hold_reason):
                lines.append(f"hold: {message['hold_reason']}")
            self.alarms, self.events = message["alarms"], message["events"]
            self.hold_reason = message["hold_reason"]
        self.closing = self.closing or "closing" in message
        if "question" in message:
            self.question = message["question"]
            lines += [f"asks: {self.question['text']}"] if self.question else []
        if "word" in message:
            self.status_text = message["word"]
            lines.append(self.status_text)
        if "ended" in message:
            self.ended = message["ended"]
            if "signed" not in message["ended"]:
                self.status_text = f"session ended: {message['ended']['stop']}"
                lines.append(self.status_text)
            if problem := message["ended"].get("recording", {}).get("problem"):
                lines.append(f"recording: {problem}")
            if audit := message["ended"].get("recording", {}).get("audit"):
                lines.append(f"recording: audit of {audit['entries']} entries, last digest {audit['digest']}")
        if "ended" in message or "refused" in message:
            self.question = None
        if "refused" in message:
            self.status_text = message["refused"][0]
            lines += message["refused"]
        return lines

    @property
    def unacknowledged(self) -> bool:
        """Whether an alarm that is not shelved is not acknowledged."""
        return any(not alarm["acknowledged"] and not alarm.get("shelved_until_s") for alarm in self.alarms)

    def acknowledge(self, number: int | None = None) -> None:
        """Mark alarm ``number``, None for all, as acknowledged; one that has returned to normal no longer stands."""
        self.alarms = [
            alarm | {"acknowledged": True, "latched": alarm["latched"] and alarm.get("active", True)}
            if number in (None, alarm.get("number"))
            else alarm
            for alarm in self.alarms
        ]

    def unlatch(self) -> None:
        """Unlatch all alarms."""
        self.alarms = [alarm | {"latched": False} for alarm in self.alarms]

    def live(self, now_s: float) -> dict[str, Any]:
        """Return the live part of the state; empty before the first status."""
        if not self._number:
            return {}
        status, since_s = status_of(self._status), now_s - self._received_s
        axes = len(self.bench.get("axes", BENCH_AXES))
        ages_s = {name: finite_or_none(status.age_s[i] + since_s) for i, name in enumerate(DEVICES)}
        further = self._further_axes(status)
        rotated = further.pop(TARGET) if self._is_rotated else None
        return {
            "status_age_s": since_s,
            "ages_s": ages_s
            | {name: finite_or_none(status.axis_age_s[places][0] + since_s) for name, places in self._groups().items()},
            "bench_s": finite_or_none(status.bench_s),
            "run_s": finite_or_none(status.run_s),
            "share": finite_or_none(status.fraction),
            "rail_m": [finite_or_none(v) for v in status.feedback.rail_m],
            "gimbal_deg": [finite_or_none(math.degrees(v)) for v in status.feedback.gimbal_rad],
            "rail_mps": [finite_or_none(v) for v in status.feedback.rail_mps],
            "gimbal_degps": [finite_or_none(math.degrees(v)) for v in status.feedback.gimbal_radps],
            "homing": [int(v) for v in status.homing[:axes]],
            "limit": [int(v) for v in status.limit[:axes]],
            "estop": None if status.estop == UNKNOWN else bool(status.estop),
            "frames": int(status.frames),
            "overruns": int(status.overruns),
            "skipped_periods": int(status.skipped_periods),
            "limited_cycles": int(status.limited_cycles),
            "sensors": [
                {
                    "name": name,
                    "age_s": finite_or_none(status.run_s - row["measured_s"] + since_s),
                    "sigmas": finite_or_none(row["sigmas"]),
                    "state": SENSOR_STATES[row["state"]],
                }
                for name, row in zip(self.bench.get("sensors", {}), status.sensors, strict=False)
            ],
            **({"further_axes": further} if further else {}),
            **({"target_deg": rotated["deg"], "target_degps": rotated["degps"]} if rotated else {}),
            **(_relative(status) if self.bench.get("target_moves") else {}),
        }

    @property
    def _is_rotated(self) -> bool:
        """Whether the rig has a rotary manipulator."""
        return bool(self.bench.get("units", {}).get(TARGET) == "deg")

    def _groups(self) -> dict[str, slice]:
        """Return the places of the axes after the first six in the status, by the names of their groups."""
        groups: dict[str, slice] = {}
        for number, axis in enumerate(self.bench.get("axes", ())):
            if number >= len(BENCH_AXES):
                group = axis.partition(".")[0]
                groups[group] = slice(groups[group].start if group in groups else number, number + 1)
        return groups

    def _further_axes(self, status: np.record) -> dict[str, dict[str, list[float | None]]]:
        """Return positions and rates of the axes after the first six, by groups: ``m`` and ``mps``, or in degrees."""
        axes = {}
        for name, places in self._groups().items():
            unit = self.bench["units"][name]
            scale = math.degrees(1.0) if unit == "deg" else 1.0
            axes[name] = {
                unit: [finite_or_none(scale * v) for v in status.position[places]],
                f"{unit}ps": [finite_or_none(scale * v) for v in status.rate[places]],
            }
        return axes

    def page(self) -> dict[str, Any]:
        """Return the slow part of the state."""
        return {
            "bench": self.bench,
            "alarms": self.alarms,
            "events": self.events[-_SHOWN_EVENTS:],
            "word": self.status_text,
            "hold_reason": self.hold_reason,
            "search": self.search,
            "ended": self.ended,
            "question": self.question,
        }


def _relative(status: np.record) -> dict[str, Any]:
    """Return the axes of the chaser's rig relative to a target that moves."""
    return {
        "relative": {
            "rail_m": [finite_or_none(v) for v in status.relative.rail_m],
            "gimbal_deg": [finite_or_none(math.degrees(v)) for v in status.relative.gimbal_rad],
        },
    }


def _monitor_numbers(scenario: Scenario) -> list[dict[str, Any]]:
    """Return the display format of the docking monitor's numbers; empty without a monitor."""
    if not scenario.monitor.has_images:
        return []
    return [
        {"at": QUANTITIES.index(name), "name": label, "unit": unit, "scale": scale, "decimals": decimals}
        for name, label, unit, scale, decimals in NUMBERS
    ]


def bench_description(rig: Rig, scenario: Scenario) -> dict[str, Any]:
    """Return the description of bench and run that a page needs to draw them."""
    axes = [axis for table in rig.axis_groups.values() for axis in table.axes]
    guidance, corridor = scenario.gnc.guidance, scenario.gnc.corridor
    return {
        "axes": {name: [*axis.in_file("travel")] for name, axis in zip(rig.axis_names, axes, strict=True)},
        "target_moves": rig.moving_target is not None,
        "units": {name: "m" if table.si_per_unit == 1.0 else "deg" for name, table in rig.axis_groups.items()},
        "stale_s": {
            **{name: table.timeout_s for name, table in rig.axis_groups.items()},
            "vmu": rig.vmu.timeout_s,
            "io": rig.io.timeout_s if rig.io is not None and rig.has_io else None,
        },
        "lever_arm_m": rig.bench.lever_arm_m,
        "ring_m": rig.vmu.leds_m,
        "ring_axes": rig.bench.led_ring_axes,
        "ring_station_m": rig.bench.led_ring_position_m,
        "camera_station_m": rig.bench.camera_position_m,
        "camera_axes": rig.bench.camera_axes,
        "camera": rig.vmu.camera.model_dump(),
        "ready_point_m": guidance.ready_point_m,
        "corridor": {
            "axis": corridor.axis,
            "half_angle_deg": corridor.half_angle_deg,
            "minimum_radius_m": corridor.minimum_radius_m,
        },
        "start_m": scenario.initial.position_m,
        "phases": guidance.sequence,
        "thrusters": len(scenario.chaser.thrusters.position_m),
        "step_s": scenario.step_s,
        "duration_s": scenario.duration_s,
        "picture_stale_s": 2.0 * rig.recording.image_interval_s + 1.0,
        "monitor": _monitor_numbers(scenario),
        "sensors": {
            name: max(1.0, _SENSOR_PERIODS / (config.rate_hz or kind.module.rate_hz))
            for name, (kind, config, _) in sensors_of(scenario).items()
        },
        "nis_bound": nis_band(1, _NIS_TAIL)[1],
        "late_us": rig.host.late_wakeup_us,
        "waived": [waiver.as_json() for waiver in waivers(rig, scenario)],
    }
