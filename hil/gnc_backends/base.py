"""The GNC's seat in the cycle: what the bench asks of whoever flies it, built in or the user's own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from hil.core.gnc_records import GncMode
from hil.core.messages import Array, Event
from hil.core.observable import ObservableList


class Poses(Protocol):
    """What came in a cycle: the first ``arrived`` of ``poses``, (MAX_POSES,) of POSE."""

    poses: np.ndarray
    arrived: int


class Records(Protocol):
    """The records of the present cycle that a GNC reads and writes; the truth is for nobody in the seat to see."""

    imu: np.record
    navigation: np.record
    reference: np.record
    supervision: np.record
    command: np.record


class GncBackend(Protocol):
    """Who flies: from the IMU's sample and the poses of a cycle to thrusters on or off.

    ``open`` and ``close`` enclose a session; in between ``stand`` is called in each cycle in which the loop is
    open and ``act`` in each in which it is closed. All of them are called in the loop's thread and do not wait.
    """

    cycle: int
    """Number of the last cycle, -1 before the first."""
    orders: ObservableList[tuple[int, str]]
    """Each order with the number of the cycle from which on it acts."""
    request_hold: Callable[[str], None]
    """To be called with a reason where the bench is to be brought to a stand; set by whoever puts the loop together."""

    @property
    def not_ready(self) -> str:
        """Why a run that is held cannot go on yet, "" where it can."""

    @property
    def logs(self) -> Sequence[ObservableList[Event]]:
        """What happened, as it happens."""

    def open(self, bench_s: float) -> None:
        """Begin a session. Raises BadInput or BenchError."""

    def stand(self, mode: GncMode, bench_s: float) -> None:
        """Take note that the loop is open in this cycle: STANDBY, ARMED or HOLD. Raises BenchError."""

    def act(self, t_s: float, now: Records, vision: Poses) -> None:
        """Write NAVIGATION, REFERENCE, SUPERVISION and COMMAND of ``now`` for ``t_s`` of the run. Raises BenchError."""

    def close(self) -> None:
        """End the session; may be called more than once."""

    def order_go(self) -> None:
        """Order the approach to go on from its wait, from the next cycle on."""

    def order_abort(self) -> None:
        """Order an abort, from the next cycle on."""

    def events(self) -> list[Event]:
        """Return what happened so far in the order of time."""

    def finish(self, t_s: float, found: np.record) -> None:
        """Note the docking decision at the end of the run, where none was asked for before."""

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), nan where there is none; valid until the next call."""
