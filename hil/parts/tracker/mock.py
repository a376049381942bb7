"""Mock of a tracker: frames in memory of a bench in simulated time."""

from __future__ import annotations

import math
from collections import deque

from hil.core.messages import Array
from hil.maths import quat
from hil.parts.tracker.encoder_poses import difference
from hil.parts.tracker.frames import TrackedFrame
from hil.parts.tracker.measured import MeasuredBodies, TruePose
from hil.parts.tracker.table import Tracker


class MockTracker:
    """Tracker in memory, with the interface of ``TrackerSource``; between two calls the bench moves uniformly."""

    failure = ""

    def __init__(self, table: Tracker, seed: int, true_pose: TruePose) -> None:
        self._table, self._true_pose = table, true_pose
        self._bodies = MeasuredBodies(table, seed)
        self.run_zero_s = 0.0
        """Bench time of the run's time zero, by which faults act."""
        self._before: tuple[float, Array, Array] | None = None
        self._next = 0
        self._in_transit: deque[TrackedFrame] = deque()

    def poll(self, now_s: float) -> list[TrackedFrame]:
        """Measure up to ``now_s``, and return the frames that have arrived by then."""
        before, now = self._before, (now_s, *self._true_pose(now_s))
        self._before = now
        if before is None:
            self._next = math.ceil(now_s * self._table.rate_hz)
        else:
            self._measure(before, now)
        arrived = []
        while self._in_transit and self._in_transit[0].received_s <= now_s:
            arrived.append(self._in_transit.popleft())
        return arrived

    def close(self) -> None:
        """Release nothing."""

    def _measure(self, before: tuple[float, Array, Array], now: tuple[float, Array, Array]) -> None:
        change = difference(now[1], now[2], before[1], before[2])
        while (t_s := self._next / self._table.rate_hz) <= now[0]:
            self._next += 1
            part = (t_s - before[0]) / (now[0] - before[0])
            r = before[1] + part * change[:3]
            q = quat.multiply(quat.from_rotation_vector(part * change[3:]), before[2])
            run_s = t_s - self.run_zero_s
            bodies, stamp_s = self._bodies.at(run_s, r, q), self._bodies.stamp_s(t_s, run_s)
            self._in_transit.append(TrackedFrame(stamp_s, t_s + self._table.latency_s, bodies))
