"""What the monitor should say of a chaser's pose, and what a vision unit's pose says in the monitor's quantities."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat
from hil.models import docking_view
from hil.models.mounting import camera_pose
from hil.monitor.kernels.derived import quantities

_STEP = 1e-5  # m and rad, half the step of the difference quotients


@kernel
def of_chaser(places, r_CT_H, q_CH, values):
    """Write QUANTITIES (12,), SI, of a chaser at rest at ``r_CT_H`` (3,), m, with ``q_CH`` (4,).

    places: STATIONS of the television camera and the docking target.
    """
    t_v, q_vt, d, phi, w = np.empty(3), np.empty(4), np.empty(3), np.empty(3), np.zeros(12)
    camera_pose(places, r_CT_H, q_CH, t_v, q_vt)
    docking_view.of_camera_pose(t_v, q_vt, d, phi)
    for i in range(3):
        w[2 * i], w[6 + 2 * i] = d[i], phi[i]
    quantities(w, values)


@kernel
def _of_moved(places, z_TC_C, q_CH, k, step, values):
    """Write QUANTITIES for the measured pose with its error's component k (z_TC_C, then the turn of c) at ``step``."""
    turn, z = np.zeros(3), z_TC_C.copy()
    if k < 3:
        z[k] += step
    else:
        turn[k - 3] = step
    q = quat.multiply(quat.from_rotation_vector(turn), q_CH)
    r = quat.transform_back(q, z)
    for i in range(3):
        r[i] = -r[i]
    of_chaser(places, r, q, values)


@kernel
def of_measured_pose(places, z_TC_C, covariance_position, q_CH, covariance_attitude, values, sigmas):
    """Write QUANTITIES and their sigmas, (12,) each, SI, of a measured pose (POSE); the range rate stays nan."""
    ahead, behind, slopes = np.empty(12), np.empty(12), np.empty((12, 6))
    _of_moved(places, z_TC_C, q_CH, 0, 0.0, values)
    for k in range(6):
        _of_moved(places, z_TC_C, q_CH, k, _STEP, ahead)
        _of_moved(places, z_TC_C, q_CH, k, -_STEP, behind)
        for i in range(12):
            slopes[i, k] = (ahead[i] - behind[i]) / (2.0 * _STEP)
    for i in range(12):
        variance = 0.0
        for k in range(3):
            for m in range(3):
                variance += slopes[i, k] * covariance_position[k, m] * slopes[i, m]
                variance += slopes[i, 3 + k] * covariance_attitude[k, m] * slopes[i, 3 + m]
        sigmas[i] = math.sqrt(variance)
    values[7] = np.nan
    sigmas[7] = np.nan
