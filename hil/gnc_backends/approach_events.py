"""Event log of the approach: phases, abort, readiness and the docking decision."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.config.scenario import REACTION_NAMES
from hil.core.messages import Event
from hil.core.observable import ObservableList
from hil.gnc import approach_monitor, docking_go, reactions
from hil.gnc.estimation import hypotheses
from hil.gnc.reactions import ABORT

ABORT_CAUSES = (
    "",
    "the corridor was left",
    "the closing rate was too high",
    "ordered",
    "vision was lost",
    "vision is suspect",
    "the IMU is suspect",
    "a thruster has failed",
    "the docking monitor disagrees",
    "a covariance of the filters is invalid",
    "the protection level exceeds the alert limit",
    "a hold lasted too long",
    "the encoders contradict the estimate",
    "a further sensor is suspect",
    "the measurements are inconsistent, their cause is not known",
)
_HYPOTHESES = {
    hypotheses.SWING: "the chaser swings at {:.2g} Hz without thrust, a flexible mode or slosh beyond gnc.modes",
    hypotheses.DISTURBANCE: "the force without thrust has changed, a leak or another disturbance",
    hypotheses.SCALE: "the accelerometer reads other than the commanded thrust, a scale, the mass or the thrust",
    hypotheses.ATTITUDE: "those of the attitude alone, the ephemeris, the gyros or the vision unit",
    hypotheses.COMMANDS: "the commanded thrust, which replaces an IMU that is suspect, or the vision unit",
    hypotheses.CORRELATED: "noise of the poses that is more correlated than the budget's, or the vision unit",
    hypotheses.READINGS: "the IMU reads what no thruster gives, a flexible mode or slosh, or a device that has failed",
}
_ESCAPE = ("brake", "retreat", "hold")
DOCKING_GO = "docking: go"


_DIRECTIONS = ("along the docking axis", "across the docking axis", "of the attitude")
_AXES = ("x", "y", "z", "angle x", "angle y", "angle z", "velocity x", "velocity y", "velocity z",
         "rate x", "rate y", "rate z")  # fmt: skip
_SUMS = (*_AXES[:6], "x + y", "x - y", "y + z", "y - z", "z + x", "z - x")


def limit_text(cause: int, state: np.record | None) -> str:
    """Return the limit behind ``cause`` of an abort or a reaction, with its value: ": ..."; "" if it is unknown.

    state: APPROACH_STATE.
    """
    if state is None:
        return ""
    watched = state["reactions"]
    if cause in (approach_monitor.CORRIDOR, approach_monitor.CLOSING_RATE):
        value, limit = float(watched["broken"]["value"]), float(watched["broken"]["limit"])
        if limit == 0.0:
            return ""
        if cause == approach_monitor.CORRIDOR:
            return f": {value:.3f} m from the line with the protection level, allowed {limit:.3f} m"
        return f": {value:.4f} m/s with its uncertainty, allowed {limit:.4f} m/s"
    if cause == approach_monitor.BENCH_DISAGREES:
        axis, value, limit = (float(number) for number in state["bench_breach"])
        return f": {_AXES[int(axis)]} {_shown(int(axis), value)} off, allowed {_shown(int(axis), limit)}"
    if cause == approach_monitor.FIRST_HEALTH_CAUSE and watched["from_future"]:
        return (
            f": {int(watched['from_future'])} poses were stamped in the future, the clock of the vision unit is ahead"
        )
    if cause == approach_monitor.CAUSE_UNKNOWN:
        text = _HYPOTHESES.get(int(watched["hypothesis"]), "")
        return f": {text.format(0.5 / max(float(watched['half_swing_s']), 1e-3))}" if text else ""
    if cause in (approach_monitor.UNPROTECTED, approach_monitor.FIRST_HEALTH_CAUSE, approach_monitor.HELD_TOO_LONG):
        return _level_text(watched)
    return ""


def _level_text(watched: np.record) -> str:
    """Return the protection level that is nearest its alert limit."""
    levels, limits = np.asarray(watched["level"]), np.asarray(watched["limit"])
    if not (levels > 0.0).any():
        return ""
    worst = int(np.argmax(levels * limits.max() / np.maximum(limits, 1e-12)))
    kind = 3 if worst == approach_monitor.ATTITUDE else 0
    return f": level {_DIRECTIONS[worst]} {_shown(kind, levels[worst])}, alert limit {_shown(kind, limits[worst])}"


def go_limit_text(state: np.record | None) -> str:
    """Return what is missing for a go, ": ..."; "" if it is unknown. state: APPROACH_STATE."""
    if state is None:
        return ""
    go = state["go"]
    lacks, axis, value, limit = int(go["lacks"]), int(go["axis"]), float(go["value"]), float(go["limit"])
    numbers = f"{_AXES[axis]} {_shown(axis, value)}, allowed {_shown(axis, limit)}"
    if lacks == docking_go.UNBOUNDED:
        return _level_text(state["reactions"])
    if lacks == docking_go.SUM:
        return f": innovations of {_SUMS[axis]} sum up to {value:.1f} standard deviations, allowed {limit:.1f}"
    if lacks == docking_go.HEALTH:
        bit = int(value) & -int(value)
        return f": {ABORT_CAUSES[reactions.cause_of(bit.bit_length() - 1)]}" if bit else ""
    words = {
        docking_go.DEVIATION: "",
        docking_go.LEVEL: "with its level ",
        docking_go.ENCODERS: "encoders show ",
        docking_go.FIRING: "smallest firings give ",
        docking_go.HOLD: "control holds with the level ",
    }
    if lacks in words and limit > 0.0:
        return f": {words[lacks]}{numbers if math.isfinite(value) else f'{_AXES[axis]} without bound'}"
    return ""


def _shown(axis: int, value: float) -> str:
    """Return the value of a component with its unit; axis: 0 to 2 m, 3 to 5 rad, then m/s, rad/s."""
    unit = ("m", "deg", "m/s", "deg/s")[axis // 3]
    return f"{math.degrees(value) if unit.startswith('deg') else value:.4f} {unit}"


class ApproachEventLog:
    """Writes an event for each difference between the progress of the approach before and after a step.

    phases: names of the phases in their order. dwell_s: for which the ready state must have held, on the estimate,
    for docking to be a go.
    """

    def __init__(self, phases: Sequence[str], dwell_s: float) -> None:
        self._phases = phases
        self._brake = len(phases)
        self._dwell_s = dwell_s
        self._has_decision = False
        self.events: ObservableList[Event] = ObservableList()
        self._log_phase(0.0, 0, 0)

    def update(
        self, t_s: float, before: np.void, after: np.void, supervision: np.record, state: np.record | None = None
    ) -> None:
        """Log what has changed, with the limit that was broken.

        before, after: APPROACH_PROGRESS. state: APPROACH_STATE with the numbers of the limits; None: they are unknown.
        """
        if before["go"] and not after["go"]:
            since_s = float(after["ready_since_s"])
            self._decide(t_s, bool(after["docking_go"]), since_s, bool(before["aborted"]), state)
        moved = before["phase"] != after["phase"]
        if moved and not (after["phase"] == self._brake and after["aborted"]):  # logged with the abort, a cycle earlier
            self._log_phase(t_s, int(after["phase"]), int(after["reaction"]))
        if before["reaction"] != after["reaction"] and not after["aborted"]:
            self._log_reaction(t_s, int(after["reaction"]), int(after["cause"]), state)
        aborted = before["aborted"] != after["aborted"]
        if aborted:
            self._log_abort(t_s, supervision, state)
        if after["ready"] != (0 if moved or aborted else before["ready"]):
            held = f"ready: within Table III for {self._dwell_s:g} s on the estimate"
            self._log(t_s, "supervision", held if after["ready"] else f"no longer ready{go_limit_text(state)}")

    def finish(self, t_s: float, state: np.record, supervision: np.record) -> None:
        """Log the docking decision at the end of a run unless one was logged before. state: APPROACH_STATE."""
        if not self._has_decision:
            progress, since_s = state["progress"], float(supervision["ready_since_s"])
            self._decide(t_s, bool(progress["ready"]), since_s, bool(progress["aborted"]), state)

    def _decide(self, t_s: float, go: bool, ready_since_s: float, aborted: bool, state: np.record | None) -> None:
        self._has_decision = True
        if go:
            text = f"{DOCKING_GO}, ready since {ready_since_s:.2f} s"
        elif aborted:
            text = "docking: no-go, the approach was aborted"
        else:
            text = f"docking: no-go, the ready state does not hold{go_limit_text(state)}"
        self._log(t_s, "supervision", text)

    def _log_abort(self, t_s: float, supervision: np.record, state: np.record | None) -> None:
        self._log(
            t_s,
            "supervision",
            f"abort: {ABORT_CAUSES[supervision.aborted]} (corridor margin {supervision.corridor_margin_m:.3f} m, "
            f"closing margin {supervision.closing_margin_mps:.4f} m/s){limit_text(supervision.aborted, state)}",
        )
        self._log_phase(t_s, self._brake, ABORT)

    def _log_reaction(self, t_s: float, reaction: int, cause: int, state: np.record | None) -> None:
        why = f": {ABORT_CAUSES[cause]}{limit_text(cause, state)}" if reaction else ""
        self._log(t_s, "supervision", f"reaction {REACTION_NAMES[reaction]}{why}")

    def _log_phase(self, t_s: float, phase: int, reaction: int) -> None:
        beyond = phase - self._brake
        name = self._phases[phase] if beyond < 0 else f"{REACTION_NAMES[reaction]}: {_ESCAPE[beyond]}"
        self._log(t_s, "guidance", f"phase {name} begins")

    def _log(self, t_s: float, source: str, text: str) -> None:
        self.events.append(Event(t_s, source, text))
