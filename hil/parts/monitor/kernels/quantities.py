"""Quantities of the docking monitor (range, rate, passive angles, line of sight) from its motion or another pose."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.core.jit import kernel
from hil.maths import quat
from hil.models import docking_view
from hil.parts.monitor.results import QUANTITIES
from hil.sensors.mounting import camera_pose

Floats = NDArray[np.float64]

_STEP: Final = 1e-6
_POSE_STEP = 1e-5  # m and rad, half step of the difference quotients


@kernel
def quantities(w, out):
    """Write QUANTITIES (12,), SI, for the motion ``w`` (12,): d1, d1', d2, d2', d3, d3', phi1, phi1', ... (3.2).

    Passive pitch atan2(d2, hypot(d1, d3)), passive yaw atan2(d1, d3); line of sight of the disc's centre in S:
    atan2(x1, x3) to the right, atan2(x2, x3) up.
    """
    d, phi, origin = np.empty(3), np.empty(3), np.zeros(3)
    along, square = 0.0, 0.0
    for i in range(3):
        d[i], phi[i] = w[2 * i], w[6 + 2 * i]
        out[i], out[3 + i] = d[i], phi[i]
        square += d[i] * d[i]
        along += d[i] * w[2 * i + 1]
    out[6] = math.sqrt(square)
    out[7] = along / out[6]
    out[8] = math.atan2(d[1], math.hypot(d[0], d[2]))
    out[9] = math.atan2(d[0], d[2])
    x = docking_view.to_camera(docking_view.attitude(phi), d, origin)
    out[10] = math.atan2(x[0], x[2])
    out[11] = math.atan2(x[1], x[2])


def derive(w: Floats, covariance: Floats) -> tuple[Floats, Floats]:
    """Return QUANTITIES and their sigmas, (12,) each, SI, for the motion (12,) and its covariance (12, 12)."""
    n = len(QUANTITIES)
    values, ahead, behind = np.empty(n), np.empty(n), np.empty(n)
    quantities(w, values)
    slopes = np.empty((n, 12))
    for k in range(12):
        moved = w.copy()
        moved[k] = w[k] + _STEP
        quantities(moved, ahead)
        moved[k] = w[k] - _STEP
        quantities(moved, behind)
        slopes[:, k] = (ahead - behind) / (2.0 * _STEP)
    variances = np.einsum("ij,jk,ik->i", slopes, covariance, slopes)
    return values, np.sqrt(np.maximum(variances, 0.0))


@kernel
def of_chaser(mounting, r_CT_H, q_CH, values):
    """Write QUANTITIES (12,), SI, of a chaser at rest at ``r_CT_H`` (3,), m, with ``q_CH`` (4,).

    mounting: MOUNTING of the television camera and the docking target.
    """
    t_v, q_vt, d, phi, w = np.empty(3), np.empty(4), np.empty(3), np.empty(3), np.zeros(12)
    camera_pose(mounting, r_CT_H, q_CH, t_v, q_vt)
    docking_view.of_camera_pose(t_v, q_vt, d, phi)
    for i in range(3):
        w[2 * i], w[6 + 2 * i] = d[i], phi[i]
    quantities(w, values)


@kernel
def _of_moved(mounting, z_TC_C, q_CH, k, step, values):
    """Write QUANTITIES of the measured pose with component k of its error (z_TC_C, rotation of c) equal to ``step``."""
    turn, z = np.zeros(3), z_TC_C.copy()
    if k < 3:
        z[k] += step
    else:
        turn[k - 3] = step
    q = quat.multiply(quat.from_rotation_vector(turn), q_CH)
    r = quat.transform_back(q, z)
    for i in range(3):
        r[i] = -r[i]
    of_chaser(mounting, r, q, values)


@kernel
def of_measured_pose(mounting, z_TC_C, covariance_position, q_CH, covariance_attitude, values, sigmas):
    """Write QUANTITIES and their sigmas, (12,) each, SI, of a measured pose (POSE); the range rate is nan."""
    ahead, behind, slopes = np.empty(12), np.empty(12), np.empty((12, 6))
    _of_moved(mounting, z_TC_C, q_CH, 0, 0.0, values)
    for k in range(6):
        _of_moved(mounting, z_TC_C, q_CH, k, _POSE_STEP, ahead)
        _of_moved(mounting, z_TC_C, q_CH, k, -_POSE_STEP, behind)
        for i in range(12):
            slopes[i, k] = (ahead[i] - behind[i]) / (2.0 * _POSE_STEP)
    for i in range(12):
        variance = 0.0
        for k in range(3):
            for m in range(3):
                variance += slopes[i, k] * covariance_position[k, m] * slopes[i, m]
                variance += slopes[i, 3 + k] * covariance_attitude[k, m] * slopes[i, 3 + m]
        sigmas[i] = math.sqrt(variance)
    values[7] = np.nan
    sigmas[7] = np.nan
