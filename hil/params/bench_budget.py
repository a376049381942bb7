"""Error budget of the bench: what a pose by its encoders is worth, per axis and place."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.bench.kinematics import BENCH_PARAMS
from hil.bench.machine_poses import pose_sigmas
from hil.config.bench_geometry import geometry_of, measured_errors
from hil.config.rig import Rig
from hil.config.tables.machine import NAMES, PARAMETERS, ROTATIONS
from hil.core.messages import Array
from hil.maths import linear
from hil.params.bench import bench, set_geometry

STEP = 1e-6  # m, rad, of a parameter for the slope of a pose


class PoseSigmas(NamedTuple):
    """Standard deviations of a pose, (3,) each: position in H, m, and rotation about the axes of c, deg."""

    sigma_m: Array
    sigma_deg: Array


class BenchSigma:
    """Standard deviations of the chaser's pose by the encoders of ``rig``, as a function of these.

    Contributions: parameters of the geometry, by the covariance of the geometry file or, if they were not measured, by
    the tolerance of the rig file; noise of the encoders; drift since the measurement. Raises BadInput for a geometry
    file that does not fit.
    """

    def __init__(self, rig: Rig, step_s: float) -> None:
        vector = measured_errors(rig)
        self._machines = machines_about(rig, step_s, np.zeros(PARAMETERS) if vector is None else vector)
        self._covariance = parameter_covariance(rig)
        self._steps = np.full(PARAMETERS, STEP)
        self._slopes, self._out = np.empty((6, PARAMETERS)), np.empty(6)
        self._encoders = np.array([rig.rails.encoder_sigma_m] * 3 + [math.radians(rig.turntable.encoder_sigma_deg)] * 3)
        self._arm = linear.length(self._machines[0].lever_arm)
        drift = [rig.bench.thermal_sigma_m] * 3 + [math.radians(rig.bench.thermal_sigma_deg)] * 3
        self._drift = np.array(drift)

    def __call__(self, rail_m: Array, gimbal_rad: Array) -> PoseSigmas:
        """Return the standard deviations with the encoders at ``rail_m`` (3,), m, and ``gimbal_rad`` (3,), rad."""
        out = self._out
        pose_sigmas(self._machines, self._steps, self._covariance, rail_m, gimbal_rad, self._slopes, out)
        rails, gimbals = self._encoders[:3].max(), self._encoders[3:].max()
        encoders = [rails * rails + self._arm * gimbals * self._arm * gimbals] * 3 + [gimbals * gimbals] * 3
        total = np.sqrt(out * out + np.array(encoders) + self._drift * self._drift)
        return PoseSigmas(total[:3], np.degrees(total[3:]))


def machines_about(rig: Rig, step_s: float, vector: Array) -> np.ndarray:
    """Return BENCH_PARAMS, (PARAMETERS + 1,): of ``vector``, then with each parameter larger by STEP."""
    machines = np.zeros(PARAMETERS + 1, BENCH_PARAMS).view(np.recarray)
    machines[:] = bench(rig, step_s)
    for k in range(PARAMETERS + 1):
        moved = vector.copy()
        moved[k - 1 : k] += STEP
        set_geometry(machines[k], rig, moved)
    return machines


def parameter_covariance(rig: Rig) -> Array:
    """Return the covariance of the parameters of the geometry, (PARAMETERS, PARAMETERS), m and rad.

    Those that the geometry file does not have are independent, with the tolerance of the rig file.
    """
    tolerance = np.where(ROTATIONS, math.radians(rig.bench.tolerance_deg), rig.bench.tolerance_m)
    geometry = geometry_of(rig)
    if geometry is None:
        return np.diag(tolerance * tolerance)
    covariance = geometry.covariance_matrix
    for k, name in enumerate(NAMES):
        if name in geometry.not_observed:
            covariance[k, k] = tolerance[k] * tolerance[k]
    return covariance
