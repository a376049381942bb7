"""What a session has told of itself, as the pages get it."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.console.recording_watch import RecordingWatch
from hil.console.status import DEVICES, MODES, UNKNOWN, empty_status, status_of
from hil.core.modes import Mode
from hil.gnc.filter_monitor import nis_band
from hil.monitor.results import QUANTITIES
from hil.monitor.screen.overlay import NUMBERS

_NIS_TAIL: Final = 0.0027  # what lies beyond three sigma of a normal number
_SHOWN_EVENTS: Final = 20


class SessionState:
    """Alarms, events, status and last words of one session; of the last one, after it has ended.

    bench: what a page has to know of bench and run to draw them.
    """

    def __init__(self, bench: dict[str, Any], word: str) -> None:
        self.bench = bench
        self.word = word
        self.alarms: list[dict[str, Any]] = []
        self.events: list[dict[str, Any]] = []
        self.hold_reason = ""
        self.ended: dict[str, Any] | None = None
        self.recording = RecordingWatch()
        self.closing = False
        """Whether the loop has ended and only the files are yet to be closed."""
        self._status = empty_status()
        self._number = 0
        self._came_s = -math.inf

    def take_status(self, number: int, status: np.ndarray, now_s: float) -> None:
        """Take the newest STATUS (1,), the ``number``-th that was written."""
        if number != self._number:
            self._number, self._status, self._came_s = number, status, now_s

    @property
    def mode(self) -> Mode:
        """As last told; OFF before anything was."""
        mode: Mode = MODES[int(self._status["mode"][0])] if self._number else Mode.OFF
        return mode

    def hear(self, message: dict[str, Any]) -> list[str]:
        """Take what the session says; return what of it belongs into the log."""
        lines: list[str] = []
        if "alarms" in message:
            known = {alarm["text"] for alarm in self.alarms if alarm["latched"]}
            lines += [f"alarm: {alarm['text']}" for alarm in message["alarms"] if alarm["text"] not in known]
            if message["hold_reason"] not in ("", self.hold_reason):
                lines.append(f"hold: {message['hold_reason']}")
            self.alarms, self.events = message["alarms"], message["events"]
            self.hold_reason = message["hold_reason"]
        self.closing = self.closing or "closing" in message
        if "word" in message:
            self.word = message["word"]
            lines.append(self.word)
        if "ended" in message:
            self.ended = message["ended"]
            self.word = f"session ended: {message['ended']['stop']}"
            lines.append(self.word)
            if problem := message["ended"].get("recording", {}).get("problem"):
                lines.append(f"recording: {problem}")
        if "refused" in message:
            self.word = message["refused"][0]
            lines += message["refused"]
        return lines

    @property
    def unseen(self) -> bool:
        """Whether an alarm has not been acknowledged."""
        return any(not alarm["acknowledged"] for alarm in self.alarms)

    def acknowledge(self) -> None:
        """Somebody has seen all alarms."""
        self.alarms = [alarm | {"acknowledged": True} for alarm in self.alarms]

    def let_go(self) -> None:
        """Unlatch all alarms."""
        self.alarms = [alarm | {"latched": False} for alarm in self.alarms]

    def now(self, now_s: float) -> dict[str, Any]:
        """Return what changes all the time; nothing before the session's first word."""
        if not self._number:
            return {}
        status, since_s = status_of(self._status), now_s - self._came_s
        return {
            "status_age_s": since_s,
            "ages_s": {name: _number(status.age_s[i] + since_s) for i, name in enumerate(DEVICES)},
            "bench_s": _number(status.bench_s),
            "run_s": _number(status.run_s),
            "share": _number(status.share),
            "rail_m": [_number(v) for v in status.feedback.rail_m],
            "gimbal_deg": [_number(math.degrees(v)) for v in status.feedback.gimbal_rad],
            "rail_mps": [_number(v) for v in status.feedback.rail_mps],
            "gimbal_degps": [_number(math.degrees(v)) for v in status.feedback.gimbal_radps],
            "homing": [int(v) for v in status.homing],
            "limit": [int(v) for v in status.limit],
            "estop": None if status.estop == UNKNOWN else bool(status.estop),
            "frames": int(status.frames),
            "overruns": int(status.overruns),
            "skipped_periods": int(status.skipped_periods),
            "limited_cycles": int(status.limited_cycles),
        }

    def page(self) -> dict[str, Any]:
        """Return the rest."""
        return {
            "bench": self.bench,
            "alarms": self.alarms,
            "events": self.events[-_SHOWN_EVENTS:],
            "word": self.word,
            "hold_reason": self.hold_reason,
            "ended": self.ended,
        }


def _number(value: float) -> float | None:
    """Return ``value``; None for one that is not finite, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def _monitor_numbers(scenario: Scenario) -> list[dict[str, Any]]:
    """Return how each of the docking monitor's numbers is shown; none where there is no monitor."""
    if scenario.monitor.source == "none":
        return []
    return [
        {"at": QUANTITIES.index(name), "name": label, "unit": unit, "scale": scale, "decimals": decimals}
        for name, label, unit, scale, decimals in NUMBERS
    ]


def described(rig: Rig, scenario: Scenario) -> dict[str, Any]:
    """Return what a page has to know of the bench and of the run to draw them."""
    rails = {f"rails.{name}": [*getattr(rig.rails, name).travel_m] for name in RAIL_NAMES}
    gimbals = {f"turntable.{name}": [*getattr(rig.turntable, name).travel_deg] for name in GIMBAL_NAMES}
    guidance, corridor = scenario.gnc.guidance, scenario.gnc.corridor
    return {
        "axes": rails | gimbals,
        "stale_s": {
            "rails": rig.rails.timeout_s,
            "turntable": rig.turntable.timeout_s,
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
        "nis_bound": nis_band(1, _NIS_TAIL)[1],
        "late_us": rig.host.late_wakeup_us,
    }
