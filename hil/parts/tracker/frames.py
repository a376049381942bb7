"""Frames of a tracker: poses of bodies in the tracker's frame W at a time of its clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import numpy as np

from hil.core.messages import Array
from hil.maths import quat


class BodyPose(NamedTuple):
    """Pose of a tracked body b in W. position: of its origin, (3,), m. q: W to b, (4,); None: a point.

    error_m: what the tracker states about its fit of the markers, 0 if it states nothing.
    """

    position: Array
    q: Array | None
    error_m: float = 0.0


class TrackedFrame(NamedTuple):
    """What a tracker has measured at a moment. stamp_s: of its clock. received_s: bench time of the receipt.

    bodies: those that are tracked, by streaming ID or name. age_s: from the moment to the sending, by the tracker's
    own clock, 0 if it states none.
    """

    stamp_s: float
    received_s: float
    bodies: Mapping[int | str, BodyPose]
    age_s: float = 0.0


class TrackerSource(Protocol):
    """A tracker. failure: why its stream is gone, "" while it is there."""

    failure: str

    def poll(self, now_s: float) -> list[TrackedFrame]:
        """Return the frames received since the last call; never waits. now_s: bench time."""

    def close(self) -> None:
        """Release the stream; may be called more than once."""


class Mounting(NamedTuple):
    """Pose on a body b of the axes that it stands for. position: of their origin, (3,), m, in b. q: b to them, (4,)."""

    position: Array
    q: Array

    @classmethod
    def of(cls, position_m: tuple[float, ...], rotation_deg: tuple[float, ...]) -> Mounting:
        """Return the pose of a table of the rig file."""
        return cls(np.array(position_m), quat.from_rotation_vector(np.radians(rotation_deg)))

    def apply(self, position: Array, q_body: Array) -> tuple[Array, Array]:
        """Return position and attitude in W of the axes on a body at ``position`` (3,) with ``q_body``, W to b."""
        return position + quat.transform_back(q_body, self.position), quat.multiply(self.q, q_body)

    def invert(self, position: Array, q: Array) -> BodyPose:
        """Return the pose in W of the body whose axes have ``position`` (3,) and ``q``, W to them, (4,)."""
        q_body = quat.multiply(quat.conjugate(self.q), q)
        return BodyPose(position - quat.transform_back(q_body, self.position), q_body)
