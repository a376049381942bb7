"""Both filters with a memory, so that a pose is fused at its own time however late it arrives.

The last steps are kept, as many as ``new_memory`` holds: the IMU's sample of each, the predicted filters, and the
poses of that moment. A pose is assigned to the step nearest to its exposure; the filters return to that step and are
propagated forward again over the same samples and poses. The result is that of a filter that had waited for
the pose.

A gate rejects poses by their innovations. After ``close_after`` consecutive rejections it is closed: it opens again
only for the last of ``reopen_after`` consecutive poses that agree with each other and with what the IMU has carried
over. The restart keeps the jump as an error that is possible from then on. Poses that agree with each other alone
replace only a start that no pose has confirmed.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.core.messages import POSE
from hil.gnc import akf, akf_additive, body_frame, error_budget, pkf
from hil.gnc.akf import AKF_PARAMS, AKF_STATE
from hil.gnc.akf_additive import AKF_ADDITIVE_STATE
from hil.gnc.body_frame import AXES_STEP
from hil.gnc.error_budget import BUDGET_STATE, ERROR_BUDGET, INNOVATION, NOISE_FACTOR
from hil.gnc.integrity import pose_sigmas
from hil.gnc.pkf import PKF_PARAMS, PKF_STATE
from hil.gnc.target_orbit import HILL_STEP, TARGET_ORBIT, move_hill_frame
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, copy_matrix
from hil.maths.limits import to_integer

POSES_PER_STEP = 2

NOT_GATED, REJECTED, ATTITUDE_ONLY, ACCEPTED, REOPENED, RESTARTED = range(6)

MULTIPLICATIVE = 0
AS_PRINTED = 1

FUSION_PARAMS = np.dtype(
    [
        ("attitude_form", "i8"),
        ("memory", "i8"),  # steps that are kept
        ("ahead", "i8"),  # steps that an exposure may be in the future: stamps and cycles are rounded
        ("orbit", TARGET_ORBIT),
        ("close_after", "i8"),  # consecutive rejections
        ("reopen_after", "i8"),  # consecutive poses that agree
        ("akf", AKF_PARAMS),
        ("pkf", PKF_PARAMS),
        ("budget", ERROR_BUDGET),
    ],
    align=True,
)

FILTERS = np.dtype([("akf", AKF_STATE), ("additive", AKF_ADDITIVE_STATE), ("pkf", PKF_STATE)], align=True)

STEP = np.dtype(
    [
        ("rate_C", "f8", 3),  # the IMU's sample of the step that ended here
        ("force_C", "f8", 3),
        ("hill", HILL_STEP),
        ("predicted", FILTERS),  # before the poses of this moment
        ("n_poses", "i8"),
        ("is_start", "i8"),  # 1: the filters were started here, with the first pose, which is not fused
        ("poses", POSE, POSES_PER_STEP),
        ("gated", "i8", POSES_PER_STEP),  # results of the gate: NOT_GATED, or the part that was accepted
        ("budget", BUDGET_STATE),  # as ``predicted``; not used without a budget
    ],
    align=True,
)

FUSION_STATE = np.dtype(
    [
        ("started", "i8"),
        ("cycle", "i8"),  # number of the present step
        ("start_cycle", "i8"),
        ("filters", FILTERS),
        ("accepted", "i8"),
        ("rejected_position", "i8"),  # by the gate on the innovation
        ("rejected_attitude", "i8"),
        ("rejected_closed", "i8"),  # by the closed gate
        ("duplicates", "i8"),
        ("too_late", "i8"),
        ("rejected_in_a_row", "i8"),  # consecutive rejections
        ("nis_position", "f8"),
        ("nis_attitude", "f8"),
        ("last_accepted_s", "f8"),  # exposure of the newest accepted pose, time of the run
        ("agreeing", "i8"),  # consecutive poses that pass the closed gate
        ("mutual", "i8"),  # consecutive poses that agree with the one before
        ("seen_s", "f8"),  # the last pose
        ("seen_r", "f8", 3),  # m, in H
        ("seen_q", "f8", 4),
        ("jump_m", "f8", 3),  # m, in H: largest at which the gate was opened again
        ("updated", "i8"),  # 1: the last pose was accepted, and the following are of it
        ("innovation", "f8", 6),  # position, attitude, each over its standard deviation
        ("noise_m", "f8"),  # standard deviation of the innovation
        ("noise_rad", "f8"),
        ("gain_position", "f8"),  # largest row of the gain
        ("gain_velocity", "f8"),  # 1/s
        ("gain_attitude", "f8"),
        ("interval_s", "f8"),  # between the last two accepted poses
        # with an error budget
        ("budget", BUDGET_STATE),
        ("noise", NOISE_FACTOR),
        ("found_attitude", INNOVATION),
        ("found_position", INNOVATION),
        ("axes", AXES_STEP),  # of a target that tumbles
    ],
    align=True,
)

_SPEED_MAX, _RATE_MAX = 0.2, 0.05  # m/s, rad/s: motion that two poses which agree may have between them
_AGREEMENT = 5.0 * math.sqrt(2.0)  # standard deviations of a pose


def new_memory(params: np.record) -> np.ndarray:
    """Return the zeroed memory of filters with FUSION_PARAMS ``params``, (n,) of STEP."""
    return np.zeros(int(params.memory), STEP)


@kernel
def _copy_attitude(source, target):
    """Copy either attitude filter; the two differ in the size of ``p`` alone."""
    copy_into(target.x, source.x)
    copy_into(target.w_CH_C, source.w_CH_C)
    copy_matrix(target.p, source.p)


@kernel
def _copy_filters(params, source, target):
    _copy_attitude(source.akf, target.akf)
    if params.attitude_form == AS_PRINTED:
        _copy_attitude(source.additive, target.additive)
    copy_into(target.pkf.x, source.pkf.x)
    copy_matrix(target.pkf.p, source.pkf.p)
    copy_matrix(target.pkf.c, source.pkf.c)


@kernel
def _keep_predicted(params, state, step):
    """Keep the filters as they are before the poses of ``step`` (STEP)."""
    _copy_filters(params, state.filters, step.predicted)
    if params.budget.n != 0:
        error_budget.copy_state(params.budget, state.budget, step.budget)


@kernel
def _return_to(params, state, step):
    """Return the filters to what ``_keep_predicted`` has kept."""
    _copy_filters(params, step.predicted, state.filters)
    if params.budget.n != 0:
        error_budget.copy_state(params.budget, step.budget, state.budget)


@kernel
def _copy_pose(source, target):
    copy_into(target.z_TC_C, source.z_TC_C)
    copy_into(target.q_CH, source.q_CH)
    target.t_s = source.t_s
    copy_matrix(target.covariance_position, source.covariance_position)
    copy_matrix(target.covariance_attitude, source.covariance_attitude)


@kernel
def _start(params, state, pose, filters, budget):
    """Start ``filters`` and, with an error budget, its state ``budget`` from ``pose``."""
    akf.start(params.akf, pose, filters.akf)
    pkf.start(params.pkf, pose, filters.akf.p, filters.pkf)
    if params.attitude_form == AS_PRINTED:
        akf_additive.from_multiplicative(filters.akf.x, filters.akf.p, filters.additive)
    if params.budget.n != 0:
        error_budget.start(params.budget, pose, state.noise, filters.akf, filters.pkf, budget)


@entry
def _predict(params, state, step):
    """Carry both filters over ``step`` (STEP), in the axes of a target that tumbles as well."""
    filters, axes, n = state.filters, state.axes, params.budget.n
    if step.hill.rotates != 0:
        body_frame.correct_motion(step.hill, filters.akf, params.akf.initial_drift, params.akf.dt_s, axes)
        body_frame.enter_middle(axes, filters.pkf, state.budget.p, n)
    _predict_filters(params, state, step)
    if step.hill.rotates != 0:
        body_frame.leave_middle(axes, filters.pkf, state.budget.p, n)


@kernel
def _predict_filters(params, state, step):
    """Carry both filters over ``step`` (STEP)."""
    filters, middle = state.filters, stack.vector(4)
    copy_into(middle, filters.akf.x[0:4])
    akf.predict_state(params.akf, filters.akf, step.rate_C, step.hill)
    additive = params.attitude_form == AS_PRINTED
    if additive:
        akf_additive.predict(params.akf, filters.additive, step.rate_C, step.hill)
        copy_into(filters.akf.x, filters.additive.x)
    for i in range(4):
        middle[i] += filters.akf.x[i]
    quat.normalise(middle)
    if params.budget.n != 0:
        _predict_joint(params, state, middle, step)
        return
    # with the attitude's covariance as it was before the step
    pkf.predict(params.pkf, filters.pkf, step.force_C, middle, filters.akf.p, filters.akf.phi, step.hill)
    if additive:
        _publish_additive(filters)
    else:
        akf.predict_covariance(params.akf, filters.akf)


@kernel
def _predict_joint(params, state, middle, step):
    """Carry position, parameters and joint covariance over ``step``. middle: attitude (4,) in mid-step."""
    filters = state.filters
    a, force, rate = stack.matrix(3, 3), stack.vector(3), stack.vector(3)
    quat.to_matrix_into(middle, a)
    force[0], force[1], force[2] = pkf.predict_state(params.pkf, filters.pkf, step.force_C, a, step.hill)
    for i in range(3):
        rate[i] = step.rate_C[i] - filters.akf.x[4 + i]
    error_budget.predict(
        params.budget, params.akf, params.pkf, a, force, rate, filters.akf, filters.pkf, state.budget
    )  # fmt: skip


@kernel
def _innovate_attitude(params, state, q_measured, covariance, gain, out):
    """Write innovation and gain of the attitude filter; return the NIS."""
    if params.budget.n != 0:
        return error_budget.innovate_attitude(
            params.budget, state.budget, state.noise, state.filters.akf, q_measured, covariance,
            state.found_attitude, gain, out,
        )  # fmt: skip
    return akf.innovate(state.filters.akf, q_measured, covariance, gain, out)


@kernel
def _innovate_position(params, state, z, covariance, delta_s, h, h_attitude, gain, out):
    """Write innovation and gain of the position filter; return the NIS."""
    filters = state.filters
    if params.budget.n != 0:
        return error_budget.innovate_position(
            params.budget, state.budget, state.noise, filters.akf, filters.pkf, z, covariance, delta_s,
            state.found_position, gain, out,
        )  # fmt: skip
    return pkf.innovate(
        filters.pkf, z, covariance, delta_s, filters.akf.x[0:4], filters.akf.p, h, h_attitude, gain, out
    )


@kernel
def _publish_additive(filters):
    """Write state and covariance (in c) of the additive filter into the multiplicative one's records."""
    copy_into(filters.akf.x, filters.additive.x)
    copy_into(filters.akf.w_CH_C, filters.additive.w_CH_C)
    akf_additive.error_covariance(filters.additive, filters.akf.p)


@kernel
def _compare(state, pose):
    """Compare ``pose`` with the one before: count it in ``state.mutual`` if both agree, otherwise count from 0."""
    r, rotation = stack.vector(3), stack.vector(3)
    quat.transform_back_into(pose.q_CH, pose.z_TC_C, r)
    quat.rotation_between(pose.q_CH, state.seen_q, rotation)
    (sigma, sigma_angle), elapsed_s = pose_sigmas(pose), abs(pose.t_s - state.seen_s)
    agree = True
    for i in range(3):
        agree = agree and abs(r[i] + state.seen_r[i]) <= _AGREEMENT * sigma + _SPEED_MAX * elapsed_s
        agree = agree and abs(rotation[i]) <= _AGREEMENT * sigma_angle + _RATE_MAX * elapsed_s
    state.mutual = state.mutual + 1 if agree else 0
    for i in range(3):
        state.seen_r[i] = -r[i]
    copy_into(state.seen_q, pose.q_CH)
    state.seen_s = pose.t_s


@kernel
def _jump(filters, z, delta_s, out):
    """Write by how much, m, in H, the position ``z`` (3,) is off the filter's (3,)."""
    quat.transform_back_into(filters.akf.x[0:4], z, out)
    for i in range(3):
        out[i] = -out[i] - filters.pkf.x[i] - delta_s * filters.pkf.x[3 + i]


@kernel
def _closed_gate(params, state, passes):
    """Return the result of the closed gate for a pose that agrees with the IMU's carry-over if ``passes``."""
    state.agreeing = state.agreeing + 1 if passes and state.mutual > 0 else 0
    if state.agreeing >= params.reopen_after:
        return REOPENED
    if state.accepted == 0 and state.mutual >= params.reopen_after:
        return RESTARTED
    return REJECTED


@kernel
def _remember_update(params, state, pose, innovation_a, gain_a, innovation_p, gain_p):
    """Keep what the monitors need of an accepted pose: its innovations, their noise and the gains."""
    filters = state.filters
    distance, p_position, p_attitude = 0.0, 0.0, 0.0
    for i in range(3):
        distance += pose.z_TC_C[i] ** 2
        p_position = max(p_position, filters.pkf.p[i, i])
        p_attitude = max(p_attitude, filters.akf.p[i, i])
    state.noise_m = state.noise_rad = state.gain_position = state.gain_velocity = state.gain_attitude = 0.0
    for i in range(3):
        of_position = math.sqrt(pose.covariance_position[i, i] + p_position + distance * p_attitude)
        of_attitude = math.sqrt(pose.covariance_attitude[i, i] + p_attitude)
        if params.budget.n != 0:
            of_position = math.sqrt(state.found_position.s[i, i])
            of_attitude = math.sqrt(state.found_attitude.s[i, i])
        state.innovation[i] = innovation_p[i] / of_position
        state.innovation[3 + i] = innovation_a[i] / of_attitude
        state.noise_m, state.noise_rad = max(state.noise_m, of_position), max(state.noise_rad, of_attitude)
        position, velocity, attitude = 0.0, 0.0, 0.0
        for j in range(3):
            position += gain_p[i, j] ** 2
            velocity += gain_p[3 + i, j] ** 2
            attitude += gain_a[i, j] ** 2
        state.gain_position = max(state.gain_position, math.sqrt(position))
        state.gain_velocity = max(state.gain_velocity, math.sqrt(velocity))
        state.gain_attitude = max(state.gain_attitude, math.sqrt(attitude))
    state.updated = 1


@kernel
def _update_attitude(params, state, q_measured, covariance, gain, innovation):
    """Fuse an accepted innovation of the attitude."""
    filters = state.filters
    if params.budget.n != 0:
        error_budget.update(params.budget, state.budget, state.found_attitude, innovation, filters.akf, filters.pkf)
        return
    if params.attitude_form == AS_PRINTED:
        akf_additive.update(filters.additive, q_measured, covariance)
    akf.update(filters.akf, covariance, gain, innovation)
    if params.attitude_form == AS_PRINTED:
        _publish_additive(filters)
    pkf.follow_attitude_update(filters.pkf, filters.akf.keep)


@entry
def _fuse_pose(params, state, pose, moment_s, gated):
    """Fuse one pose whose step is at ``moment_s``; return the part that was accepted.

    gated: NOT_GATED for a new pose, which is then gated and counted; otherwise the earlier result of the gate.
    """
    filters = state.filters
    if gated == RESTARTED:
        _start(params, state, pose, filters, state.budget)
        return RESTARTED
    delta_s = pose.t_s - moment_s
    rotation, z, back, q_measured = stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        rotation[i] = -delta_s * filters.akf.w_CH_C[i]
    # c at the filter's moment, from c at the exposure
    quat.from_rotation_vector_into(rotation, back)
    quat.multiply_into(back, pose.q_CH, q_measured)
    quat.transform_into(back, pose.z_TC_C, z)
    gain_a, innovation_a = stack.matrix(6, 3), stack.vector(3)
    gain_p, innovation_p = stack.matrix(9, 3), stack.vector(3)
    h, h_attitude, jump = stack.matrix(3, 9), stack.matrix(3, 3), stack.vector(3)
    nis_a = _innovate_attitude(params, state, q_measured, pose.covariance_attitude, gain_a, innovation_a)
    nis_p = np.nan
    found = gated
    if gated == NOT_GATED:
        found = ATTITUDE_ONLY if 0.0 <= nis_a <= params.akf.gate else REJECTED
        if state.rejected_in_a_row >= params.close_after:
            nis_p = _innovate_position(
                params, state, z, pose.covariance_position, delta_s, h, h_attitude, gain_p, innovation_p
            )
            found = _closed_gate(params, state, found == ATTITUDE_ONLY and 0.0 <= nis_p <= params.pkf.gate)
        if found == RESTARTED:
            _start(params, state, pose, filters, state.budget)
            _count(params, state, pose, found, nis_a, nis_p)
            return found
    if found == REOPENED:
        _jump(filters, z, delta_s, jump)
        for i in range(3):
            filters.pkf.p[i, i] += jump[i] * jump[i]
            if params.budget.n != 0:
                state.budget.p[i, i] += jump[i] * jump[i]
            state.jump_m[i] = max(state.jump_m[i], abs(jump[i]))
    if found >= ATTITUDE_ONLY:
        _update_attitude(params, state, q_measured, pose.covariance_attitude, gain_a, innovation_a)
        nis_p = _innovate_position(
            params, state, z, pose.covariance_position, delta_s, h, h_attitude, gain_p, innovation_p
        )
        if gated == NOT_GATED and found == ATTITUDE_ONLY and 0.0 <= nis_p <= params.pkf.gate:
            found = ACCEPTED
        if found >= ACCEPTED:
            if gated == NOT_GATED:
                _remember_update(params, state, pose, innovation_a, gain_a, innovation_p, gain_p)
            if params.budget.n != 0:
                error_budget.update(
                    params.budget, state.budget, state.found_position, innovation_p, filters.akf, filters.pkf
                )
            else:
                pkf.update(filters.pkf, pose.covariance_position, filters.akf.p, h, h_attitude, gain_p, innovation_p)
            if params.budget.n != 0 and gated == NOT_GATED:
                error_budget.adapt(params.budget, state.noise, 0, state.found_position, innovation_p)
                error_budget.adapt(params.budget, state.noise, 1, state.found_attitude, innovation_a)
    if gated == NOT_GATED:
        _count(params, state, pose, found, nis_a, nis_p)
    return found


@kernel
def _count(params, state, pose, found, nis_attitude, nis_position):
    """Count a pose that has just been gated."""
    state.nis_attitude = nis_attitude
    state.nis_position = nis_position
    if found == REJECTED and state.rejected_in_a_row >= params.close_after:
        state.rejected_closed += 1
    elif found == REJECTED:
        state.rejected_attitude += 1
    elif found == ATTITUDE_ONLY:
        state.rejected_position += 1
    else:
        state.accepted += 1
        state.agreeing = 0
        if pose.t_s > state.last_accepted_s:
            state.interval_s = pose.t_s - state.last_accepted_s
            state.last_accepted_s = pose.t_s
    state.rejected_in_a_row = 0 if found >= ACCEPTED else state.rejected_in_a_row + 1


@kernel
def _place(params, state, memory, pose):
    """Put a pose into the step nearest to its exposure; return that step's number, or -1 if there is none."""
    cycle = to_integer(math.floor(pose.t_s / params.pkf.dt_s + 0.5))
    if cycle > state.cycle + params.ahead:  # the unit's clock runs ahead: the moment of exposure is unknown
        state.too_late += 1
        return -1
    cycle = min(cycle, state.cycle)
    oldest = max(0, state.cycle - memory.shape[0] + 1)
    if state.started != 0:
        oldest = max(oldest, state.start_cycle)
    if cycle < oldest:
        state.too_late += 1
        return -1
    step = memory[cycle % memory.shape[0]]
    held = step.n_poses
    for k in range(held):
        if abs(step.poses[k].t_s - pose.t_s) < 1e-6:
            state.duplicates += 1
            return -1
    if held >= POSES_PER_STEP:
        state.too_late += 1
        return -1
    _copy_pose(pose, step.poses[held])
    step.gated[held] = NOT_GATED
    step.n_poses += 1
    if state.started == 0:
        step.is_start = 1
        state.started = 1
        state.start_cycle = cycle
        state.last_accepted_s = pose.t_s
        _start(params, state, pose, step.predicted, step.budget)
    return cycle


@kernel
def _fuse_step(params, state, step, moment_s):
    """Fuse the poses of ``step``."""
    for k in range(step.is_start, step.n_poses):
        step.gated[k] = _fuse_pose(params, state, step.poses[k], moment_s, step.gated[k])


@entry
def advance(params, state, memory, imu):
    """Begin the next step: keep its IMU sample and carry the filters over it.

    memory: of ``new_memory``. The very first step has no sample before it.
    """
    step = memory[state.cycle % memory.shape[0]]
    copy_into(step.rate_C, imu.rate_C)
    copy_into(step.force_C, imu.force_C)
    move_hill_frame(params.orbit, (state.cycle - 1) * params.pkf.dt_s, params.pkf.dt_s, step.hill)
    step.n_poses = 0
    step.is_start = 0
    state.nis_position = np.nan
    state.nis_attitude = np.nan
    if state.started != 0:
        _predict(params, state, step)
        _keep_predicted(params, state, step)


@entry
def fuse(params, state, memory, pose):
    """Fuse a pose (POSE) at its own time: back to its step, and forward again."""
    state.updated = 0
    first = _place(params, state, memory, pose)
    if first < 0:
        return
    _compare(state, pose)
    dt, n = params.pkf.dt_s, memory.shape[0]
    _return_to(params, state, memory[first % n])
    for cycle in range(first, state.cycle + 1):
        step = memory[cycle % n]
        if cycle > first:
            _predict(params, state, step)
            _keep_predicted(params, state, step)
        _fuse_step(params, state, step, cycle * dt)
