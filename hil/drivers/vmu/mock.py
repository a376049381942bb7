"""Mock of the vision unit, in simulated time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.config.rig import Vmu
from hil.core.kernel_record import kernel_record
from hil.core.messages import VMU_FRAME, PoseFrame, new
from hil.drivers.latest import Latest
from hil.drivers.vmu import COUNTERS, NAME
from hil.drivers.vmu.transport import Transport
from hil.errors import DeviceError, LinkLost
from hil.models.camera_timing import TIME_SLACK_S, exposure_time, first_exposure
from hil.sensors.vision_unit.transit import FRAME_TRANSIT, SPARE_FRAMES, forget_frames, put_exposure, receive_frames

_NO_POSE = PoseFrame(0, 0.0, 0.0, np.full(3, np.nan), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros((6, 6)))


class MockVmu:
    """Exposes at multiples k/rate_hz of bench time, the first at or after ``open``; no drift, no noise of its own.

    ``pose_at(t_s)`` is called in the first ``poll`` at or after each exposure and returns the measured
    pose (its counter and times are overwritten here), or None when the ring is not seen. The frame is
    returned after the delay, or the two, that ``transport`` draws for it. transit, frames: FRAME_TRANSIT, and (n,) of
    VMU_FRAME, which a compiled loop continues instead of ``poll``; None: of its own.
    """

    def __init__(
        self,
        config: Vmu,
        pose_at: Callable[[float], PoseFrame | None],
        transport: Transport | None = None,
        transit: np.record | None = None,
        frames: np.ndarray | None = None,
    ) -> None:
        self.name = NAME
        self._rate_hz = config.rate_hz
        self._timeout_s = config.timeout_s
        self._pose_at = pose_at
        self._transport = transport
        self._transit = kernel_record(new(FRAME_TRANSIT) if transit is None else transit)
        self._frames = np.zeros(16, VMU_FRAME).view(np.recarray) if frames is None else frames
        self._late = np.zeros(2)
        self._reset(0.0)

    def _reset(self, now_s: float) -> None:
        self._received: Latest[bool] = Latest(self.name)
        self._arrived: list[PoseFrame] = []
        transit = self._transit
        transit.next_exposure = transit.first_exposure = first_exposure(now_s, self._rate_hz)
        transit.in_transit = transit.received = transit.without_pose = 0

    def open(self, now_s: float) -> None:
        """Start at bench time ``now_s``."""
        self._reset(now_s)
        self._transit.last_rx_s = now_s + (self._transport.longest_s if self._transport else 0.0)

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames received since the last call, oldest first.

        Raises LinkTimeout after more than ``timeout_s`` without a frame, or the error given to ``fail``.
        """
        self._received.check()
        self._expose_until(now_s + TIME_SLACK_S)
        self._receive(now_s)
        self._received.put(True, float(self._transit["last_rx_s"]))
        self._received.get(now_s, self._timeout_s)
        frames, self._arrived = self._arrived, []
        return frames

    def _receive(self, now_s: float) -> None:
        n = receive_frames(self._transit, now_s, self._frames)
        self._arrived += [PoseFrame.from_record(self._frames[i]) for i in range(n)]
        forget_frames(self._transit, n, self._frames)

    def expose(self, now_s: float) -> None:
        """Expose up to bench time ``now_s``, while the axes are where they are then."""
        self._expose_until(now_s + TIME_SLACK_S)

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``, named as in ``hil.drivers.vmu.COUNTERS``."""
        counts = dict.fromkeys(COUNTERS, 0)
        counts["frames"], counts["no_pose"] = int(self._transit.received), int(self._transit.without_pose)
        return counts

    def fail(self, error: DeviceError) -> None:
        """Make later ``poll`` raise ``error``."""
        self._received.fail(error)

    def close(self) -> None:
        """End; ``poll`` raises LinkLost until the next ``open``."""
        self._received.fail(LinkLost(self.name, "is closed"))

    def _expose_until(self, now_s: float) -> None:
        transit = self._transit
        while (t_s := exposure_time(transit["next_exposure"], self._rate_hz)) <= now_s:
            if transit["in_transit"] + SPARE_FRAMES > len(self._frames):  # as after a pause
                self._receive(t_s)
            i = int(transit["in_transit"])
            if i + SPARE_FRAMES > len(self._frames):
                self._frames = np.resize(self._frames, 2 * len(self._frames)).view(np.recarray)
            (self._pose_at(t_s) or _NO_POSE).write_to(self._frames[i : i + 1])
            delays = self._transport.delays() if self._transport else (0.0,)
            self._late[: len(delays)] = delays
            put_exposure(transit, self._frames, t_s, self._late, len(delays))
