"""What is known of the target without a whole pose: its position, or the line of sight alone."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.maths import quat

OK_POSITION: Final = "ok_position"
OK_SIGHT: Final = "ok_sight"

_LEAST_WEIGHT: Final = 0.04  # no candidate is more than five sigmas off
_LARGEST_SIGMA: Final = 0.05  # relative to the range
_LARGEST_SIGHT_RAD: Final = math.radians(1.0)


@dataclass(frozen=True, slots=True)
class PartialPose:
    """Part of a pose that several candidates agree on.

    sight: (3,), unit vector in v from the left camera to the origin of t. sight_sigma_rad: its standard deviation in
    the least certain direction. t_v: (3,), m, position of t, and covariance: (3, 3), m^2; None if the range is not
    known. q_vt: (4,), attitude of the likeliest candidate, a guess.
    """

    q_vt: Array
    sight: Array
    sight_sigma_rad: float
    t_v: Array | None
    covariance: Array | None

    @property
    def status(self) -> str:
        """Return the status of the solution."""
        return OK_SIGHT if self.t_v is None else OK_POSITION


def partial_pose(candidates: Sequence[np.void]) -> PartialPose | None:
    """Return what the poses (FIT), one of which is true, have in common; None if that is not even the line of sight.

    The position is their mean by their scores, its covariance that of the mixture, with a least weight for each.
    """
    score = np.array([float(fit["score"]) for fit in candidates])
    weight = np.maximum(np.exp(score - score.max()), _LEAST_WEIGHT)
    weight /= weight.sum()
    q_vt = quat.from_matrix(candidates[int(score.argmax())]["r"])
    places = np.array([fit["t"] for fit in candidates])
    mean = weight @ places
    off = places - mean
    covariance = np.einsum("k,kij->ij", weight, np.array([fit["covariance"][:3, :3] for fit in candidates]))
    covariance += (weight[:, None] * off).T @ off
    away = float(np.linalg.norm(mean))
    sight = mean / away
    across = np.eye(3) - np.outer(sight, sight)
    sight_sigma = math.sqrt(max(float(np.linalg.eigvalsh(across @ covariance @ across)[-1]), 0.0)) / away
    if not sight_sigma < _LARGEST_SIGHT_RAD:
        return None
    if math.sqrt(float(np.linalg.eigvalsh(covariance)[-1])) < _LARGEST_SIGMA * away:
        return PartialPose(q_vt, sight, sight_sigma, mean, covariance)
    return PartialPose(q_vt, sight, sight_sigma, None, None)
