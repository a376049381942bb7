"""What a mock or an emulated tracker measures: poses of the bodies on a bench, with noise, by the faults that act."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.maths import linear, quat
from hil.maths.random_streams import stream
from hil.parts.tracker.frames import BodyPose, Mounting
from hil.parts.tracker.table import Tracker, TrackerFault

TruePose = Callable[[float], tuple[Array, Array]]
"""True pose of the chaser, r in H (3,), m, and H to c (4,), at a bench time, s."""
_FRAME: Final = (1.5, -2.0, 0.7), (20.0, -15.0, 60.0)  # target in W, m, and rotation vector from W to H, deg
_REFERENCE: Final = (0.4, -1.1, -0.6)  # of the body on the floor, in H, m
_ALONG: Final = {
    "chaser": ("rails", "bench", "tracker"),
    "target": ("target", "bench", "tracker"),
    "reference": ("tracker",),
}
"""Body -> what moves it."""


class MeasuredBodies:
    """Bodies of ``table`` as a tracker measures them. seed: of the noise. faults act by the time that is given."""

    def __init__(self, table: Tracker, seed: int) -> None:
        self._table = table
        frame = table.frame
        place = _FRAME if frame is None else (frame.position_m, frame.rotation_deg)
        self._frame = Mounting.of(*place)
        self._mountings = {role: Mounting.of(b.position_m, b.rotation_deg) for role, b in table.bodies.items()}
        self._noise = stream(seed, "wire", "tracker")
        self._last: dict[int | str, BodyPose] = {}

    def at(self, t_s: float, r: Array, q: Array) -> dict[int | str, BodyPose]:
        """Return the tracked bodies by ID or name, for the true pose of the chaser. t_s: time of the faults."""
        faults = [fault for fault in self._table.faults if fault.at_s <= t_s < fault.end_s]
        kinds = {fault.kind for fault in faults}
        if "no_pose" in kinds:
            return {}
        if "frozen" not in kinds or not self._last:
            self._last = dict(self._bodies(faults, r, q))
        return self._last

    def _bodies(self, faults: Sequence[TrackerFault], r: Array, q: Array) -> Iterator[tuple[int | str, BodyPose]]:
        bodies = self._table.bodies
        names = {role: body.body for role, body in bodies.items()}
        if any(fault.kind == "swapped" for fault in faults) and "target" in names:
            names["chaser"], names["target"] = names["target"], names["chaser"]
        scale = math.prod(fault.values[0] for fault in faults if fault.kind == "noise_scale")
        lost = {fault.of or "chaser" for fault in faults if fault.kind == "lost"}
        for role, mounting in self._mountings.items():
            noise = scale * self._noise.standard_normal(6)
            if role in lost:
                continue
            position, attitude = self._true(role, faults, r, q)
            pose = mounting.invert(*self._in_tracker(position, attitude))
            assert pose.q is not None
            turned = quat.from_rotation_vector(math.radians(self._table.sigma_deg) * noise[3:])
            yield (
                names[role],
                BodyPose(
                    pose.position + self._table.sigma_m * noise[:3], quat.multiply(turned, pose.q), self._table.sigma_m
                ),
            )

    def _true(self, role: str, faults: Sequence[TrackerFault], r: Array, q: Array) -> tuple[Array, Array]:
        """Return the true position of a body in H, (3,), m, and its attitude, H to its axes, (4,)."""
        unrotated = np.array([0.0, 0.0, 0.0, 1.0])
        position, attitude = {"chaser": (r, q), "target": (np.zeros(3), unrotated)}.get(
            role, (np.array(_REFERENCE), unrotated)
        )
        for fault in faults:
            if fault.kind == "moved" and (fault.of or "rails") in _ALONG[role]:
                position = position + fault.values
            if fault.kind == "rotated" and role == "chaser":
                attitude = quat.multiply(quat.from_rotation_vector(np.radians(fault.values)), attitude)
        return position, attitude

    def _in_tracker(self, position: Array, attitude: Array) -> tuple[Array, Array]:
        """Return position and attitude of a body in W for those in H."""
        origin, q_HW = self._frame
        return origin + quat.transform_back(q_HW, position), quat.multiply(attitude, q_HW)

    def stamp_s(self, bench_s: float, t_s: float) -> float:
        """Return the time of the tracker's clock at bench time ``bench_s``, s. t_s: that of the faults."""
        jumps = [f.values[0] for f in self._table.faults if f.kind == "clock_jump" and f.at_s <= t_s < f.end_s]
        return bench_s * self._table.clock_scale + self._table.clock_offset_s + linear.total(jumps)
