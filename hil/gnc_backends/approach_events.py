"""Event log of the approach: phases, abort, readiness and the docking decision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.config.scenario import REACTION_NAMES
from hil.core.messages import Event
from hil.core.observable import ObservableList
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
)
_ESCAPE = ("brake", "retreat", "hold")
DOCKING_GO = "docking: go"


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

    def update(self, t_s: float, before: np.void, after: np.void, supervision: np.record) -> None:
        """Log what has changed. before, after: APPROACH_PROGRESS."""
        if before["go"] and not after["go"]:
            self._decide(t_s, bool(after["docking_go"]), float(after["ready_since_s"]), bool(before["aborted"]))
        moved = before["phase"] != after["phase"]
        if moved and not (after["phase"] == self._brake and after["aborted"]):  # logged with the abort, a cycle earlier
            self._log_phase(t_s, int(after["phase"]), int(after["reaction"]))
        if before["reaction"] != after["reaction"] and not after["aborted"]:
            self._log_reaction(t_s, int(after["reaction"]), int(after["cause"]))
        aborted = before["aborted"] != after["aborted"]
        if aborted:
            self._log_abort(t_s, supervision)
        if after["ready"] != (0 if moved or aborted else before["ready"]):
            held = f"ready: within Table III for {self._dwell_s:g} s on the estimate"
            self._log(t_s, "supervision", held if after["ready"] else "no longer ready")

    def finish(self, t_s: float, progress: np.void, supervision: np.record) -> None:
        """Log the docking decision at the end of a run unless one was logged before."""
        if not self._has_decision:
            since_s = float(supervision["ready_since_s"])
            self._decide(t_s, bool(progress["ready"]), since_s, bool(progress["aborted"]))

    def _decide(self, t_s: float, go: bool, ready_since_s: float, aborted: bool) -> None:
        self._has_decision = True
        if go:
            text = f"{DOCKING_GO}, ready since {ready_since_s:.2f} s"
        elif aborted:
            text = "docking: no-go, the approach was aborted"
        else:
            text = "docking: no-go, the ready state does not hold"
        self._log(t_s, "supervision", text)

    def _log_abort(self, t_s: float, supervision: np.record) -> None:
        self._log(
            t_s,
            "supervision",
            f"abort: {ABORT_CAUSES[supervision.aborted]} (corridor margin {supervision.corridor_margin_m:.3f} m, "
            f"closing margin {supervision.closing_margin_mps:.4f} m/s)",
        )
        self._log_phase(t_s, self._brake, ABORT)

    def _log_reaction(self, t_s: float, reaction: int, cause: int) -> None:
        why = f": {ABORT_CAUSES[cause]}" if reaction else ""
        self._log(t_s, "supervision", f"reaction {REACTION_NAMES[reaction]}{why}")

    def _log_phase(self, t_s: float, phase: int, reaction: int) -> None:
        beyond = phase - self._brake
        name = self._phases[phase] if beyond < 0 else f"{REACTION_NAMES[reaction]}: {_ESCAPE[beyond]}"
        self._log(t_s, "guidance", f"phase {name} begins")

    def _log(self, t_s: float, source: str, text: str) -> None:
        self.events.append(Event(t_s, source, text))
