"""Cramér-Rao bound of the navigation: the least standard deviations that any filter can have with a run's sensors.

A recursion of Riccati's equation (Tichavsky, Muravchik and Nehorai, IEEE Trans. Signal Processing 46 (1998)) over the
poses that arrived, with the covariances that the vision unit reported, and the true noise of the IMU. Each axis is
alone: position, velocity and accelerometer bias; rotation and gyro drift. What couples them only adds errors, as does
correlated noise. Bias, misalignment and scale of the vision unit, which poses cannot show, are added with the sizes of
the error budget. No parameter of a filter enters.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import VISION_ALONE, Scenario
from hil.core.messages import Array
from hil.gnc.allocation import AXES_OF_A_BODY, axes_in_plane
from hil.maths import linear
from hil.maths.elementary import square
from hil.report.navigation_bound_step import advance, information_into
from hil.sensors.vision_unit import columns as vmu_columns

_START_MPS: Final = 1e-3  # standard deviation of the velocity at the first pose: of a hold before the approach
_KINDS: Final = ("covariance_position", "covariance_attitude")


class NavigationBound:
    """Mean variances of the bound over the rows of a run, which are added in order.

    settled_s: time of the run from which on they count, unless all is earlier. Of a GNC without an IMU there are none.
    """

    def __init__(self, scenario: Scenario, rig: Rig, settled_s: float) -> None:
        imu = scenario.imu
        self._has_imu = scenario.gnc.navigation.backend != VISION_ALONE
        self._settled_s = settled_s
        self._bench = square(np.array([rig.vmu.bench_sigma_m, math.radians(rig.vmu.bench_sigma_deg)]))
        self._scale = square(scenario.vmu.reported_sigma_scale) if scenario.vmu.source == "model" else 1.0
        radians = math.radians
        self._start = (
            (0.0, square(_START_MPS), square(imu.accelerometer_bias_initial_sigma_mps2)),
            (0.0, square(radians(imu.gyro_drift_initial_sigma_degps)), 0.0),
        )
        noise = (
            (0.0, imu.accelerometer_noise_mps2, imu.accelerometer_bias_noise_mps3),
            (radians(imu.gyro_noise_degps), radians(imu.gyro_drift_noise_degps2), 0.0),
        )
        # densities: a sample's noise holds for the time of the sample
        self._noise = scenario.sample_s * np.square(noise)
        budget = scenario.gnc.navigation.budget
        turned = radians(budget.vision_misalignment_sigma_deg)
        self._constant = square(np.array([budget.vision_bias_sigma_m, [turned] * 3]))
        self._per_range = square(np.array([budget.vision_scale_sigma, turned, turned]))
        free = axes_in_plane(scenario.chaser.held)
        self._free = np.array([float(axis in free) for axis in range(AXES_OF_A_BODY)]).reshape(2, 3)
        self._p: Array | None = None
        self._last_s = 0.0
        self._sums = {True: np.zeros((2, 3)), False: np.zeros((2, 3))}  # after and before ``settled_s``
        self._time_s = {True: 0.0, False: 0.0}

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        poses = vmu_columns.poses(rows)
        if not self._has_imu or not len(poses):
            return
        far = square(poses["z_TC_C"]).sum(axis=1).tolist()
        for t_s, variance, square_m2 in zip(poses["t_s"].tolist(), self._variances(poses), far, strict=True):
            self._add_pose(t_s, variance, square_m2)

    def _variances(self, poses: np.ndarray) -> Array:
        """Return the variances of ``poses`` (n,) of POSE, (n, 2, 3): of each axis of c if the others were known."""
        information = np.empty((len(poses), 2, 3))
        for k, name in enumerate(_KINDS):
            information_into(np.ascontiguousarray(poses[name]), self._bench[k], information[:, k])
        variances: Array = 1.0 / (information * poses["fresh"][:, None, None] * self._scale)
        return variances

    def _add_pose(self, t_s: float, variance: Array, square_m2: float) -> None:
        if self._p is None:
            self._p = np.array([[np.diag(start)] * 3 for start in self._start])
            self._p[:, :, 0, 0], self._last_s = variance, t_s
            return
        elapsed_s = t_s - self._last_s
        if not elapsed_s > 0.0:
            return
        f, q = _step(round(elapsed_s, 9), tuple(map(tuple, self._noise.tolist())))
        is_settled = self._last_s >= self._settled_s
        advance(self._p, f, q, variance, 0.5 * elapsed_s, self._sums[is_settled])
        self._sums[is_settled] += elapsed_s * self._constant
        self._sums[is_settled][0] += elapsed_s * square_m2 * self._per_range
        self._time_s[is_settled] += elapsed_s
        self._last_s = t_s

    def _root(self, k: int) -> list[float] | None:
        span = self._time_s[True] > 0.0
        if self._time_s[span] == 0.0:
            return None
        values: list[float] = np.sqrt(self._free[k] * self._sums[span][k] / self._time_s[span]).tolist()
        return values

    def rows(self) -> dict[str, Any]:
        """Return the root mean squares of the standard deviations, by the keys of the JSON; None without poses."""
        angle = self._root(1)
        return {
            "position_bound_m": self._root(0),
            "attitude_bound_deg": None if angle is None else np.degrees(angle).tolist(),
        }


@lru_cache(maxsize=64)
def _step(elapsed_s: float, noise: tuple[tuple[float, ...], ...]) -> tuple[Array, Array]:
    """Return transitions (2, 3, 3) and noise of both chains over ``elapsed_s``; noise: densities (2, 3).

    An error of the IMU is subtracted from what it is a part of. The noise enters in mid-interval.
    """
    steps = []
    for signs, densities in zip(((1.0, -1.0), (-1.0, 0.0)), noise, strict=True):
        f = np.eye(3)
        f[0, 1], f[1, 2] = elapsed_s * signs[0], elapsed_s * signs[1]
        f[0, 2] = 0.5 * f[0, 1] * f[1, 2]
        middle = 0.5 * (np.eye(3) + f)
        steps.append((f, elapsed_s * linear.product(middle * np.array(densities), middle.T)))
    transitions, added = zip(*steps, strict=True)
    return np.array(transitions), np.array(added)
