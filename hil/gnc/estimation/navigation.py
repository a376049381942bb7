"""Where the chaser is and how it moves: both Kalman filters behind two functions."""

from __future__ import annotations

import math

import numpy as np

from hil.core.gnc_records import GncHealth
from hil.core.jit import entry, kernel
from hil.core.messages import POSE
from hil.gnc.estimation import (
    akf,
    fusion,
    hypotheses,
    integrity,
    joint_filter,
    parameter_doubts,
    plane,
    sensor_monitor,
    thrust_model,
)
from hil.gnc.estimation.error_state import BIAS, DRIFT, ROTATION, R, V
from hil.gnc.estimation.fusion import FUSION_PARAMS, FUSION_STATE
from hil.gnc.estimation.integrity import COVARIANCE_INVALID, INTEGRITY_PARAMS, INTEGRITY_STATE
from hil.gnc.estimation.target_orbit import frame_rate
from hil.gnc.estimation.thrust_model import REGAINED
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill
from hil.maths.kalman import normalised_square

SENSOR_SUSPECT = GncHealth.SENSOR_SUSPECT.value
VISION_AND_IMU = 0
VISION_ALONE = 1

NAVIGATION_PARAMS = np.dtype(
    [
        ("sensors", "i8"),
        ("fusion", FUSION_PARAMS),
        ("dt_s", "f8"),  # duration of a cycle
        ("integrity", INTEGRITY_PARAMS),
        ("has_start", "i8"),  # 1: the filters start from ``start`` instead of the first pose
        ("start", POSE),
    ],
    align=True,
)
NAVIGATION_STATE = np.dtype(
    [
        ("fusion", FUSION_STATE),
        ("integrity", INTEGRITY_STATE),
        ("t_s", "f8"),  # time of the run at the next call
        ("fused", "i8"),  # 1: the filters were given a pose in this cycle
    ],
    align=True,
)


@kernel
def bias_of(state, bias, sigma):
    """Write the estimated bias of the accelerometer and its standard deviation, (3,), m/s^2."""
    for i in range(3):
        bias[i] = state.fusion.filters.pkf.x[6 + i]
    joint_filter.sigma(state.fusion.filters, BIAS, sigma)


@kernel
def write_go(state, go):
    """Write the level that a go needs and the largest sum of the innovations into ``go`` (GO_CHECK)."""
    integrity = state.integrity
    copy_into(go.level_m, integrity.go_m)
    go.sum, go.sum_of, go.sum_limit = integrity.worst, integrity.worst_of, integrity.cusum_go


@kernel
def use_imu(params, state, memory, monitor, samples):
    """Let the commands replace an IMU that is suspect, from its first wrong readings on, and the IMU them afterwards.

    A jump of the gyros may be one of their drift, which is estimated again.
    monitor: THRUSTER_MONITOR_STATE. samples: of the IMU in a cycle.
    """
    thrust = state.fusion.thrust
    if monitor.imu_suspect != 0 and thrust.without_imu == 0:
        fusion.replace_imu(params.fusion, state.fusion, memory, monitor.imu_since * samples)
    elif monitor.imu_suspect == 0 and thrust.without_imu == 1 and params.sensors == VISION_AND_IMU:
        thrust.without_imu = REGAINED
    if monitor.jump > 0.0 and thrust.without_imu != 1:
        state.fusion.doubts.acts, state.fusion.doubts.drift = 1, monitor.jump
        monitor.jump = 0.0


@entry
def navigate(params, state, memory, samples, poses, n_poses, out):
    """Use the IMU's samples since the last call and the new poses; write ``out`` (NAVIGATION).

    memory: of ``step_memory.new_memory``. samples: (n,) of IMU, each of one step of the filters; the first call, at the
    start of a run, uses none of them. poses: array of POSE, of which the first ``n_poses`` are
    new. ``out.valid`` is 0 until the first pose. Vision alone has the commands instead of the IMU.
    """
    fill(out.protection_level_m, np.nan)
    out.protection_level_rad = np.nan
    fused = state.fusion
    state.fused = 1 if n_poses > 0 else 0
    if fused.cycle == 0 and params.sensors == VISION_ALONE:
        thrust_model.lose(fused.thrust, fused.filters)
    n = samples.shape[0]
    for i in range(0 if fused.cycle > 0 else n - 1, n):
        fusion.begin_step(params.fusion, fused, memory, samples[i])
        if fused.cycle == 0 and params.has_start != 0:
            fusion.fuse(params.fusion, fused, memory, params.start)
            fused.unconfirmed = 0  # it is given
        if i < n - 1 or n_poses == 0:  # a late pose carries the filters over the last step as well
            fusion.predict_step(params.fusion, fused, memory)
        fused.cycle += 1
    fused.cycle -= 1
    for i in range(n_poses):
        if integrity.admits(params.integrity, state.integrity, poses[i]):
            accepted = fused.accepted
            fusion.fuse(params.fusion, fused, memory, poses[i])
            _watch_update(params, state, accepted)
    if params.fusion.sensors.fused > 0:
        fusion.fuse_sensors(params.fusion, fused, memory)
    fusion.predict_step(params.fusion, fused, memory)
    fused.cycle += 1
    age_s = state.t_s - fused.last_accepted_s
    x = fused.filters.pkf.x
    distance = math.sqrt(x[0] ** 2 + x[1] ** 2 + x[2] ** 2)
    out.health = integrity.vision_health(params.integrity, state.integrity, age_s, fused.rejected_in_a_row, distance)
    out.health = hypotheses.name_cause(
        params.integrity, state.integrity, fused, params.fusion.errors.fraction, params.fusion.pkf.dt_s, out.health
    )
    if params.fusion.sensors.fused > 0 and sensor_monitor.is_suspect(params.fusion.sensors, fused.sensors):
        out.health |= SENSOR_SUSPECT
    if fused.started != 0:
        _write_filters(params.fusion.held, fused.filters, out)
        integrity.protect(params.integrity, params.fusion.sensors, state.integrity, fused, state.t_s, out)
    out.nis_position = fused.nis_position
    out.nis_attitude = fused.nis_attitude
    out.valid = fused.started
    state.t_s += params.dt_s


@kernel
def _watch_update(params, state, accepted):
    """Give the monitors the innovation of the last pose if it was accepted. accepted: number of poses before."""
    fused = state.fusion
    if fused.updated != 0:
        integrity.monitor(params.integrity, state.integrity, fused.innovation, fused.nis_position, fused.nis_attitude)
        parameter_doubts.doubt_drift(params.integrity, state.integrity, fused.doubts)
        integrity.watch_velocity(params.fusion.thrust, params.fusion.errors, state.integrity, fused)
        parameter_doubts.doubt_velocity(params.integrity, state.integrity, params.fusion.errors, fused)
        integrity.follow(params.integrity, state.integrity, fused, params.fusion.pkf.dt_s)
    elif fused.accepted != accepted:  # the filters were started again
        state.integrity.restarted_s = state.t_s


@kernel
def _write_filters(held, filters, out):
    """Write estimate and sigmas, and whether a variance is none of what the plane does not hold."""
    copy_into(out.r_CT_H, filters.pkf.x[0:3])
    copy_into(out.v_CT_H, filters.pkf.x[3:6])
    copy_into(out.q_CH, filters.akf.x[0:4])
    copy_into(out.w_CH_C, filters.akf.w_CH_C)
    joint_filter.sigma(filters, R, out.sigma_r_m)
    joint_filter.sigma(filters, V, out.sigma_v_mps)
    joint_filter.sigma(filters, ROTATION, out.sigma_attitude_rad)
    valid = True
    for i in range(DRIFT):
        known = held != 0 and plane.is_known(held, i)
        valid = valid and (known or BIAS <= i < ROTATION or 0.0 < filters.p[i, i] < np.inf)
    if not valid:
        out.health |= COVARIANCE_INVALID


@kernel
def normalised_errors(filters, orbit, truth, imu, out):
    """Write the NEES of the position filter (9 states) and of the attitude filter (6) into ``out`` (2,).

    In the plane they have 7 and 4: what is known has neither error nor variance.

    filters: FILTERS, of the moment of ``truth``. orbit: their TARGET_ORBIT. ``imu`` holds the true drift and bias. A
    drift of the gyros and an error of the known rate of H are one to the filter, unless it estimates that rate: its
    drift is compared with their sum.
    """
    from_akf, from_pkf = stack.vector(6), stack.vector(9)
    of_akf, of_pkf = stack.matrix(6, 6), stack.matrix(9, 9)
    rate_error, drift = stack.vector(3), stack.vector(3)
    fill(rate_error, 0.0)
    if orbit.estimated == 0:
        frame_rate(orbit, truth.t_s, rate_error)
        for i in range(3):
            rate_error[i] = truth.w_HI_H[i] - rate_error[i]
    quat.transform_into(truth.q_CH, rate_error, drift)
    for i in range(3):
        drift[i] += imu.drift_C[i]
    akf.error(filters.akf, truth.q_CH, drift, from_akf)
    for i in range(3):
        from_pkf[i] = truth.r_CT_H[i] - filters.pkf.x[i]
        from_pkf[3 + i] = truth.v_CT_H[i] - filters.pkf.x[3 + i]
        from_pkf[6 + i] = imu.bias_C[i] - filters.pkf.x[6 + i]
    joint_filter.copy_block(filters, R, of_pkf)
    joint_filter.copy_block(filters, ROTATION, of_akf)
    for k in range(BIAS):
        of_pkf[k, k] += 1.0 if of_pkf[k, k] == 0.0 else 0.0
    for k in range(3):
        of_akf[k, k] += 1.0 if of_akf[k, k] == 0.0 else 0.0
    out[0] = normalised_square(from_pkf, of_pkf)
    out[1] = normalised_square(from_akf, of_akf)
