"""The filters with a memory, so that a pose is fused at its own time however late it arrives.

The last steps are kept (``step_memory``): the IMU's sample of each, the commanded thrusters, the predicted estimates
with their covariance, and the poses of that moment. A pose is assigned to the step nearest to its exposure; the
filters return to that step and are propagated forward again over the same samples and poses. The estimate is that of a
filter that had waited for the pose; a gate decides on a pose once, when it arrives, and the factor of the noise is
adapted once.

Of a pose whose attitude is a guess the position is fused alone; it neither starts the filters nor opens a closed gate.

A gate rejects poses by their innovations. After ``close_after`` consecutive rejections it is closed: it opens again
only for the last of ``reopen_after`` consecutive poses that agree with each other and with what the IMU has carried
over. The restart keeps the jump as an error that is possible from then on. Poses that agree with each other alone
replace only a start that no pose has confirmed: two of them are enough, and until one agrees with it the estimate is
without protection.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.core.messages import MAX_THRUSTERS, POSITION_ONLY
from hil.gnc.estimation import body_frame, joint_filter, plane, pose_model, sensor_fusion, target_motion, thrust_model
from hil.gnc.estimation.akf import AKF_PARAMS
from hil.gnc.estimation.body_frame import AXES_STEP
from hil.gnc.estimation.error_state import DRIFT, ERROR_STATE, FILTERS, INNOVATION, NOISE_FACTOR, ROTATION, R, V
from hil.gnc.estimation.pkf import PKF_PARAMS
from hil.gnc.estimation.plane import OFF_PLANE
from hil.gnc.estimation.sensor_fusion import SENSOR_FUSION_PARAMS, SENSOR_FUSION_STATE
from hil.gnc.estimation.sensor_monitor import mean_interval
from hil.gnc.estimation.step_memory import (
    DOUBTS,
    POSES_PER_STEP,
    keep_predicted,
    return_to,
    sensor_step_at,
    step_at,
)
from hil.gnc.estimation.target_orbit import TARGET_ORBIT, move_hill_frame
from hil.gnc.estimation.thrust_model import JUMP_NIS, JUMP_WINDOWS, QUIET, THRUST_PARAMS, THRUST_STATE
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill
from hil.maths.limits import to_integer
from hil.maths.record_view import copy_record
from hil.sensors.vision_unit import pose as vmu_pose

NOT_GATED, REJECTED, ATTITUDE_ONLY, ACCEPTED, REOPENED, RESTARTED = range(6)
"""What the gate made of a pose. ATTITUDE_ONLY: its position was rejected; nothing is left of one without attitude."""

FUSION_PARAMS = np.dtype(
    [
        ("memory", "i8"),  # steps that are kept
        ("ring", "i8"),  # the same rounded up to a power of two, less 1: of the addresses
        ("noise_scale", "f8"),  # of the standard deviations that poses report
        ("ahead", "i8"),  # steps that an exposure may be in the future: stamps and cycles are rounded
        ("held", "i8"),  # axis of H along which a planar chaser is held: 1 x, 2 y, 3 z; 0: none
        ("orbit", TARGET_ORBIT),
        ("close_after", "i8"),  # consecutive rejections
        ("reopen_after", "i8"),  # consecutive poses that agree
        ("akf", AKF_PARAMS),
        ("pkf", PKF_PARAMS),
        ("errors", ERROR_STATE),
        ("thrust", THRUST_PARAMS),
        ("sensors", SENSOR_FUSION_PARAMS),
    ],
    align=True,
)

FUSION_STATE = np.dtype(
    [
        ("started", "i8"),
        ("unconfirmed", "i8"),  # 1: by a first pose with which no other agrees yet
        ("cycle", "i8"),  # number of the step under way, or of the next one between two; ``navigate`` counts
        ("commanded", "i8", MAX_THRUSTERS),  # thrusters, 0 or 1, since the last call
        ("thrust", THRUST_STATE),
        ("start_cycle", "i8"),
        ("predicted", "i8"),  # number of the last step over which the filters were carried
        ("filters", FILTERS),
        ("accepted", "i8"),
        ("rejected_position", "i8"),  # by the gate on the innovation
        ("rejected_attitude", "i8"),
        ("duplicates", "i8"),
        ("too_late", "i8"),  # or one too many for a step: not placed
        ("from_future", "i8"),  # the same, by a clock that is ahead
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
        ("corrected", "f8", 3),  # m/s, by which poses have corrected the velocity, forgotten as ``thrust.spread``
        ("interval_s", "f8"),  # between the last two accepted poses
        ("doubts", DOUBTS),  # for the next step
        ("noise", NOISE_FACTOR),
        ("found_attitude", INNOVATION),
        ("found_position", INNOVATION),  # also of the accelerometer and of other sensors, one after the other
        ("axes", AXES_STEP),  # of a target that tumbles
        ("sensors", SENSOR_FUSION_STATE),
        ("off_plane", OFF_PLANE),
    ],
    align=True,
)

_ALONE = 4  # times ``reopen_after``: consecutive poses that reopen the gate without a sound IMU
_DIVERGED_S = 5.0
_SPEED_MAX, _RATE_MAX = 0.2, 0.05  # m/s, rad/s: largest motion between two poses that agree
_AGREEMENT = 5.0 * math.sqrt(2.0)  # standard deviations of a pose


@kernel
def _admit(doubts, errors, filters):
    """Widen the covariance by ``doubts`` (DOUBTS): the next measurements may correct the estimate by that much.

    ``velocity`` is one error along a known direction, the others are independent of each other.
    """
    for i in range(3):
        filters.p[R + i, R + i] += doubts.position[i] ** 2
        for j in range(3):
            filters.p[V + i, V + j] += doubts.velocity[i] * doubts.velocity[j]
        filters.p[V + i, V + i] += doubts.across**2
        if errors.disturbance != 0:
            filters.p[errors.disturbance + i, errors.disturbance + i] += doubts.disturbance**2
        filters.p[DRIFT + i, DRIFT + i] += doubts.drift**2


@kernel
def _take_doubts(state, step):
    """Move the monitors' doubts to ``step`` (STEP), so that they are admitted each time it is carried over."""
    step.doubts.acts = 0
    if state.doubts.acts != 0:
        copy_record(state.doubts, step.doubts)
        fill(state.doubts.position, 0.0)
        fill(state.doubts.velocity, 0.0)
        state.doubts.acts = 0
        state.doubts.across = state.doubts.disturbance = state.doubts.drift = 0.0


@entry
def _predict(params, state, step):
    """Carry the filters over ``step`` (STEP), in the axes of a target that tumbles as well."""
    filters, axes, errors = state.filters, state.axes, params.errors
    if step.regains != 0:
        thrust_model.regain(state.thrust, filters)
    if step.doubts.acts != 0:
        _admit(step.doubts, errors, filters)
    if step.hill.rotates != 0:
        expected_drift = stack.vector(3)
        copy_into(expected_drift, params.akf.initial_drift)
        if errors.target_rate != 0:
            target_motion.move(params.orbit, errors, params.akf.dt_s, filters, step.hill)
            copy_into(expected_drift, filters.akf.x[4:7])  # none of it is an error of the rate
        body_frame.correct_motion(step.hill, filters.akf, expected_drift, params.akf.dt_s, axes)
        body_frame.enter_middle(axes, filters, errors.n, errors.target_rate)
    joint_filter.predict(params, filters, step)
    if step.hill.rotates != 0:
        body_frame.leave_middle(axes, filters, errors.n, errors.target_rate)
        if errors.target_rate != 0:
            target_motion.carry_errors(params.orbit, errors, params.akf.dt_s, filters)
    if params.held != 0:
        plane.hold(params.held, errors, filters)


@kernel
def _compare(state, pose):
    """Compare ``pose`` with the one before: count it in ``state.mutual`` if both agree, otherwise count from 0."""
    r, rotation = stack.vector(3), stack.vector(3)
    vmu_pose.position_in_h(pose, r)
    quat.rotation_between(pose.q_CH, state.seen_q, rotation)
    (sigma, sigma_angle), elapsed_s = vmu_pose.largest_sigmas(pose), abs(pose.t_s - state.seen_s)
    agree = True
    for i in range(3):
        agree = agree and abs(r[i] - state.seen_r[i]) <= _AGREEMENT * sigma + _SPEED_MAX * elapsed_s
        agree = agree and abs(rotation[i]) <= _AGREEMENT * sigma_angle + _RATE_MAX * elapsed_s
    state.mutual = state.mutual + 1 if agree else 0
    copy_into(state.seen_r, r)
    copy_into(state.seen_q, pose.q_CH)
    state.seen_s = pose.t_s


@kernel
def _add_jump(params, state, z, delta_s):
    """Widen the covariance by how far the filter's position is from ``z`` (3,), in c: it may be wrong by that much.

    Without a sound IMU the velocity may be as well, by what leads there in ``_DIVERGED_S``.
    """
    filters, position = state.filters, stack.vector(3)
    quat.transform_back_into(filters.akf.x[0:4], z, position)
    for i in range(3):
        jump = -position[i] - filters.pkf.x[i] - delta_s * filters.pkf.x[3 + i]
        filters.p[R + i, R + i] += jump * jump
        if state.thrust.without_imu == 1:
            filters.p[V + i, V + i] += (jump / _DIVERGED_S) ** 2
        state.jump_m[i] = max(state.jump_m[i], abs(jump))
    if params.held != 0:
        plane.hold(params.held, params.errors, filters)


@kernel
def _closed_gate(params, state, passes):
    """Return the result of the closed gate for a pose that agrees with the IMU's carry-over if ``passes``."""
    state.agreeing = state.agreeing + 1 if passes and state.mutual > 0 else 0
    if state.agreeing >= params.reopen_after:
        return REOPENED
    # an accused IMU is no witness against poses that agree with each other for longer
    if state.thrust.without_imu == 1 and min(state.mutual, state.rejected_in_a_row) >= _ALONE * params.reopen_after:
        return REOPENED
    if state.accepted == 0 and state.mutual >= params.reopen_after:
        return RESTARTED
    return REJECTED


@kernel
def _remember_position(state):
    """Keep what the monitors need of an accepted position: its innovations, their noise and the gains."""
    position = state.found_position
    state.noise_m = state.gain_position = state.gain_velocity = 0.0
    for i in range(3):
        of_position = math.sqrt(position.s[i, i])
        state.innovation[i], state.innovation[3 + i] = position.value[i] / of_position, 0.0
        state.noise_m = max(state.noise_m, of_position)
        state.gain_position = max(state.gain_position, _gain(position, R + i))
        state.gain_velocity = max(state.gain_velocity, _gain(position, V + i))
        for k in range(3):
            state.corrected[i] += position.gain[k, V + i] * position.value[k]
    state.updated = 1


@kernel
def _remember_attitude(state):
    """Keep the same of an accepted attitude."""
    attitude = state.found_attitude
    state.noise_rad = state.gain_attitude = 0.0
    for i in range(3):
        of_attitude = math.sqrt(attitude.s[i, i])
        state.innovation[3 + i] = attitude.value[i] / of_attitude
        state.noise_rad = max(state.noise_rad, of_attitude)
        state.gain_attitude = max(state.gain_attitude, _gain_of_noise(attitude, ROTATION + i))


@kernel
def _gain(innovation, i):
    """Return the length of row ``i`` of the gain of ``innovation`` (INNOVATION)."""
    return math.sqrt(innovation.gain[0, i] ** 2 + innovation.gain[1, i] ** 2 + innovation.gain[2, i] ** 2)


@kernel
def _gain_of_noise(innovation, i):
    """Return by how much innovations of one sigma each move component ``i``, over the largest of these sigmas.

    The roll about the line of sight is measured several times better than the tilt, and its gain is as much larger: the
    largest gain and the largest noise are of different axes.
    """
    largest, total = max(innovation.s[0, 0], innovation.s[1, 1], innovation.s[2, 2]), 0.0
    for k in range(3):
        total += innovation.gain[k, i] ** 2 * innovation.s[k, k]
    return math.sqrt(total / largest)


@entry
def _fuse_pose(params, state, pose, moment_s, gated):
    """Fuse one pose whose step is at ``moment_s``; return the part that was accepted.

    gated: NOT_GATED for a new pose, which is then gated and counted; otherwise the earlier result of the gate.
    """
    filters, errors = state.filters, params.errors
    position, attitude = state.found_position, state.found_attitude
    if gated == RESTARTED:
        pose_model.start(params, pose, state.noise, filters)
        return RESTARTED
    delta_s = pose.t_s - moment_s
    rotation, z, back, q_measured = stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        rotation[i] = -delta_s * filters.akf.w_CH_C[i]
    # c at the filter's moment, from c at the exposure
    quat.from_rotation_vector_into(rotation, back)
    quat.multiply_into(back, pose.q_CH, q_measured)
    quat.transform_into(back, pose.z_TC_C, z)
    nis_a = nis_p = np.nan
    is_whole = pose.status != POSITION_ONLY
    if is_whole:
        nis_a = pose_model.innovate_attitude(
            errors, filters, state.noise, q_measured, pose.covariance_attitude, attitude
        )
    result = gated
    if gated == NOT_GATED:
        # the first pose, by two that agree
        contradicted = is_whole and state.unconfirmed != 0 and state.mutual > 0 and state.rejected_in_a_row > 0
        result = ATTITUDE_ONLY if not is_whole or 0.0 <= nis_a <= params.akf.gate else REJECTED
        if state.rejected_in_a_row >= params.close_after and not is_whole:
            result = REJECTED
        elif state.rejected_in_a_row >= params.close_after or contradicted:
            nis_p = pose_model.innovate_position(
                errors, filters, state.noise, z, pose.covariance_position, delta_s, position
            )
            passes = result == ATTITUDE_ONLY and 0.0 <= nis_p <= params.pkf.gate
            if not contradicted:
                result = _closed_gate(params, state, passes)
            elif nis_a >= 0.0 and nis_p >= 0.0 and not passes:
                result = RESTARTED
        if result == RESTARTED:
            pose_model.start(params, pose, state.noise, filters)
            _count(params, state, pose, result, nis_a, nis_p)
            return result
    if result == REOPENED:
        _add_jump(params, state, z, delta_s)
    if result >= ATTITUDE_ONLY:
        if is_whole:
            joint_filter.update(errors, filters, attitude)
        nis_p = pose_model.innovate_position(
            errors, filters, state.noise, z, pose.covariance_position, delta_s, position
        )
        if gated == NOT_GATED and result == ATTITUDE_ONLY and 0.0 <= nis_p <= params.pkf.gate:
            result = ACCEPTED
        if result >= ACCEPTED:
            joint_filter.update(errors, filters, position)
            if gated == NOT_GATED:
                _remember_position(state)
                pose_model.adapt(errors, state.noise, 0, position)
                if is_whole:
                    _remember_attitude(state)
                    pose_model.adapt(errors, state.noise, 1, attitude)
    if gated == NOT_GATED:
        _count(params, state, pose, result, nis_a, nis_p)
    return result


@kernel
def _count(params, state, pose, result, nis_attitude, nis_position):
    """Count a pose that has just been gated."""
    state.nis_attitude = nis_attitude
    state.nis_position = nis_position
    if result == REJECTED:
        if state.rejected_in_a_row < params.close_after:  # beyond, by the closed gate
            state.rejected_attitude += 1
    elif result == ATTITUDE_ONLY:
        state.rejected_position += 1
    else:
        state.accepted += 1
        state.agreeing = state.unconfirmed = 0
        if pose.t_s > state.last_accepted_s:
            state.interval_s = mean_interval(state.interval_s, pose.t_s - state.last_accepted_s)
            state.last_accepted_s = pose.t_s
    state.rejected_in_a_row = 0 if result >= ACCEPTED else state.rejected_in_a_row + 1
    if params.held != 0 and result < ACCEPTED:
        plane.note_contradiction(params, state, pose)


@kernel
def _place(params, state, memory, pose):
    """Put a pose into the step nearest to its exposure; return that step's number, or -1 if there is none."""
    if state.started == 0 and pose.status == POSITION_ONLY:
        return -1
    cycle = to_integer(math.floor(pose.t_s / params.pkf.dt_s + 0.5))
    if cycle > state.cycle + params.ahead:  # the unit's clock runs ahead: the moment of exposure is unknown
        state.from_future += 1
        return -1
    cycle = min(cycle, state.cycle)
    oldest = max(0, state.cycle - params.memory + 1)
    if state.started != 0:
        oldest = max(oldest, state.start_cycle)
    if cycle < oldest:
        state.too_late += 1
        return -1
    step = step_at(params, memory, cycle)
    held = step.n_poses
    for k in range(held):
        if abs(step.poses[k].t_s - pose.t_s) < 1e-6:
            state.duplicates += 1
            return -1
    if held >= POSES_PER_STEP:
        state.too_late += 1
        return -1
    vmu_pose.copy_pose(pose, params.noise_scale**2, step.poses[held])
    step.gated[held] = NOT_GATED
    step.n_poses += 1
    if state.started == 0:
        step.is_start = 1
        state.started = state.unconfirmed = 1
        state.start_cycle = cycle
        state.predicted = state.cycle
        state.last_accepted_s = pose.t_s
        pose_model.start(params, step.poses[held], state.noise, state.filters)
        keep_predicted(params, state.filters, memory, cycle)
    return cycle


@kernel
def _quiet_mean(params, state, memory, cycle, steps, mean):
    """Write the mean (3,) of the quiet readings of the last ``steps`` steps up to ``cycle``; return their number."""
    count = 0
    fill(mean, 0.0)
    oldest = max(state.start_cycle + 1, state.cycle - params.memory + 1)
    for k in range(max(oldest, cycle - steps + 1), cycle + 1):
        step = step_at(params, memory, k)
        if step.kind == QUIET:
            count += 1
            for i in range(3):
                mean[i] += step.force_C[i]
    for i in range(3):
        mean[i] /= max(1, count)
    return count


@kernel
def _fuse_bias(params, state, memory, cycle):
    """Fuse the accelerometer's quiet readings of the window that ends with step ``cycle``, if one does.

    If those of ``JUMP_WINDOWS`` agree neither with bias nor disturbance, both may have changed.
    """
    window = params.thrust.window
    if params.thrust.enabled == 0 or cycle % window != 0:
        return
    mean, innovation, errors, filters = stack.vector(3), state.found_position, params.errors, state.filters
    count = _quiet_mean(params, state, memory, cycle, JUMP_WINDOWS * window, mean)
    if count > window:
        thrust_model.bias_innovation(params.pkf, errors, filters, mean, count, innovation)
        if joint_filter.innovate(errors, filters, R, 9, innovation) > JUMP_NIS:
            thrust_model.admit_jump(errors, filters, innovation)
            state.thrust.jumped = cycle
    count = _quiet_mean(params, state, memory, cycle, window, mean)
    if count > 0:
        thrust_model.bias_innovation(params.pkf, errors, filters, mean, count, innovation)
        joint_filter.innovate(errors, filters, R, 9, innovation)
        joint_filter.update(errors, filters, innovation)


@kernel
def _fuse_step(params, state, memory, step, cycle):
    """Fuse what step number ``cycle`` has measured: quiet readings of the accelerometer, poses, then other sensors."""
    _fuse_bias(params, state, memory, cycle)
    moment_s = cycle * params.pkf.dt_s
    for k in range(step.is_start, step.n_poses):  # the pose that started the filters is in them
        step.gated[k] = _fuse_pose(params, state, step.poses[k], moment_s, step.gated[k])
    if params.sensors.fused > 0:
        sensor_fusion.fuse_samples(params, state, memory, cycle)


@entry
def advance(params, state, memory, imu):
    """Begin the next step and carry the filters over it; arguments: see ``begin_step``."""
    begin_step(params, state, memory, imu)
    predict_step(params, state, memory)


@kernel
def begin_step(params, state, memory, imu):
    """Keep the IMU's sample of the next step, over which ``fuse`` or ``predict_step`` carries the filters.

    memory: of ``step_memory.new_memory``. The very first step has no sample before it.
    """
    step = step_at(params, memory, state.cycle)
    copy_into(step.rate_C, imu.rate_C)
    copy_into(step.force_C, imu.force_C)
    _take_doubts(state, step)
    thrust_model.begin(params, state, state.started != 0, state.commanded, step)
    thrust_model.count_spread(params.thrust, params.pkf, state.thrust, state.filters.pkf.x[6:9], step)
    for i in range(3):
        state.corrected[i] *= 1.0 - params.pkf.dt_s / thrust_model.MEMORY_S
    move_hill_frame(params.orbit, (state.cycle - 1) * params.pkf.dt_s, params.pkf.dt_s, step.hill)
    step.n_poses = 0
    if params.sensors.fused > 0:
        sensor_step_at(params, memory, state.cycle).n = 0
    step.is_start = 0
    state.nis_position = np.nan
    state.nis_attitude = np.nan


@kernel
def predict_step(params, state, memory):
    """Carry the filters over the present step, unless ``fuse`` has done so on its way back from the past."""
    if state.started != 0 and state.predicted < state.cycle:
        _predict(params, state, step_at(params, memory, state.cycle))
        keep_predicted(params, state.filters, memory, state.cycle)
        _fuse_bias(params, state, memory, state.cycle)
        state.predicted = state.cycle


@entry
def fuse(params, state, memory, pose):
    """Fuse a pose (POSE) at its own time: back to its step, and forward again."""
    state.updated = 0
    first = _place(params, state, memory, pose)
    if first < 0:
        return
    if pose.status != POSITION_ONLY:
        _compare(state, pose)
    _fuse_again(params, state, memory, first)


@entry
def fuse_sensors(params, state, memory):
    """Fuse the samples of the sensors that came in this cycle at their own times, once over all of them."""
    first = sensor_fusion.place_samples(params, state, memory)
    if first >= 0:
        _fuse_again(params, state, memory, first)


@kernel
def _fuse_again(params, state, memory, first):
    """Return to step number ``first`` and fuse what it and all later ones have measured."""
    if first == state.cycle:
        predict_step(params, state, memory)
    return_to(params, state.filters, memory, first)
    for cycle in range(first, state.cycle + 1):
        step = step_at(params, memory, cycle)
        if cycle > first:
            _predict(params, state, step)
            keep_predicted(params, state.filters, memory, cycle)
        _fuse_step(params, state, memory, step, cycle)
    state.predicted = state.cycle


@entry
def replace_imu(params, state, memory, steps):
    """Replace the IMU from the last ``steps`` steps on by what the commands give, and carry the filters over them.

    state.cycle: number of the next step.
    """
    last = state.cycle - 1
    if state.started == 0:
        thrust_model.lose(state.thrust, state.filters)
        return
    first = max(state.start_cycle, last - params.memory + 1, last - steps)
    return_to(params, state.filters, memory, first)
    thrust_model.lose(state.thrust, state.filters)
    copy_into(state.thrust.rate_C, step_at(params, memory, first).rate_C)
    for cycle in range(first, last + 1):
        step = step_at(params, memory, cycle)
        if cycle > first:
            thrust_model.replace(params.thrust, state.thrust, step)
            _predict(params, state, step)
            keep_predicted(params, state.filters, memory, cycle)
        _fuse_step(params, state, memory, step, cycle)
