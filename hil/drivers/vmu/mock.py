"""Mock of the vision unit, in simulated time."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hil.config.rig import Vmu
from hil.core.messages import PoseFrame
from hil.drivers.latest import Latest
from hil.drivers.vmu import COUNTERS, NAME
from hil.drivers.vmu.transport import Transport
from hil.errors import DeviceError, LinkLost
from hil.models.camera_timing import TIME_SLACK_S, exposure_time, first_exposure

_NO_POSE = PoseFrame(0, 0.0, 0.0, np.full(3, np.nan), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros((6, 6)))


@dataclass(slots=True)
class MockVmuState:
    """State of a mock that exposes. next_exposure, first_exposure: numbers of exposures.

    received, without_pose: frames so far, with a pose and without. in_transit: ``t_v`` is nan without a pose.
    """

    next_exposure: int
    first_exposure: int
    received: int
    without_pose: int
    last_rx_s: float
    in_transit: list[PoseFrame]


class MockVmu:
    """Exposes at multiples k/rate_hz of bench time, the first at or after ``open``; no drift, no noise of its own.

    ``pose_at(t_s)`` is called in the first ``poll`` at or after each exposure and returns the measured
    pose (its counter and times are overwritten here), or None when the ring is not seen. The frame is
    returned after the delay, or the two, that ``transport`` draws for it.
    """

    def __init__(
        self, config: Vmu, pose_at: Callable[[float], PoseFrame | None], transport: Transport | None = None
    ) -> None:
        self.name = NAME
        self._rate_hz = config.rate_hz
        self._timeout_s = config.timeout_s
        self._pose_at = pose_at
        self._transport = transport
        self._reset(0.0)

    def _reset(self, now_s: float) -> None:
        self._received: Latest[bool] = Latest(self.name)
        self._in_transit: list[tuple[float, int, PoseFrame]] = []  # a heap by time of arrival
        self._sent = 0
        self._first = self._next = int(first_exposure(now_s, self._rate_hz))  # numbers of exposures
        self._counts = dict.fromkeys(COUNTERS, 0)

    def open(self, now_s: float) -> None:
        """Start at bench time ``now_s``."""
        self._reset(now_s)
        self._received.put(True, now_s + (self._transport.longest_s if self._transport else 0.0))

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames received since the last call, oldest first.

        Raises LinkTimeout after more than ``timeout_s`` without a frame, or the error given to ``fail``.
        """
        self._received.check()
        self._expose_until(now_s + TIME_SLACK_S)
        frames = []
        while self._in_transit and self._in_transit[0][0] <= now_s + TIME_SLACK_S:
            received_s, _, frame = heapq.heappop(self._in_transit)
            self._received.put(True, received_s)
            has_pose = not math.isnan(frame.t_v[0])
            self._counts["frames" if has_pose else "no_pose"] += 1
            if has_pose:
                frames.append(frame)
        self._received.get(now_s, self._timeout_s)
        return frames

    def expose(self, now_s: float) -> None:
        """Expose up to bench time ``now_s``, while the axes are where they are then."""
        self._expose_until(now_s + TIME_SLACK_S)

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``, named as in ``hil.drivers.vmu.COUNTERS``."""
        return dict(self._counts)

    def state(self) -> MockVmuState:
        """Return the state, with which a compiled loop continues instead of ``poll``."""
        frames = [frame for _, _, frame in self._in_transit]
        counts = self._counts
        return MockVmuState(
            self._next, self._first, counts["frames"], counts["no_pose"], self._received.t_s, frames
        )  # fmt: skip

    def set_state(self, state: MockVmuState) -> None:
        """Take over the state of a compiled loop."""
        self._next = state.next_exposure
        self._counts["frames"], self._counts["no_pose"] = state.received, state.without_pose
        self._received.put(True, state.last_rx_s)
        order = sorted(state.in_transit, key=lambda frame: frame.counter)
        self._in_transit = [(frame.received_s, self._sent + i, frame) for i, frame in enumerate(order)]
        heapq.heapify(self._in_transit)
        self._sent += len(order)

    def fail(self, error: DeviceError) -> None:
        """Make later ``poll`` raise ``error``."""
        self._received.fail(error)

    def close(self) -> None:
        """End; ``poll`` raises LinkLost until the next ``open``."""
        self._received.fail(LinkLost(self.name, "is closed"))

    def _expose_until(self, now_s: float) -> None:
        while (t_s := exposure_time(self._next, self._rate_hz)) <= now_s:
            pose = self._pose_at(t_s) or _NO_POSE
            for delay_s in self._transport.delays() if self._transport else (0.0,):
                received_s = t_s + delay_s
                frame = replace(pose, counter=(self._next - self._first) & 0xFFFF_FFFF, t_s=t_s, received_s=received_s)
                heapq.heappush(self._in_transit, (received_s, self._sent, frame))
                self._sent += 1
            self._next += 1
