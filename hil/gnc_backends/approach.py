"""The plan of an approach and its supervision: what holds whoever flies it, our GNC or the user's own."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.messages import Event, new
from hil.core.observable import ObservableList
from hil.gnc import approach_monitor, guidance
from hil.gnc.guidance import GUIDANCE_STATE
from hil.gnc_backends.approach_events import ApproachEventLog


def _nobody(_reason: str) -> None:
    """Hear a request for a hold where nobody can grant it."""


class Approach:
    """Guidance, supervision, the operator's orders, and the diary of it all: the half of a seat that all share."""

    def __init__(self, guidance_params: np.record, supervision_params: np.record, diary: ApproachEventLog) -> None:
        self._guidance = guidance_params
        self._supervision = supervision_params
        self.diary = diary
        self._flown = new(GUIDANCE_STATE)
        guidance.start(guidance_params, self._flown)
        self._go = self._abort = 0
        self.cycle = -1
        """Number of the last cycle, -1 before the first."""
        self.orders: ObservableList[tuple[int, str]] = ObservableList()
        """Each order with the number of the cycle from which on it acts."""
        self.request_hold: Callable[[str], None] = _nobody

    @property
    def not_ready(self) -> str:
        """Why a run that is held cannot go on yet: nothing keeps it."""
        return ""

    @property
    def logs(self) -> tuple[ObservableList[Event], ...]:
        """What happened, as it happens."""
        return (self.diary.events,)

    def open(self, bench_s: float) -> None:
        """Begin a session."""

    def stand(self, mode: GncMode, bench_s: float) -> None:
        """Take note that the loop is open in this cycle."""

    def close(self) -> None:
        """End the session."""

    def order_go(self) -> None:
        """Order the approach to go on from its wait, from the next cycle on."""
        self._go = 1
        self.orders.append((self.cycle + 1, "go"))

    def order_abort(self) -> None:
        """Order an abort, from the next cycle on."""
        self._abort = 1
        self.orders.append((self.cycle + 1, "abort"))

    def guide(self, t_s: float, found: np.record, out: np.record) -> None:
        """Write REFERENCE for ``t_s`` of the run; moves on to the next phase when its time or its order has come."""
        held = 0 if self.diary.docking_is_go(t_s, found.ready_since_s) else 1
        did = guidance.advance(self._guidance, self._flown, t_s, self._go, held)
        if did != guidance.STAYED:
            if self._go:
                self.diary.decide(t_s, found.ready_since_s)
            if did == guidance.MOVED:
                self.diary.phase_began(t_s, self._flown.phase)
            self._go = 0
        guidance.reference(self._guidance, self._flown, t_s, out)

    def supervise(self, t_s: float, estimate: np.record, reference: np.record, out: np.record) -> None:
        """Judge corridor, closing rate and ready state; begin an abort where one is called for. Writes SUPERVISION."""
        if approach_monitor.supervise_and_act(
            self._supervision, self._guidance, self._flown, t_s, estimate, reference, self._abort, out
        ):
            self.diary.abort_began(t_s, out)
        self.diary.look(t_s, out.ready_since_s)

    def events(self) -> list[Event]:
        """Return what happened so far in the order of time."""
        return sorted((event for log in self.logs for event in log), key=lambda event: event.t_s)

    def finish(self, t_s: float, found: np.record) -> None:
        """Note the docking decision at the end of the run, where none was asked for before."""
        if not self.diary.decided:
            self.diary.decide(t_s, found.ready_since_s)
