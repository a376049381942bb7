"""Interface between the cycle and a GNC backend, built in or external."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.messages import Array, Event
from hil.core.observable import ObservableList
from hil.gnc.estimation.filter_monitor import FilterMonitor


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


class GncBackend(Protocol):
    """GNC of a run: from the IMU's sample and the poses of a cycle to thrusters on or off.

    A session begins with ``open`` and ends with ``close``; in between the loop calls ``on_idle_cycle`` in each cycle
    in which it is open and ``step`` in each in which it is closed. All run in the loop's thread and do not block.
    """

    cycle: int
    """Number of the last cycle, -1 before the first."""
    orders: ObservableList[tuple[int, str]]
    """Each order of the operator with the number of the cycle from which on it acts."""
    request_hold: Callable[[str], None]
    """Called with a reason to have the bench held; set when the loop is assembled."""

    @property
    def user_error(self) -> BaseException | None:
        """What a Python object of the user has raised."""

    @property
    def blocking_reason(self) -> str:
        """Reason why a run on hold cannot be resumed, "" if it can."""

    @property
    def filter_monitor(self) -> FilterMonitor | None:
        """Monitor of the filters, if the GNC has such or reports their innovations."""

    @property
    def event_logs(self) -> Sequence[ObservableList[Event]]:
        """Lists to which events are appended as they happen."""

    def open(self, bench_s: float) -> None:
        """Begin a session. Raises BadInput or BenchError."""

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Take note that the loop is open in this cycle: STANDBY, ARMED or HOLD. Raises BenchError."""

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Write NAVIGATION, REFERENCE, SUPERVISION and COMMAND of ``now`` for ``t_s`` of the run. Raises BenchError."""

    def close(self) -> None:
        """End the session; may be called more than once."""

    def order_go(self) -> None:
        """Order the approach to continue from its wait, from the next cycle on."""

    def order_abort(self) -> None:
        """Order an abort, from the next cycle on."""

    def set_monitor_disagrees(self, disagrees: bool) -> None:
        """Report whether the docking monitor measures another pose than the navigation's, before ``step``."""

    def set_bench_check(self, off: np.ndarray, breach: np.ndarray, disagrees: bool) -> None:
        """Report the mean (6,) of estimate minus encoders, nan if unknown, and whether they disagree.

        breach: (3,), the component that is nearest its limit: number, size, limit.
        """

    def set_monitor_bound(self, bound_m: float, measured_s: float) -> None:
        """Report the bound on the position error by the docking monitor, 0 for none, before ``step``."""

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Pass on what further sensors have measured, (n,) of SENSOR_ARRIVAL, before ``step``."""

    def events(self) -> list[Event]:
        """Return all events so far in the order of time."""

    def finish(self, t_s: float, supervision: np.record) -> None:
        """Log the docking decision at the end of the run unless one was logged before."""

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), nan if there is none; valid until the next call."""
