"""Poses that a vision unit reports: content of its frames, and what is possible."""

from __future__ import annotations

import binascii
import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array, PoseFrame
from hil.maths import linear
from hil.maths.elementary import square

STATUS_GOOD: Final = 0
STATUS_NO_POSE: Final = 1

RANGE_MAX_M: Final = 100.0
"""A pose farther from the cameras is none."""
SIGMA_MAX: Final = (10.0, 10.0, 10.0, math.pi, math.pi, math.pi)
"""A pose with a larger standard deviation, m and rad, is none."""
_SIGMA_MIN: Final = 1e-9
_EIGENVALUE_TOLERANCE: Final = 1e-5  # tolerance of the correlations: the wire has float32


@dataclass(frozen=True, slots=True)
class Decoded:
    """An intact frame. t_s: exposure, s of bench time; ``pose`` is None unless status is good, or POSITION_ONLY.

    rate: of an IMU's frame with good status, (3,), rad/s.
    """

    counter: int
    t_s: float
    status: int
    pose: PoseFrame | None
    rate: Array | None = None


@dataclass(frozen=True, slots=True)
class ReportedIdentity:
    """Identity that a unit reports; vendor and serial number up to 16 ASCII characters."""

    vendor: str
    serial: str
    firmware: str
    """Major and minor number, ``1.4``."""


def crc16(data: bytes) -> int:
    """Return CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF, not reflected) of ``data``."""
    return binascii.crc_hqx(data, 0xFFFF)


def _is_covariance(covariance: Array) -> bool:
    """Return whether ``covariance`` (6, 6), finite and symmetric, is one, up to the wire's resolution."""
    variance = covariance.diagonal()
    if not all(square(_SIGMA_MIN) <= variance[i] <= square(SIGMA_MAX[i]) for i in range(6)):
        return False
    sigma = np.sqrt(variance)
    return linear.eigenvalues(covariance / np.outer(sigma, sigma))[0] > -_EIGENVALUE_TOLERANCE


def checked_pose(pose: PoseFrame, by_camera: bool = True) -> Decoded | None:
    """Return ``pose`` as the content of an intact frame, None for an impossible one; its quaternion is a unit one.

    by_camera: it is that of a target in front of a camera, rather than of a tracked body.
    """
    if not all(np.isfinite(part).all() for part in (pose.t_v, pose.q_vt, pose.covariance)):
        return None
    if (by_camera and not 0.0 < pose.t_v[2] <= RANGE_MAX_M) or linear.length(pose.t_v) > RANGE_MAX_M:
        return None  # behind the cameras or farther than any bench is long
    if not _is_covariance(pose.covariance):
        return None
    return Decoded(pose.counter, pose.t_s, pose.status, pose)
