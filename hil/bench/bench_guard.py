"""Bench guard: checks in each cycle of a run that hold for any GNC.

The chaser's keep-out, the distance of its bodies from the target's, the bench against the truth,
setpoints that are limited, each axis against the demand through a model of its drive, and the vision unit's poses
against the encoders. Two calls per cycle: ``check_bench`` after the encoders were read, ``compare_pose`` for each pose
that has arrived. A pose that deviates is reported by ``check_bench`` of the next cycle.
"""

from __future__ import annotations

import math

import numpy as np

from hil.bench.guard import bodies_meet
from hil.bench.keep_out import BREACH, KEEP_OUT_ZONE, NOTHING, check_keep_out
from hil.bench.kinematics import enlargement, pose_of_axes
from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into
from hil.models.bodies import BODIES, are_apart, chord, travel_to_rest
from hil.sensors.vision_unit.pose import deviation

POSITION, ATTITUDE, LIMITED, AXIS, VISION_POSITION, VISION_ATTITUDE, BODIES_MEET = range(9, 16)
"""What was found, in addition to ``keep_out``; the numbers follow the compiled loop's other reasons to end."""

_KEPT = 64  # samples of the encoders, for the times of exposure
_SLOW_S, _FAST_S = 10.0, 0.4  # time constants of the means of estimate minus encoders: of a filter, of an alarm
_ESTIMATE_SIGMAS = 3.0  # standard deviations by which the estimate may be off in addition
_LEVEL_FRACTION = 0.9  # fraction of a protection level: an alarm comes before the error is beyond it
_HYSTERESIS = 0.8  # fraction of a limit, below which an estimate that was beyond it is accepted again

BENCH_GUARD_PARAMS = np.dtype(
    [
        ("enabled", "i8"),
        ("zone", KEEP_OUT_ZONE),
        ("deceleration", "f8"),  # m/s^2, that all rails have
        ("reaction_s", "f8"),
        ("chaser", BODIES),  # in c about the chaser's reference point
        ("target", BODIES),  # in H about the target's
        ("distance", "f8"),  # m, least one between bodies of both
        ("turning_deceleration", "f8"),  # rad/s^2, that all gimbals have
        ("arm", "f8"),  # m, length of the lever arm
        ("position_max", "f8"),  # m, at rest
        ("attitude_max", "f8"),  # rad, at rest
        ("pose_per_speed_s", "f8"),
        ("pose_cycles", "i8"),
        ("limited_max", "i8"),  # setpoints in a row
        ("axis_max", "f8", 6),  # m and rad, at rest
        ("axis_per_speed_s", "f8"),
        ("axis_cycles", "i8"),
        ("axis_decay", "f8", 6),  # decay per cycle of the distance from the demand
        ("step_s", "f8"),
        ("vision_sigmas", "f8"),
        ("vision_position", "f8"),  # m
        ("vision_attitude", "f8"),  # rad
        ("vision_frames", "i8"),
        ("startup_s", "f8"),
        ("settled_cycles", "i8"),  # after which the axes count as having caught up
        ("spacing_s", "f8"),  # spacing of the kept samples
        ("estimate_position", "f8"),  # m, largest mean error of an estimate ...
        ("estimate_attitude", "f8"),  # rad
        ("calibration_position", "f8"),  # m, by which camera and axes may differ
        ("calibration_attitude", "f8"),  # rad
    ],
    align=True,
)

BENCH_GUARD_MEMORY = np.dtype(
    [
        ("cycles", "i8"),  # checked since the start of the motion
        ("begun_s", "f8"),  # time of the first one
        ("checked_s", "f8"),  # time of the last one
        ("caught_up", "i8"),  # 1: the axes have reached the demand since the start of the motion
        ("settled", "i8"),  # cycles in a row in which they were there
        ("pose_cycles", "i8"),  # in a row beyond the limit
        ("axis_cycles", "i8", 6),
        ("model", "f8", 6),  # position of each axis by the model of its drive
        ("vision_frames", "i8"),  # in a row beyond the limit
        ("vision_code", "i8"),  # VISION_POSITION or VISION_ATTITUDE
        ("vision", BREACH),  # last breach by these codes
        ("kept", "i8"),
        ("newest", "i8"),
        ("kept_s", "f8", _KEPT),
        ("kept_rail", "f8", (_KEPT, 3)),
        ("kept_gimbal", "f8", (_KEPT, 3)),
        ("compared_s", "f8"),  # for which the estimate has been compared
        ("off", "f8", 6),  # mean of estimate minus encoders over ``_SLOW_S``: position in H, m, rotation in c, rad
        ("off_now", "f8", 6),  # and over ``_FAST_S``
        ("estimate", BREACH),  # the component that was beyond its limit last
    ],
    align=True,
)
"""Zeroed at the start of a motion."""


@kernel
def _chaser_meets(params, truth, breach):
    """Return whether the bodies of the chaser, braking now, would come too near to the target's bodies."""
    rate, speed = 0.0, 0.0
    for i in range(3):
        rate += abs(truth.w_CI_C[i]) + abs(truth.w_HI_H[i])
        speed += abs(truth.v_CT_H[i])
    turned = chord(truth.q_CH) + travel_to_rest(rate, params.reaction_s, params.turning_deceleration)
    least = params.distance + travel_to_rest(speed, params.reaction_s, params.deceleration)
    if are_apart(params.chaser, truth.r_CT_H, turned, params.target, least):
        return False
    return bodies_meet(
        params.chaser, truth.r_CT_H, truth.q_CH, truth.v_CT_H, rate, params.target,
        params.distance, params.reaction_s, params.deceleration, params.turning_deceleration, breach,
    )  # fmt: skip


@kernel
def _off_truth(params, bench, truth, setpoint, feedback, rails_age_s, turntable_age_s, breach):
    """Return POSITION or ATTITUDE if the bench's pose differs too much from ``truth``, NOTHING otherwise.

    The distances of the axes bound both differences: the pose is computed only if these are not within the limits. Of a
    bench with fixed axes what counts is what the others are to show of the truth, ``setpoint``.
    """
    square, turned = 0.0, 0.0
    for i in range(3):
        difference = feedback.rail_m[i] - setpoint.rail_m[i]
        square += difference * difference
        turned += abs(feedback.gimbal_rad[i] - setpoint.gimbal_rad[i])
    bound = params.position_max - params.arm * turned
    if bound >= 0.0 and square <= bound * bound and turned <= params.attitude_max:
        return NOTHING
    r, q, rotation = stack.vector(3), stack.vector(4), stack.vector(3)
    r_CT_H, q_CH = stack.vector(3), stack.vector(4)
    copy_into(r_CT_H, truth.r_CT_H)
    copy_into(q_CH, truth.q_CH)
    if bench.reduced != 0:
        pose_of_axes(bench, setpoint.rail_m, setpoint.gimbal_rad, r_CT_H, q_CH)
    pose_of_axes(bench, feedback.rail_m, feedback.gimbal_rad, r, q)
    quat.rotation_between(q, q_CH, rotation)
    square, turned, speed, rate = 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        square += (r[i] - r_CT_H[i]) ** 2
        turned += rotation[i] ** 2
        speed += truth.v_CT_H[i] ** 2
        rate += setpoint.gimbal_radps[i] ** 2
    distance, allowed = math.sqrt(square), params.position_max
    allowed += (params.pose_per_speed_s + rails_age_s) * math.sqrt(speed)
    angle, angle_allowed = math.sqrt(turned), params.attitude_max
    angle_allowed += (params.pose_per_speed_s + turntable_age_s) * math.sqrt(rate)
    breach.axis, breach.low = 0, 0.0
    # "not <=" also catches nan
    if not distance <= allowed:
        breach.value, breach.high = distance, allowed
        return POSITION
    if not angle <= angle_allowed:
        breach.value, breach.high = angle, angle_allowed
        return ATTITUDE
    return NOTHING


@kernel
def _predict(params, memory, setpoint, model):
    """Write the positions (6,) that the axes should have by the model of their drives.

    A position loop of gain k with feed-forward, dm/dt = dw/dt + k (w - m): the distance from the demand w decays, in a
    cycle of h to 1 / (1 + k h).
    """
    for axis in range(6):
        i = axis % 3
        demand = setpoint.rail_m[i] if axis < 3 else setpoint.gimbal_rad[i]
        rate = setpoint.rail_mps[i] if axis < 3 else setpoint.gimbal_radps[i]
        previous = demand - params.step_s * rate
        model[axis] = demand + (memory.model[axis] - previous) * params.axis_decay[axis]


@kernel
def _is_off_model(params, axis, model, setpoint, feedback, age_s, breach):
    """Return whether ``axis`` is too far from where its drive should have it."""
    i = axis % 3
    if axis < 3:
        measured, rate = feedback.rail_m[i], setpoint.rail_mps[i]
    else:
        measured, rate = feedback.gimbal_rad[i], setpoint.gimbal_radps[i]
    error = abs(measured - model)
    allowed = params.axis_max[axis] + (params.axis_per_speed_s + age_s) * abs(rate)
    if error <= allowed:
        return False
    breach.axis, breach.value, breach.low, breach.high = axis, error, 0.0, allowed
    return True


@kernel
def _keep(params, memory, t_s, feedback):
    """Keep the encoders' values of ``t_s``; samples are ``spacing_s`` apart, but for the newest."""
    newest = memory.newest
    if memory.kept < 2 or memory.kept_s[newest] - memory.kept_s[(newest - 1) % _KEPT] >= params.spacing_s:
        memory.newest = (memory.newest + 1) % _KEPT
        memory.kept = min(memory.kept + 1, _KEPT)
    memory.kept_s[memory.newest] = t_s
    for i in range(3):
        memory.kept_rail[memory.newest, i] = feedback.rail_m[i]
        memory.kept_gimbal[memory.newest, i] = feedback.gimbal_rad[i]


@kernel
def check_bench(
    params, bench, memory, t_s, truth, setpoint, feedback, rails_age_s, turntable_age_s, limited, breach
):  # fmt: skip
    """Return what is wrong in the cycle at ``t_s``, NOTHING if all is well; ``breach`` (BREACH) then has the numbers.

    bench: BENCH_PARAMS. memory: BENCH_GUARD_MEMORY, unchanged if something is wrong. truth: TRUTH at ``t_s``. wanted:
    AXES of it, without limits; of no use in the first cycle of a motion. feedback: AXES; rails_age_s, turntable_age_s:
    its age. limited: setpoints in a row, the last one included, that were limited.
    """
    cause = check_keep_out(params.zone, truth.r_CT_H, truth.v_CT_H, 0.0, params.reaction_s, params.deceleration, breach)
    if cause != NOTHING:
        return cause
    if _chaser_meets(params, truth, breach):
        return BODIES_MEET
    if memory.cycles > 0 and memory.checked_s == t_s:
        return NOTHING
    if memory.vision_frames >= params.vision_frames:
        vision = memory.vision
        breach.axis, breach.value, breach.low, breach.high = vision.axis, vision.value, vision.low, vision.high
        return memory.vision_code
    model, off = stack.vector(6), stack.vector(6)
    if memory.cycles == 0:
        memory.begun_s = t_s
    else:
        off_truth = _off_truth(params, bench, truth, setpoint, feedback, rails_age_s, turntable_age_s, breach)
        if memory.caught_up != 0 and off_truth != NOTHING and memory.pose_cycles + 1 >= params.pose_cycles:
            return off_truth
        if memory.caught_up != 0 and limited > params.limited_max:
            breach.axis, breach.value, breach.low, breach.high = 0, limited, 0.0, params.limited_max
            return LIMITED
        _predict(params, memory, setpoint, model)
        behind = off_truth != NOTHING or limited > 0
        for axis in range(6):
            age_s = rails_age_s if axis < 3 else turntable_age_s
            off[axis] = 1.0 if _is_off_model(params, axis, model[axis], setpoint, feedback, age_s, breach) else 0.0
            behind = behind or off[axis] > 0.0
            if memory.caught_up != 0 and off[axis] > 0.0 and memory.axis_cycles[axis] + 1 >= params.axis_cycles:
                return AXIS
        # nothing is wrong: what follows changes the memory
        memory.pose_cycles = memory.pose_cycles + 1 if off_truth != NOTHING else 0
        for axis in range(6):
            memory.axis_cycles[axis] = memory.axis_cycles[axis] + 1 if off[axis] > 0.0 else 0
        memory.settled = 0 if behind else memory.settled + 1
        if memory.settled >= params.settled_cycles or t_s - memory.begun_s >= params.startup_s:
            memory.caught_up = 1
    if memory.caught_up != 0:
        copy_into(memory.model, model)
    else:
        memory.pose_cycles = 0
        for axis in range(6):
            memory.model[axis] = feedback.rail_m[axis] if axis < 3 else feedback.gimbal_rad[axis - 3]
            memory.axis_cycles[axis] = 0
    _keep(params, memory, t_s, feedback)
    memory.checked_s = t_s
    memory.cycles += 1
    return NOTHING


@kernel
def _pose_at(bench, memory, t_s, r_CT_H, q_CH):
    """Write the bench's pose at ``t_s`` by its encoders, between two samples; return False if it is not kept."""
    rail, gimbal = stack.vector(3), stack.vector(3)
    for back in range(memory.kept):
        k = (memory.newest - back) % _KEPT
        if memory.kept_s[k] > t_s:
            continue
        after = (k + 1) % _KEPT if back > 0 else k
        span = memory.kept_s[after] - memory.kept_s[k]
        share = (t_s - memory.kept_s[k]) / span if span > 0.0 else 0.0
        for i in range(3):
            rail[i] = memory.kept_rail[k, i] + share * (memory.kept_rail[after, i] - memory.kept_rail[k, i])
            gimbal[i] = memory.kept_gimbal[k, i] + share * (memory.kept_gimbal[after, i] - memory.kept_gimbal[k, i])
        pose_of_axes(bench, rail, gimbal, r_CT_H, q_CH)
        return True
    return False


@kernel
def _is_beyond(breach, axis, error, variance, sigmas, calibration):
    """Return whether ``error`` exceeds ``calibration`` and ``sigmas`` standard deviations, with ``breach``."""
    allowed = calibration + sigmas * math.sqrt(max(0.0, variance))
    # "not <=" also catches nan
    if error <= allowed and variance >= 0.0:
        return False
    breach.axis, breach.value, breach.low, breach.high = axis, error, 0.0, allowed
    return True


@kernel
def compare_pose(params, bench, memory, pose):
    """Compare ``pose`` (POSE) with the encoders at its exposure; poses that are older than they are kept do not count.

    bench: BENCH_PARAMS. memory: BENCH_GUARD_MEMORY.
    """
    r, q, off, variance = stack.vector(3), stack.vector(4), stack.vector(6), stack.vector(6)
    if not _pose_at(bench, memory, pose.t_s, r, q):
        return
    deviation(pose, r, q, off, variance)
    for i in range(6):
        calibration = params.vision_position if i < 3 else params.vision_attitude
        if _is_beyond(memory.vision, i % 3, abs(off[i]), variance[i], params.vision_sigmas, calibration):
            memory.vision_code = VISION_POSITION if i < 3 else VISION_ATTITUDE
            memory.vision_frames += 1
            return
    memory.vision_frames = 0


@kernel
def compare_estimate(params, bench, memory, t_s, estimate, disagrees):
    """Compare ``estimate`` (NAVIGATION) of ``t_s`` with the encoders; return whether it is off by more than it may be.

    Its mean error may be ``estimate_position`` and ``_ESTIMATE_SIGMAS`` standard deviations, but not more than the
    protection level that it reports, and what the calibration leaves; where the bench is scaled, enlarged by as much.
    disagrees: the result of the cycle before.
    ``memory.estimate`` has the component that is farthest beyond its limit.
    """
    if estimate.valid == 0:
        memory.compared_s = 0.0
        return False
    r, q, rotation = stack.vector(3), stack.vector(4), stack.vector(3)
    if not _pose_at(bench, memory, t_s, r, q):
        return disagrees
    quat.rotation_between(estimate.q_CH, q, rotation)
    slow = params.step_s / max(params.step_s, min(_SLOW_S, memory.compared_s))
    fast = params.step_s / max(params.step_s, min(_FAST_S, memory.compared_s))
    memory.compared_s += params.step_s
    worst, beyond, enlarged = 0.0, False, enlargement(bench, r)
    for i in range(6):
        k = i % 3
        off = estimate.r_CT_H[k] - r[k] if i < 3 else rotation[k]
        memory.off[i] += slow * (off - memory.off[i])
        memory.off_now[i] += fast * (off - memory.off_now[i])
        sigma = estimate.sigma_r_m[k] if i < 3 else estimate.sigma_attitude_rad[k]
        level = estimate.protection_level_m[k] if i < 3 else estimate.protection_level_rad
        allowed = enlarged * params.estimate_position if i < 3 else params.estimate_attitude
        if sigma > 0.0:  # nan: it reports none
            allowed += _ESTIMATE_SIGMAS * sigma
        allowed += enlarged * params.calibration_position if i < 3 else params.calibration_attitude
        if level > 0.0:
            allowed = min(allowed, _LEVEL_FRACTION * level)
        share = abs(memory.off_now[i]) / allowed
        if share > worst or not math.isfinite(share):
            worst, estimated = share, memory.estimate
            estimated.axis, estimated.value, estimated.low, estimated.high = i, abs(memory.off_now[i]), 0.0, allowed
        beyond = beyond or not share <= (_HYSTERESIS if disagrees else 1.0)
    return beyond and memory.compared_s >= _FAST_S
