"""Where the chaser is and how it moves: both Kalman filters, or vision alone, behind one function."""

from __future__ import annotations

import math

import numpy as np

from hil.gnc import akf, pkf, vision_only
from hil.gnc.akf import AKF_PARAMS, AKF_STATE
from hil.gnc.pkf import PKF_PARAMS, PKF_STATE
from hil.gnc.vision_only import VISION_ONLY_PARAMS, VISION_ONLY_STATE
from hil.maths import quat
from hil.maths.arrays import copy_into, fill
from hil.maths.jit import kernel
from hil.maths.kalman import normalised_square

VISION_AND_IMU = 0
VISION_ALONE = 1

NAVIGATION_PARAMS = np.dtype(
    [("sensors", "i8"), ("akf", AKF_PARAMS), ("pkf", PKF_PARAMS), ("vision_only", VISION_ONLY_PARAMS)],
    align=True,
)
NAVIGATION_STATE = np.dtype(
    [("started", "i8"), ("akf", AKF_STATE), ("pkf", PKF_STATE), ("vision_only", VISION_ONLY_STATE)],
    align=True,
)


@kernel
def navigate(params, state, imu, pose, out):
    """Take the step's IMU sample and, where ``pose.fresh``, a pose; write ``out`` (NAVIGATION).

    Nothing is known, and ``out.valid`` is 0, until the first pose came.
    """
    if params.sensors == VISION_AND_IMU:
        _fuse(params, state, imu, pose, out)
    else:
        _look(params, state, pose, out)
    out.valid = state.started


@kernel
def _fuse(params, state, imu, pose, out):
    if state.started == 0:
        if pose.fresh != 0:
            akf.start(params.akf, pose, state.akf)
            pkf.start(params.pkf, pose, state.pkf)
            state.started = 1
    else:
        middle = state.akf.x[0:4].copy()
        akf.predict(params.akf, state.akf, imu.rate_C)
        for i in range(4):
            middle[i] += state.akf.x[i]
        quat.normalise(middle)
        pkf.predict(params.pkf, state.pkf, imu.force_C, middle)
        if pose.fresh != 0:
            akf.update(state.akf, pose)
            turn_covariance = np.empty((6, 6))
            akf.error_covariance(state.akf, turn_covariance)
            pkf.update(state.pkf, pose, state.akf.x[0:4], turn_covariance)
    if state.started != 0:
        copy_into(out.r_CT_H, state.pkf.x[0:3])
        copy_into(out.v_CT_H, state.pkf.x[3:6])
        copy_into(out.q_CH, state.akf.x[0:4])
        copy_into(out.w_CH_C, state.akf.w_CH_C)
        pkf.sigma(state.pkf, 0, out.sigma_r_m)
        pkf.sigma(state.pkf, 3, out.sigma_v_mps)
        turn_covariance = np.empty((6, 6))
        akf.error_covariance(state.akf, turn_covariance)
        for i in range(3):
            out.sigma_attitude_rad[i] = math.sqrt(max(0.0, turn_covariance[i, i]))
        out.nis_position = state.pkf.nis
        out.nis_attitude = state.akf.nis


@kernel
def _look(params, state, pose, out):
    if state.started == 0:
        if pose.fresh != 0:
            vision_only.start(pose, state.vision_only)
            state.started = 1
    else:
        vision_only.predict(params.vision_only, state.vision_only)
        if pose.fresh != 0:
            vision_only.update(params.vision_only, state.vision_only, pose)
    copy_into(out.r_CT_H, state.vision_only.r_CT_H)
    copy_into(out.v_CT_H, state.vision_only.v_CT_H)
    copy_into(out.q_CH, state.vision_only.q_CH)
    copy_into(out.w_CH_C, state.vision_only.w_CH_C)
    fill(out.sigma_r_m, np.nan)
    fill(out.sigma_v_mps, np.nan)
    fill(out.sigma_attitude_rad, np.nan)
    out.nis_position = np.nan
    out.nis_attitude = np.nan


@kernel
def normalised_errors(state, truth, imu, out):
    """Write the NEES of the position filter (9 states) and of the attitude filter (6) into ``out`` (2,).

    nan before the start and for vision alone, which knows no covariance. ``imu`` holds the true
    drift and bias. The filters' states belong to the moment of ``truth``.
    """
    from_akf = np.empty(6)
    from_pkf = np.empty(9)
    covariance = np.empty((6, 6))
    akf.error(state.akf, truth.q_CH, imu.drift_C, from_akf)
    akf.error_covariance(state.akf, covariance)
    for i in range(3):
        from_pkf[i] = truth.r_CT_H[i] - state.pkf.x[i]
        from_pkf[3 + i] = truth.v_CT_H[i] - state.pkf.x[3 + i]
        from_pkf[6 + i] = imu.bias_C[i] - state.pkf.x[6 + i]
    out[0] = normalised_square(from_pkf, state.pkf.p)
    out[1] = normalised_square(from_akf, covariance)
