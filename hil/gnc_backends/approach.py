"""Approach of any backend: guidance, approach monitor, the operator's orders and the event log."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.messages import Event
from hil.core.observable import ObservableList
from hil.gnc import guidance, step
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc.step import APPROACH_PROGRESS
from hil.gnc_backends.approach_events import ApproachEventLog


def _no_hold(_reason: str) -> None:
    """Ignore a request for a hold until the loop is assembled."""


class Approach:
    """Base class of the backends: the plan of the approach and its monitor are the same for all of them.

    params, state: APPROACH_PARAMS, APPROACH_STATE.
    """

    def __init__(self, params: np.record, state: np.record, event_log: ApproachEventLog) -> None:
        self._approach_params = params
        self.approach_state = state
        """APPROACH_STATE."""
        self._progress = np.asarray(state["progress"])
        self.event_log = event_log
        guidance.start(params.guidance, state.guidance)
        self.cycle = -1
        """Number of the last cycle, -1 before the first."""
        self.orders: ObservableList[tuple[int, str]] = ObservableList()
        """Each order of the operator with the number of the cycle from which on it acts."""
        self.request_hold: Callable[[str], None] = _no_hold

    filter_monitor: FilterMonitor | None = None
    """Monitor of the filters, if the GNC has such or reports their innovations."""

    @property
    def user_error(self) -> BaseException | None:
        """What a Python object of the user has raised."""
        return None

    @property
    def blocking_reason(self) -> str:
        """Reason why a run on hold cannot be resumed, "" if it can."""
        return ""

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists to which events are appended as they happen."""
        return (self.event_log.events,)

    def open(self, bench_s: float) -> None:
        """Begin a session."""

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Take note that the loop is open in this cycle."""

    def close(self) -> None:
        """End the session."""

    def order_go(self) -> None:
        """Order the approach to continue from its wait, from the next cycle on."""
        self._progress["go"] = 1
        self.orders.append((self.cycle + 1, "go"))

    def order_abort(self) -> None:
        """Order an abort, from the next cycle on."""
        self.approach_state["abort_ordered"] = 1
        self.orders.append((self.cycle + 1, "abort"))

    def set_monitor_disagrees(self, disagrees: bool) -> None:
        """Report whether the docking monitor measures another pose than the navigation's, before ``step``."""
        self.approach_state["monitor_disagrees"] = disagrees

    def set_bench_check(self, off: np.ndarray, breach: np.ndarray, disagrees: bool) -> None:
        """Report the mean (6,) of estimate minus encoders, nan if unknown, and whether they disagree.

        breach: (3,), the component that is nearest its limit: number, size, limit.
        """
        self.approach_state["bench_disagrees"] = disagrees
        self.approach_state["bench_breach"] = breach
        self.approach_state["go"]["known"] = off[0] == off[0]
        self.approach_state["go"]["off"] = off

    def set_monitor_bound(self, bound_m: float, measured_s: float) -> None:
        """Take note of a bound on the position error; an external GNC reports its own protection levels."""

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Take the samples of further sensors of the next cycle, (n,) of SENSOR_ARRIVAL."""

    def watch_approach(self, t_s: float, estimate: np.record, reference: np.record, supervision: np.record) -> None:
        """Check corridor, closing rate and ready state; start an abort if one is due. Writes SUPERVISION."""
        self._watch_approach(t_s, estimate, reference, supervision, False)

    def _watch_approach(
        self,
        t_s: float,
        estimate: np.record,
        reference: np.record,
        supervision: np.record,
        abort_without_estimate: bool,
    ) -> None:
        before = self._progress.tobytes()
        step.watch_approach(
            self._approach_params, self.approach_state, t_s, estimate, reference, supervision, abort_without_estimate
        )
        self.log_progress(t_s, before, supervision)

    def log_progress(self, t_s: float, before: bytes, supervision: np.record, after: np.record | None = None) -> None:
        """Log the differences to the progress ``before`` (bytes of APPROACH_PROGRESS); most cycles have none.

        after: APPROACH_PROGRESS; None: the present one.
        """
        now: Any = self._progress if after is None else np.asarray(after)
        if now.tobytes() != before:
            was = np.frombuffer(before, APPROACH_PROGRESS)[0]
            self.event_log.update(t_s, was, now[()], supervision, self.approach_state)

    def events(self) -> list[Event]:
        """Return all events so far in the order of time."""
        return sorted((event for log in self.event_logs for event in log), key=lambda event: event.t_s)

    def finish(self, t_s: float, supervision: np.record) -> None:
        """Log the docking decision at the end of the run unless one was logged before."""
        self.event_log.finish(t_s, self.approach_state, supervision)
