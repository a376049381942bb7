"""What the cycle asks of a GNC backend, built in or external: guidance, monitor, orders and event log are common."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.messages import Array, Event
from hil.core.observable import ObservableList
from hil.gnc import guidance, step
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc.step import APPROACH_PROGRESS
from hil.gnc_backends.approach_events import ApproachEventLog


class Poses(Protocol):
    """Poses of the present cycle: the first ``arrived`` of ``poses``, (MAX_POSES,) of POSE."""

    poses: np.ndarray
    arrived: int


class Records(Protocol):
    """Records of the present cycle that a GNC reads and writes; the truth is not for it."""

    record: np.record
    """All of them, CYCLE."""
    imu: np.record
    samples: np.ndarray
    """Samples of the IMU since the last cycle, (n,) of IMU; ``imu`` is their mean."""
    navigation: np.record
    reference: np.record
    supervision: np.record
    command: np.record
    monitor_bound_m: np.ndarray
    monitor_bound_s: np.ndarray
    bench_off: np.ndarray
    bench_breach: np.ndarray


def _no_hold(_reason: str) -> None:
    """Ignore a request for a hold until the loop is assembled."""


class GncBackend:
    """GNC of a run: from the IMU's sample and the poses of a cycle to thrusters on or off.

    A session begins with ``open`` and ends with ``close``; in between the loop calls ``on_idle_cycle`` in each cycle
    in which it is open and ``step`` in each in which it is closed. All run in the loop's thread and do not block.
    The plan of the approach and its monitor are the same for all backends. params, state: APPROACH_PARAMS,
    APPROACH_STATE.
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
        """Called with a reason to have the bench held; set when the loop is assembled."""

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
        """Begin a session. Raises BadInput or BenchError."""

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Take note that the loop is open in this cycle: STANDBY, ARMED or HOLD. Raises BenchError."""

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Write NAVIGATION, REFERENCE, SUPERVISION and COMMAND of ``now`` for ``t_s`` of the run. Raises BenchError."""
        raise NotImplementedError

    def close(self) -> None:
        """End the session; may be called more than once."""

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
        """Report the bound on the position error by the docking monitor, 0 for none, before ``step``.

        An external GNC reports its own protection levels.
        """

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Take what further sensors have measured, (n,) of SENSOR_ARRIVAL, before ``step``."""

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

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), nan if there is none; valid until the next call."""
        raise NotImplementedError
