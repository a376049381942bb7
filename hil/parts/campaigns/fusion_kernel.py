"""Run of the bench paper's numerical simulation (IV.A) as a compiled loop of the GNC's own kernels.

The truth moves by Hill's equations along scheme 2's reference line while the chaser rotates to the
attitude of H; the filters receive the virtual IMU, poses with white noise of constant sigma, and the scenario's further
sensors, whose constant errors are drawn for each run.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.dynamics import imu as imu_kernels
from hil.dynamics.truth import rate_against_hill
from hil.gnc import guidance
from hil.gnc.estimation import akf, fusion
from hil.gnc.estimation.error_state import BIAS, DRIFT, FILTER_ERRORS, ROTATION, R, V
from hil.gnc.estimation.navigation import normalised_errors
from hil.gnc.estimation.sensor_innovation import innovate
from hil.gnc.estimation.step_memory import step_at
from hil.maths import quat
from hil.maths.arrays import copy_into
from hil.sensors.measurement import deliver, is_any_due, measure
from hil.sensors.vision_unit.pose import write_pose

STEADY_STATE_AFTER_S = 100.0  # errors count from here on
SNAPSHOTS_S = (100.0, 200.0, 300.0, 400.0)  # when the NEES is taken

STUDY_PARAMS = np.dtype(
    [
        ("cycles", "i8"),
        ("frame_cycles", "i8"),  # cycles from one pose to the next
        ("sigma_position", "f8"),  # m, of a pose
        ("sigma_angle", "f8"),  # rad
        ("initial_rotation", "f8", 3),  # rad, rotation vector of the chaser's attitude at the start
        ("rotation_time", "f8"),  # s, until it is that of H
        ("initial_sigma", "f8", 15),  # position, velocity, bias, attitude (rad), drift (rad/s)
    ],
    align=True,
)

STUDY_RESULT = np.dtype(
    [
        ("square_error", "f8", 6),  # mean over t >= STEADY_STATE_AFTER_S: position, m^2, small-angle rotation, rad^2
        ("variance", "f8", 6),  # mean of the filters' own
        ("largest_error", "f8", 6),  # over t >= STEADY_STATE_AFTER_S
        ("nees_pkf", "f8", 4),
        ("nees_akf", "f8", 4),
        ("nis_pkf", "f8"),  # mean over t >= STEADY_STATE_AFTER_S
        ("nis_akf", "f8"),
        ("rejected", "i8"),
    ],
    align=True,
)


@kernel
def _attitude(params, t_s):
    """Return q_CH at ``t_s``: a smooth rotation (minimum-jerk) from the initial attitude to H."""
    remaining = 1.0
    if t_s >= params.rotation_time:
        remaining = 0.0
    elif t_s > 0.0:
        u = t_s / params.rotation_time
        remaining = 1.0 - u * u * u * (10.0 - 15.0 * u + 6.0 * u * u)
    rotation = np.empty(3)
    for i in range(3):
        rotation[i] = remaining * params.initial_rotation[i]
    return quat.from_rotation_vector(rotation)


@kernel
def _move_target(q_HI, w0, truth):
    """Write the target on its circle in ``truth``, with H at ``q_HI``."""
    radius = math.sqrt(truth.r_T_I[0] ** 2 + truth.r_T_I[1] ** 2 + truth.r_T_I[2] ** 2)
    down, along = np.zeros(3), np.zeros(3)
    down[2], along[0] = -radius, w0 * radius
    copy_into(truth.q_HI, q_HI)
    copy_into(truth.r_T_I, quat.transform_back(q_HI, down))
    copy_into(truth.v_T_I, quat.transform_back(q_HI, along))


@kernel
def _move(study, filter_params, line, guidance_state, point, cycle, truth):
    """Move ``truth`` on by one step; leave in it what gyro and accelerometer integrate over the step."""
    dt = filter_params.pkf.dt_s
    w0 = filter_params.orbit.mean_motion
    t_s = (cycle + 0.5) * dt
    guidance.advance(line, guidance_state, t_s, 0, 1)
    guidance.reference(line, guidance_state, t_s, point)
    force_h = np.empty(3)
    force_h[0] = point.a_CT_H[0] - 2.0 * w0 * truth.v_CT_H[2]
    force_h[1] = point.a_CT_H[1] + w0 * w0 * truth.r_CT_H[1]
    force_h[2] = point.a_CT_H[2] + 2.0 * w0 * truth.v_CT_H[0] - 3.0 * w0 * w0 * truth.r_CT_H[2]
    q_next = _attitude(study, (cycle + 1) * dt)
    hill_rotation = np.zeros(3)
    hill_rotation[1] = -w0 * dt
    hill = quat.from_rotation_vector(hill_rotation)
    # c's inertial rotation over the step: q_next = rotation * q * (inverse rotation of H)
    rotation = quat.multiply(q_next, quat.multiply(hill, quat.conjugate(truth.q_CH)))
    phi = quat.to_rotation_vector(rotation)
    middle = np.empty(4)
    for i in range(4):
        middle[i] = truth.q_CH[i] + q_next[i]
    quat.normalise(middle)
    force_c = quat.transform(middle, force_h)
    x = np.empty(6)
    for i in range(6):
        x[i] = 0.0
        for j in range(3):
            x[i] += filter_params.pkf.hill_transition[i, j] * truth.r_CT_H[j]
            x[i] += filter_params.pkf.hill_transition[i, 3 + j] * truth.v_CT_H[j]
            x[i] += filter_params.pkf.hill_response[i, j] * force_h[j]
    for i in range(3):
        truth.r_CT_H[i] = x[i]
        truth.v_CT_H[i] = x[3 + i]
        truth.mean_rate_C[i] = phi[i] / dt
        truth.mean_force_C[i] = force_c[i]
    copy_into(truth.q_CH, q_next)
    copy_into(truth.w_CI_C, truth.mean_rate_C)
    _move_target(quat.multiply(hill, truth.q_HI), w0, truth)


@kernel
def _measure(study, truth, t_s, noise, pose):
    """Write a pose of ``truth`` with the noise (6,) of standard normals."""
    rotation = np.empty(3)
    write_pose(truth.r_CT_H, truth.q_CH, study.sigma_position, study.sigma_angle, pose)
    for i in range(3):
        pose.z_TC_C[i] += study.sigma_position * noise[i]
        rotation[i] = study.sigma_angle * noise[3 + i]
    copy_into(pose.q_CH, quat.multiply(quat.from_rotation_vector(rotation), truth.q_CH))
    pose.t_s = t_s


@kernel
def _fuse_sensors(params, sensors, waiting, errors, t_s, truth, state, memory):
    """Let the sensors measure that are due, with their constant ``errors`` (sensors, errors); fuse what arrives."""
    if is_any_due(sensors, waiting, t_s):
        rate, first, fused = np.empty(3), waiting.waiting, state.sensors
        rate_against_hill(truth, rate)
        measure(sensors, waiting, t_s, truth, rate, truth.r_CT_H, truth.q_CH)
        for i in range(first, waiting.waiting):
            sample = waiting.sample[i]
            slot = params.sensors.slot[sample.sensor]
            innovate(params.sensors, slot, fused, sample, truth.r_CT_H, truth.v_CT_H, truth.q_CH, rate, 0.0)
            for k in range(slot.errors):
                for c in range(slot.n):
                    sample.value[c] += fused.innovation.h_errors[c, k] * errors[sample.sensor, k]
    deliver(waiting, t_s, state.sensors)
    if state.sensors.arrived > 0:
        fusion.fuse_sensors(params, state, memory)


@kernel
def _start(study, params, truth, imu, draws, state, memory):
    """Start filters and truth apart by ``draws`` (15,) standard normals times the initial sigmas."""
    filters, rotation = state.filters, np.empty(3)
    for i in range(15):
        filters.p[i, i] = study.initial_sigma[i] ** 2
    for i in range(3):
        rotation[i] = study.initial_sigma[ROTATION + i] * draws[ROTATION + i]
        filters.pkf.x[i] = truth.r_CT_H[i] + study.initial_sigma[R + i] * draws[R + i]
        filters.pkf.x[3 + i] = truth.v_CT_H[i] + study.initial_sigma[V + i] * draws[V + i]
        filters.pkf.x[6 + i] = params.pkf.initial_bias[i]
        filters.akf.x[4 + i] = params.akf.initial_drift[i]
        imu.bias_C[i] = params.pkf.initial_bias[i] + study.initial_sigma[BIAS + i] * draws[BIAS + i]
        imu.drift_C[i] = params.akf.initial_drift[i] + study.initial_sigma[DRIFT + i] * draws[DRIFT + i]
    for i in range(FILTER_ERRORS, params.errors.n):
        filters.p[i, i] = params.errors.variance[i]
    copy_into(filters.akf.x[0:4], quat.multiply(quat.from_rotation_vector(rotation), truth.q_CH))
    state.started = 1
    state.cycle = 1
    first = step_at(params, memory, 0)
    first.is_start = first.n_poses = 1


@kernel
def _count(truth, filters, error, weight, result):
    """Add the present errors and variances, times ``weight``. error (6,): of the AKF."""
    for i in range(3):
        rotation, difference = error[i], truth.r_CT_H[i] - filters.pkf.x[i]
        result.square_error[i] += weight * difference * difference
        result.square_error[3 + i] += weight * rotation * rotation
        result.largest_error[i] = max(result.largest_error[i], abs(difference))
        result.largest_error[3 + i] = max(result.largest_error[3 + i], abs(rotation))
        result.variance[i] += weight * filters.p[R + i, R + i]
        result.variance[3 + i] += weight * filters.p[ROTATION + i, ROTATION + i]


@kernel
def _trace(truth, filters, error, row):
    """Write errors and sigmas into ``row`` (12,). error (6,): of the AKF."""
    for i in range(3):
        row[i] = truth.r_CT_H[i] - filters.pkf.x[i]
        row[3 + i] = error[i]
        row[6 + i] = math.sqrt(filters.p[R + i, R + i])
        row[9 + i] = math.sqrt(filters.p[ROTATION + i, ROTATION + i])


@kernel
def run_study(
    study, params, imu_params, line, guidance_state, point, truth, imu, pose, state, memory, sensors, waiting, errors,
    rng, noisy, result, trace,
):  # fmt: skip
    """Do one run; write ``result`` (STUDY_RESULT).

    study: STUDY_PARAMS. params: FUSION_PARAMS. imu_params: IMU_PARAMS. line: GUIDANCE_PARAMS. guidance_state, point,
    imu, pose, state: records of the run, zeroed; truth: with the target and H at the start. memory: of
    ``step_memory.new_memory``. sensors: SENSOR_PARAMS. waiting: SENSOR_STATE. errors: (n, n), SI, constant ones of each
    sensor. rng: numpy Generator. noisy: 0 gives the linear covariance along the line, without any noise or error.
    trace: (n, 12), errors and sigmas of position, m, and small-angle rotation, rad, of the first n cycles.
    """
    dt = params.pkf.dt_s
    guidance.start(line, guidance_state)
    guidance.reference(line, guidance_state, 0.0, point)
    copy_into(truth.r_CT_H, point.r_CT_H)
    copy_into(truth.q_CH, _attitude(study, 0.0))
    truth.w_HI_H[1] = -params.orbit.mean_motion
    draws = np.zeros(15)
    noise = np.zeros(18)
    if noisy != 0:
        for i in range(15):
            draws[i] = rng.standard_normal()
    _start(study, params, truth, imu, draws, state, memory)
    error = np.zeros(6)
    steady_after = math.ceil(STEADY_STATE_AFTER_S / dt - 1e-9)
    weight = 1.0 / (study.cycles - steady_after)
    nees = np.empty(2)
    snapshot = 0
    n_nis = 0
    for cycle in range(1, study.cycles + 1):
        t_s = cycle * dt
        _move(study, params, line, guidance_state, point, cycle - 1, truth)
        if noisy != 0:
            for i in range(18):
                noise[i] = rng.standard_normal()
        imu_kernels.sample(imu_params, truth, noise[:12], imu)
        fusion.advance(params, state, memory, imu)
        if cycle % study.frame_cycles == 0:
            _measure(study, truth, t_s, noise[12:], pose)
            fusion.fuse(params, state, memory, pose)
        if params.sensors.fused > 0:
            _fuse_sensors(params, sensors, waiting, errors, t_s, truth, state, memory)
        state.cycle += 1
        akf.error(state.filters.akf, truth.q_CH, imu.drift_C, error)
        if cycle <= trace.shape[0]:
            _trace(truth, state.filters, error, trace[cycle - 1])
        if cycle > steady_after:
            _count(truth, state.filters, error, weight, result)
            # a pose whose attitude was rejected has no NIS of its position
            if cycle % study.frame_cycles == 0 and noisy != 0 and not math.isnan(state.nis_position):
                result.nis_pkf += state.nis_position
                result.nis_akf += state.nis_attitude
                n_nis += 1
        if snapshot < 4 and cycle == round(SNAPSHOTS_S[snapshot] / dt):
            normalised_errors(state.filters, params.orbit, truth, imu, nees)
            result.nees_pkf[snapshot] = nees[0]
            result.nees_akf[snapshot] = nees[1]
            snapshot += 1
    if n_nis > 0:
        result.nis_pkf /= n_nis
        result.nis_akf /= n_nis
    result.rejected = state.rejected_attitude + state.rejected_position
