"""Track of the target: propagates the pose between images at constant rates, with growing covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hil.core.messages import Array
from hil.maths import quat
from hil.maths.kalman import propagate_covariance
from hil.vmu.kernels.hypotheses import difference
from hil.vmu.kernels.refine import rotate
from hil.vmu.pose import Prediction, TargetMotion

_STRANGE = 33.0  # chi-square of six components above which a pose does not continue the track


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """Motion model of the target, and lifetime of a track without measurements.

    acceleration_mps2, acceleration_radps2: standard deviation of the accelerations. first_speed_mps,
    first_rate_radps: of the rates after a single image. longest_s: longest prediction after the last pose.
    most_failures: number of consecutive images without a measured pose after which the track is dropped. recheck:
    number of poses after which the whole images are searched, to detect a wrong identification. mature: number of poses
    after which one that does not continue the track is not accepted until ``jumps`` of them in a row continue each
    other.
    """

    acceleration_mps2: float = 0.5
    acceleration_radps2: float = 0.5
    first_speed_mps: float = 4.0
    first_rate_radps: float = 0.5
    longest_s: float = 1.0
    most_failures: int = 3
    recheck: int = 25
    mature: int = 8
    jumps: int = 3


class Track:
    """Pose and rates as a Kalman filter: twelve states, white acceleration (in v, small rotations about v's axes)."""

    def __init__(self, settings: TrackSettings) -> None:
        self.settings = settings
        self.poses = 0
        self.failures = 0
        self._t_s = 0.0
        self._r, self._t, self._rates = np.eye(3), np.zeros(3), np.zeros(6)
        self._p = np.zeros((12, 12))

    @property
    def is_mature(self) -> bool:
        """Return whether a single pose that does not continue the track is not accepted."""
        return self.poses >= self.settings.mature

    def drop(self) -> None:
        """Drop the track."""
        self.poses = self.failures = 0

    def predict(self, t_s: float) -> Prediction | None:
        """Return the predicted pose at ``t_s``; None without a track, or too long after the last pose."""
        if not self.poses or not 0.0 <= t_s - self._t_s <= self.settings.longest_s:
            return None
        r, t, p = self._carried(t_s - self._t_s)
        return Prediction(t, _quaternion(r), p[:6, :6].copy())

    def motion(self, t_s: float) -> TargetMotion | None:
        """Return position and rates at ``t_s``; None without a track of at least two poses."""
        if self.poses < 2 or not 0.0 <= t_s - self._t_s <= self.settings.longest_s:
            return None
        _, t, p = self._carried(t_s - self._t_s)
        return TargetMotion(t, self._rates.copy(), p[6:, 6:].copy())

    def fail(self) -> None:
        """Count an image in which the target was expected and not measured."""
        self.failures += 1
        if self.failures >= self.settings.most_failures:
            self.drop()

    def update(self, t_s: float, fit: np.void) -> None:
        """Update by a measured pose (FIT); one that does not continue the track starts a new one."""
        self.failures = 0
        if not self.poses or not 0.0 < t_s - self._t_s <= self.settings.longest_s:
            self._begin(t_s, fit)
            return
        r, t, p = self._carried(t_s - self._t_s)
        error = np.empty(6)
        difference(fit["r"], fit["t"], r, t, error)
        innovation = p[:6, :6] + fit["covariance"]
        if error @ np.linalg.solve(innovation, error) > _STRANGE:
            self._begin(t_s, fit)
            return
        gain = np.linalg.solve(innovation, p[:6]).T
        step = gain @ error
        self._t = t + step[:3]
        self._r = np.empty((3, 3))
        rotate(r, step[3:6], self._r)
        self._rates = self._rates + step[6:]
        keep = np.eye(12)
        keep[:, :6] -= gain
        self._p = keep @ p @ keep.T + gain @ fit["covariance"] @ gain.T
        self._t_s = t_s
        self.poses += 1

    def _begin(self, t_s: float, fit: np.void) -> None:
        chosen = self.settings
        self._t_s, self.poses = t_s, 1
        self._r, self._t, self._rates = fit["r"].copy(), fit["t"].copy(), np.zeros(6)
        self._p = np.zeros((12, 12))
        self._p[:6, :6] = fit["covariance"]
        sigmas = np.repeat([chosen.first_speed_mps, chosen.first_rate_radps], 3)
        self._p[6:, 6:] = np.diag(sigmas**2)

    def _carried(self, dt: float) -> tuple[Array, Array, Array]:
        """Return attitude, position and covariance of all states after ``dt`` seconds at constant rates."""
        r, p = np.empty((3, 3)), self._p.copy()
        rotate(self._r, self._rates[3:] * dt, r)
        phi = np.eye(12)
        phi[:6, 6:] = dt * np.eye(6)
        variance = np.repeat([self.settings.acceleration_mps2, self.settings.acceleration_radps2], 3) ** 2
        noise = np.zeros((12, 12))
        index = np.arange(6)
        noise[index, index] = 0.25 * dt**4 * variance
        noise[index, index + 6] = noise[index + 6, index] = 0.5 * dt**3 * variance
        noise[index + 6, index + 6] = dt**2 * variance
        propagate_covariance(p, phi, noise)
        return r, self._t + self._rates[:3] * dt, p


def prediction_at(t_v: Array, rotation_vector: Array, sigma_m: float, sigma_deg: float) -> Prediction:
    """Return a prediction from a pose ``p_v = exp([rotation_vector]x) p_t + t_v`` with the given sigma per axis."""
    sigmas = np.repeat([sigma_m, math.radians(sigma_deg)], 3)
    return Prediction(t_v, quat.from_rotation_vector(-rotation_vector), np.diag(sigmas**2))


def _quaternion(r: Array) -> Array:
    q: Array = quat.from_matrix(r)
    return q
