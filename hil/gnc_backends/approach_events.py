"""What the approach does, told as events: phases, abort, the docking decision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hil.core.messages import Event
from hil.core.observable import ObservableList
from hil.maths.limits import has_held

ABORT_CAUSES = ("", "the corridor was left", "the closing rate was too high", "ordered")
_AFTER_THE_LIST = ("abort: brake", "abort: retreat", "abort: hold")


class ApproachEventLog:
    """Names phases and writes events.

    names: phases in their order. dwell_s: for how long the ready state must have held, on the
    estimate, for docking to be a go.
    """

    def __init__(self, names: Sequence[str], dwell_s: float) -> None:
        self._names = [*names, *_AFTER_THE_LIST]
        self._dwell_s = dwell_s
        self._aborted = False
        self._was_ready = False
        self.decided = False
        self.events: ObservableList[Event] = ObservableList()
        self._add(0.0, "guidance", f"phase {self._names[0]} begins")

    def _add(self, t_s: float, source: str, text: str) -> None:
        self.events.append(Event(t_s, source, text))

    def docking_is_go(self, t_s: float, ready_since_s: float) -> bool:
        """Return whether the ready state has held for the dwell time up to ``t_s``; since nan: it does not hold."""
        return not self._aborted and bool(has_held(ready_since_s, t_s, self._dwell_s))

    def phase_began(self, t_s: float, phase: int) -> None:
        """Note the phase that now begins."""
        self._was_ready = False
        self._add(t_s, "guidance", f"phase {self._names[phase]} begins")

    def look(self, t_s: float, ready_since_s: float) -> None:
        """Note the moment at which the ready state has held for the dwell time, and that at which it is lost."""
        ready = self.docking_is_go(t_s, ready_since_s)
        if ready == self._was_ready:
            return
        self._was_ready = ready
        text = f"ready: within Table III for {self._dwell_s:g} s on the estimate" if ready else "no longer ready"
        self._add(t_s, "supervision", text)

    def abort_began(self, t_s: float, found: np.record) -> None:
        """Note the abort and what the margins were."""
        self._aborted = True
        self._was_ready = False
        self._add(
            t_s,
            "supervision",
            f"abort: {ABORT_CAUSES[found.aborted]} (corridor margin {found.corridor_margin_m:.3f} m, "
            f"closing margin {found.closing_margin_mps:.4f} m/s)",
        )
        self._add(t_s, "guidance", f"phase {_AFTER_THE_LIST[0]} begins")

    def decide(self, t_s: float, ready_since_s: float) -> None:
        """Note whether docking is a go at ``t_s``: at the order to go on, and at the end of a run without one."""
        self.decided = True
        if self.docking_is_go(t_s, ready_since_s):
            text = f"docking: go, ready since {ready_since_s:.2f} s"
        elif self._aborted:
            text = "docking: no-go, the approach was aborted"
        else:
            text = "docking: no-go, the ready state does not hold"
        self._add(t_s, "supervision", text)
