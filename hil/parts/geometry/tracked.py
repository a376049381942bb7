"""Poses of a bench by the tracker of its rig file, on its wire."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.errors import BadInput, DriveFault, LinkLost
from hil.maths import linear, quat
from hil.parts.tracker.encoder_poses import mean_pose
from hil.parts.tracker.frames import Mounting, TrackedFrame, TrackerSource
from hil.parts.tracker.link import NAME
from hil.parts.tracker.table import Tracker

_FIRST: Final = 100  # frames by which the target is measured
_MOVED_SIGMAS: Final = 20.0


class TrackedPoses:
    """Chaser's body relative to the target's as it stood at first, or to H where ``tracker.frame`` gives it.

    The target is measured once, by the mean of its first frames: the fit takes what is left of its error for the place
    of the target. sigma: (6,), m and rad, of a sample.
    """

    source = "tracker"

    def __init__(self, config: Tracker, link: TrackerSource) -> None:
        self.sigma = np.repeat((config.sigma_m, math.radians(config.sigma_deg)), 3)
        self._config = config
        self._mountings = {role: Mounting.of(b.position_m, b.rotation_deg) for role, b in config.bodies.items()}
        frame = config.frame
        self._frame = None if frame is None else Mounting.of(frame.position_m, frame.rotation_deg)
        self._first: list[tuple[Array, Array]] = []
        self._link = link

    def sample(self, now_s: float) -> Array | None:
        """Return the newest pose, (6,), m and rotation vector, rad; None without a new one.

        Raises LinkLost, DriveFault if the target has moved, BadInput for a tracker of points.
        """
        poses = [pose for frame in self._link.poll(now_s) if (pose := self.pose_of(frame)) is not None]
        if self._link.failure:
            raise LinkLost(NAME, self._link.failure)
        return poses[-1] if poses else None

    def pose_of(self, frame: TrackedFrame) -> Array | None:
        """Return the pose of ``frame``, as ``sample``; None without a tracked body, or a target that is measured."""
        chaser, target = self._placed(frame, "chaser"), self._placed(frame, "target")
        if self._config.frame is None and target is not None:
            self._measure(*target)
        if chaser is None or self._frame is None:
            return None
        r = quat.transform(self._frame.q, chaser[0] - self._frame.position)
        turned = quat.multiply(chaser[1], quat.conjugate(self._frame.q))
        return np.concatenate([r, quat.to_rotation_vector(turned)])

    def close(self) -> None:
        """Release the stream. Idempotent."""
        self._link.close()

    def _measure(self, position: Array, q: Array) -> None:
        """Add a frame of the target to its mean; compare it with that once it is complete."""
        if self._frame is not None:
            moved_m = linear.length(position - self._frame.position)
            if moved_m > _MOVED_SIGMAS * self._config.sigma_m:
                raise DriveFault(
                    NAME, f"the target has moved by {1e3 * moved_m:.1f} mm since the first pose: begin again"
                )
            return
        self._first.append((position, q))
        if len(self._first) == _FIRST:
            self._frame = Mounting(*mean_pose(self._first))

    def _placed(self, frame: TrackedFrame, role: str) -> tuple[Array, Array] | None:
        """Return position in W, (3,), m, and W to the axes, (4,), that the body ``role`` stands for."""
        body = frame.bodies.get(self._config.bodies[role].body) if role in self._mountings else None
        if body is None:
            return None
        if body.q is None:
            text = "the tracker streams a point: geometry needs poses"
            raise BadInput.single("rig", f"tracker.{role}", text)
        return self._mountings[role].apply(body.position, body.q)
