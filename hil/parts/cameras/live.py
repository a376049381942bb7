"""Vision unit on live cameras: pairs of frames to poses, with counts and latencies."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from hil.config.rig import Vmu
from hil.config.vmu_geometry import VmuGeometry
from hil.core.clock import Clock, WallClock
from hil.core.messages import PoseFrame
from hil.drivers.cameras.base import SHUTTER
from hil.drivers.cameras.pairing import FramePair, TimedFrame
from hil.drivers.cameras.processes import CameraProcesses, vision_cameras, vision_pairing
from hil.errors import DeviceError
from hil.vmu.estimators import PoseEstimator, solve_pair
from hil.vmu.sources import Pair

_LATENCIES: Final = 2048  # frames; 5 min at 6.25 Hz
_STAGES: Final = ("exposure_to_image", "image_to_solver", "solver", "exposure_to_pose")
_WAIT_WALL_S: Final = 0.02
_FUTURE_S: Final = 1e-3
_OLDEST_S: Final = 2.0  # no image takes longer from exposure to arrival


class LiveVision:
    """Solves the frames of two cameras; times are bench time.

    A pair of which one image is missing or incomplete is solved from the other one. middle_row_s: from the exposure of
    the first row, which the cameras stamp, to that of the middle row, for which the pose holds. ``counters`` are those
    of a run's ``vision`` (docs/reference/wire-formats.md).
    """

    def __init__(self, estimator: PoseEstimator, vmu: Vmu, middle_row_s: float = 0.0) -> None:
        self._estimator, self._middle_row_s = estimator, middle_row_s
        estimator.warm_up()
        self._rate_hz, self._only_noise = vmu.rate_hz, vmu.covariance == "noise"
        self._pairing = vision_pairing(vmu)
        self._last: FramePair | None = None
        self._solved = self._counter = 0
        self._counts = dict.fromkeys(("no_pose", "incomplete", "lost", "clock_jumps"), 0)
        self._skew_max_s = 0.0
        self._started_s = math.nan  # solving of the newest pair
        self._latencies_s: deque[tuple[float, ...]] = deque(maxlen=_LATENCIES)  # by stage

    def put(self, side: int, frame: TimedFrame) -> None:
        """Add a frame of the left (0) or right (1) camera."""
        if frame.image is None:
            self._counts["incomplete"] += 1
        age_s = frame.arrived_s - frame.exposed_s
        if math.isnan(age_s):
            return
        if not -_FUTURE_S <= age_s <= _OLDEST_S:
            self._counts["clock_jumps"] += 1
            return
        self._pairing.put(side, frame)

    def poses(self, clock: Clock) -> Iterator[PoseFrame]:
        """Yield the poses of the pairs that are complete; their time of reception is left to the caller.

        The caller calls ``sent`` after each, with the time then.
        """
        for pair in self._pairing.pairs(clock.now_s()):
            self._started_s = clock.now_s()
            images = [None if frame is None else frame.image for frame in (pair.left, pair.right)]
            t_s = pair.exposed_s
            if self._last is not None:
                self._counts["lost"] += max(0, round((t_s - self._last.exposed_s) * self._rate_hz) - 1)
                self._counter += max(1, round((t_s - self._last.exposed_s) * self._rate_hz))
            self._last = pair
            if pair.left is not None and pair.right is not None:
                self._skew_max_s = max(self._skew_max_s, abs(pair.left.exposed_s - pair.right.exposed_s))
            if images[0] is None and images[1] is None:
                self._counts["lost"] += 1
                continue
            solution = solve_pair(self._estimator, images[0], images[1], t_s + self._middle_row_s)
            frame = solution.frame(self._counter & 0xFFFF_FFFF, math.nan, self._only_noise)
            if frame is None:
                self._counts["no_pose"] += 1
                continue
            self._solved += 1
            yield frame

    def sent(self, now_s: float) -> None:
        """Note that the pose of the newest pair was sent at ``now_s``."""
        pair = self._last
        assert pair is not None
        stages = (pair.exposed_s, pair.arrived_s), (pair.arrived_s, self._started_s), (self._started_s, now_s)
        self._latencies_s.append((*(after - before for before, after in stages), now_s - pair.exposed_s))

    def counters(self) -> dict[str, int]:
        """Return the counters, times in microseconds."""
        counters = {"frames": self._solved, **self._counts, **self._pairing.counters}
        counters["pair_skew_max_us"] = round(1e6 * self._skew_max_s)
        if self._latencies_s:
            percentiles = np.percentile(self._latencies_s, [50, 99], axis=0)
            for name, (p50, p99) in zip(_STAGES, percentiles.T, strict=True):
                counters |= {f"{name}_p50_us": round(1e6 * p50), f"{name}_p99_us": round(1e6 * p99)}
        return counters


def middle_row_s(geometry: VmuGeometry) -> float:
    """Return the time from the exposure of a rolling shutter's first row to that of its middle row."""
    cameras = (geometry.left, geometry.right)
    return sum(0.25 * abs(camera.row_time_s or 0.0) * (camera.height - 1) for camera in cameras)


def sized_cameras(vmu: Vmu, geometry: VmuGeometry, clock: WallClock) -> tuple[CameraProcesses, str]:
    """Return the cameras of ``[vmu.cameras]`` for images as in ``geometry``, and a doubt about their identity, or "".

    Raises DeviceError that names a camera.
    """
    sizes = [(camera.width, camera.height) for camera in (geometry.left, geometry.right)]
    cameras = vision_cameras(vmu, sizes, clock)
    try:
        check_shutters(cameras.shutters, geometry)
        doubt = cameras.check_identities({f"vmu.{side}": each for side, each in geometry.identities.items()})
    except DeviceError:
        cameras.close()
        raise
    return cameras, doubt


def check_shutters(shutters: Mapping[str, str], geometry: VmuGeometry) -> None:
    """Raise DeviceError for a camera with a rolling shutter whose row time the geometry file does not state.

    shutters: of ``vmu.left`` and ``vmu.right``, as the cameras report them.
    """
    for name, shutter in shutters.items():
        side = name.rpartition(".")[2]
        if shutter.startswith("Rolling") and getattr(geometry, side).row_time_s is None:
            raise DeviceError(
                name,
                f"has a rolling shutter ({SHUTTER} = {shutter}), and the geometry file no row time: state "
                f'{side}.row_time_s, s, from one row to the next, or set features.{SHUTTER} = "Global"',
            )


class CameraPairs:
    """Pairs of two cameras with software triggers, numbered by their triggers from the first one on, until ``close``.

    vmu: with the cameras; geometry: theirs. The first pairs are missing: cameras need some
    exposures until their clocks are known. Raises DeviceError that names the camera.
    """

    def __init__(self, vmu: Vmu, geometry: VmuGeometry) -> None:
        self._clock = WallClock(time.monotonic_ns())
        self._pairing = vision_pairing(vmu)
        self._rate_hz = vmu.rate_hz
        self._cameras, self.identity_doubt = sized_cameras(vmu, geometry, self._clock)

    def __iter__(self) -> Iterator[Pair]:
        first: int | None = None
        while True:
            for side, frame in self._cameras.frames(_WAIT_WALL_S):
                if first is None:
                    first = math.floor(frame.arrived_s * self._rate_hz)
                if math.isfinite(frame.exposed_s):
                    self._pairing.put(side, frame)
            for pair in self._pairing.pairs(self._clock.now_s()):
                assert first is not None
                images = [None if frame is None else frame.image for frame in (pair.left, pair.right)]
                yield Pair(round(pair.exposed_s * self._rate_hz) - first, images[0], images[1])
            self._cameras.check(self._clock.now_s())

    def close(self) -> None:
        """End the camera processes. Idempotent."""
        self._cameras.close()
