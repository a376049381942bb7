"""Pose of the chaser in the lab to three rail positions and three gimbal angles, and back.

The lab frame L has its origin at the target's reference point, and is parallel to H unless the rig file rotates it.
The rails carry the turntable's rotation centre; the point that plays the chaser's reference point sits ``lever_arm``
(in c) away from it, so the carriage goes to ``r_CT_L - R_LC lever_arm``. A bench may have fewer than six axes that
move: those that are fixed stand where they are, and the others show of a pose what is left (``unseen``).
"""

from __future__ import annotations

import math

import numpy as np

from hil.bench.geometry import GEOMETRY, compensate, machine_pose, to_rails
from hil.core.jit import kernel
from hil.core.messages import AXES
from hil.maths import euler, quat, stack
from hil.maths.arrays import copy_into, cross_into, fill
from hil.maths.record_view import copy_record

_BLEND_M = 1.0  # over which the bench goes from full scale to its scale
SETPOINTS_KEPT = 512
"""Setpoints of an axis that a limit of its jerk can average."""

BENCH_PARAMS = np.dtype(
    [
        ("dt_s", "f8"),
        ("lever_arm", "f8", 3),  # m, in c
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("low", "f8", 6),  # rails x y z in m, gimbals roll pitch yaw in rad
        ("high", "f8", 6),
        ("rate_max", "f8", 6),
        ("acceleration_max", "f8", 6),
        ("lead", "f8", 6),  # s, by which each axis is commanded ahead of its time
        ("averaged", "i8", 6),  # setpoints whose mean is sent, which limits the jerk; below 2: off
        ("scaled_beyond", "f8"),  # m, distance beyond which the bench is scaled; 0: nowhere
        ("scale", "f8"),  # part of the additional distance that it moves
        ("reduced", "i8"),  # 1: axes are fixed, or L is not parallel to H
        ("fixed", "i8", 6),  # 1: the axis is fixed at ``low``
        ("q_HL", "f8", 4),  # L to H
        ("geometry", GEOMETRY),  # errors of the machine, whose lever arm is that above
    ],
    align=True,
)

MOTION = np.dtype(
    [
        ("position", "f8", 6),  # rails, then gimbals
        ("rate", "f8", 6),  # rate of the last step
        ("wanted_rate", "f8", 6),  # rate of the last target, without its lead
        ("newest", "i8"),  # place in the two arrays below
        ("kept_position", "f8", (6, SETPOINTS_KEPT)),  # last setpoints, before their mean is taken
        ("kept_rate", "f8", (6, SETPOINTS_KEPT)),
    ],
    align=True,
)
"""Last setpoints within travel, speed and acceleration."""

SPAN = np.dtype([("known", "i8"), ("begin", AXES), ("end", AXES)], align=True)
"""Axes at begin and end of a cycle, without limits. known: 1 if ``end`` belongs to the present motion."""


@kernel
def is_scaled(params, square):
    """Return whether the bench is scaled at a distance whose ``square`` is given, m^2."""
    return params.scaled_beyond > 0.0 and square > params.scaled_beyond**2


@kernel
def shown_distance(params, distance, out):
    """Write the distance at which the bench shows ``distance``, m, and its derivative, into ``out`` (2,).

    The derivative falls from 1 to the scale over the first metre: ``x - (1 - s) x^2 / (2 w)`` for x up to w.
    """
    x, lost = distance - params.scaled_beyond, 1.0 - params.scale
    if x <= 0.0:
        out[0], out[1] = distance, 1.0
    elif x < _BLEND_M:
        out[0], out[1] = distance - lost * x * x / (2.0 * _BLEND_M), 1.0 - lost * x / _BLEND_M
    else:
        out[0], out[1] = distance - lost * (x - 0.5 * _BLEND_M), params.scale


@kernel
def enlargement(params, r_CT_H):
    """Return how many times larger a position (3,), m, is than the bench shows it."""
    square, out = 0.0, stack.vector(2)
    for i in range(3):
        square += r_CT_H[i] ** 2
    if not is_scaled(params, square):
        return 1.0
    distance = math.sqrt(square)
    shown_distance(params, distance, out)
    return distance / out[0]


@kernel
def true_distance(params, shown):
    """Return the distance, m, that the bench shows at the distance ``shown``, m."""
    y, lost = shown - params.scaled_beyond, 1.0 - params.scale
    if y <= 0.0 or lost == 0.0:
        return shown
    if y < _BLEND_M * (1.0 - 0.5 * lost):
        return params.scaled_beyond + _BLEND_M / lost * (1.0 - math.sqrt(1.0 - 2.0 * lost * y / _BLEND_M))
    return params.scaled_beyond + (y - 0.5 * lost * _BLEND_M) / params.scale


@kernel
def show(params, r_CT_H, v_CT_H, r, v):
    """Write position and velocity (3,) at which the bench shows those of the chaser: on the same line of sight."""
    square, product, out = 0.0, 0.0, stack.vector(2)
    for i in range(3):
        square += r_CT_H[i] ** 2
        product += r_CT_H[i] * v_CT_H[i]
    copy_into(r, r_CT_H)
    copy_into(v, v_CT_H)
    if not is_scaled(params, square):
        return
    distance = math.sqrt(square)
    shown_distance(params, distance, out)
    part = out[0] / distance
    change = (out[1] - part) * product / square
    for i in range(3):
        r[i] = part * r_CT_H[i]
        v[i] = part * v_CT_H[i] + change * r_CT_H[i]


@kernel
def _body_rate(order, a, rates, w):
    """Write the body rate ``w`` (3,), rad/s, at rates (3,) of the gimbals, whose attitude is ``a`` (3, 3).

    Sum of the gimbals' axes in c: outer, middle, inner (``euler.rate_jacobian_of_matrix_into``).
    """
    i, j, k = order[0], order[1], order[2]
    cosine = math.sqrt(a[i, i] * a[i, i] + a[j, i] * a[j, i])  # of the middle angle
    for n in range(3):
        w[n] = rates[i] * a[n, i]
    w[i] -= rates[j] * a[j, i] / cosine
    w[j] += rates[j] * a[i, i] / cosine
    w[k] += rates[k]


@kernel
def _driven_axes(params, r, v, q_CH, w_CH_C, axes):
    """Write ``axes`` (AXES) for a pose and motion that the bench shows, m, m/s, rad/s: fixed axes stand.

    The driven gimbals have their Tait-Bryan angles of the whole attitude; the rails carry the reference point.
    """
    q, angles, rates, w = stack.vector(4), stack.vector(3), stack.vector(3), stack.vector(3)
    a, jacobian, arm, arm_rate = stack.matrix(3, 3), stack.matrix(3, 3), stack.vector(3), stack.vector(3)
    quat.multiply_into(q_CH, params.q_HL, q)
    quat.transform_back_into(params.q_HL, r, r)
    quat.transform_back_into(params.q_HL, v, v)
    if params.geometry.enabled != 0:
        to_rails(params.geometry, r, v, q)
    quat.to_matrix_into(q, a)
    euler.from_matrix_into(a, params.order, angles)
    euler.rate_jacobian_of_matrix_into(a, params.order, jacobian)
    for i in range(3):
        rates[i] = jacobian[i, 0] * w_CH_C[0] + jacobian[i, 1] * w_CH_C[1] + jacobian[i, 2] * w_CH_C[2]
        if params.fixed[3 + i] != 0:
            angles[i], rates[i] = params.low[3 + i], 0.0
    euler.to_quaternion_into(angles, params.order, q)
    quat.to_matrix_into(q, a)
    _body_rate(params.order, a, rates, w)
    quat.transform_back_into(q, params.lever_arm, arm)
    cross_into(w, params.lever_arm, arm_rate)
    quat.transform_back_into(q, arm_rate, arm_rate)
    for i in range(3):
        axes.rail_m[i] = params.low[i] if params.fixed[i] != 0 else r[i] - arm[i]
        axes.rail_mps[i] = 0.0 if params.fixed[i] != 0 else v[i] - arm_rate[i]
        axes.gimbal_rad[i], axes.gimbal_radps[i] = angles[i], rates[i]
    if params.geometry.enabled != 0:
        _compensate_driven(params, r, q, axes)


@kernel
def _compensate_driven(params, r, q, axes):
    """Correct the positions of the driven axes for errors of the machine; rails also for what fixed gimbals leave."""
    shown, rest, attitude, jacobian = stack.vector(3), stack.vector(3), stack.vector(4), stack.matrix(3, 3)
    copy_into(rest, axes.rail_m)
    compensate(params.geometry, params.order, q, rest, axes.rail_m, axes.gimbal_rad, jacobian)
    for i in range(3):
        if params.fixed[3 + i] != 0:
            axes.gimbal_rad[i] = params.low[3 + i]
    machine_pose(params.geometry, params.order, axes.rail_m, axes.gimbal_rad, shown, attitude)
    fill(rest, 0.0)
    to_rails(params.geometry, shown, rest, attitude)
    for i in range(3):
        axes.rail_m[i] = params.low[i] if params.fixed[i] != 0 else axes.rail_m[i] - (shown[i] - r[i])


@kernel
def axes_of_pose(params, r_CT_H, v_CT_H, q_CH, w_CH_C, axes):
    """Write ``axes`` (AXES): positions and rates that put the chaser's reference point at this pose.

    Of a pose beyond the distance from which the bench is scaled: where the bench shows it. Of a bench with fixed axes:
    what the others can show of it.
    """
    r, v = stack.vector(3), stack.vector(3)
    show(params, r_CT_H, v_CT_H, r, v)
    if params.reduced != 0:
        _driven_axes(params, r, v, q_CH, w_CH_C, axes)
        return
    arm, turning, arm_rate = stack.vector(3), stack.vector(3), stack.vector(3)
    a, jacobian, q = stack.matrix(3, 3), stack.matrix(3, 3), stack.vector(4)
    copy_into(q, q_CH)
    if params.geometry.enabled != 0:
        to_rails(params.geometry, r, v, q)
    quat.transform_back_into(q, params.lever_arm, arm)
    turning[0] = w_CH_C[1] * params.lever_arm[2] - w_CH_C[2] * params.lever_arm[1]
    turning[1] = w_CH_C[2] * params.lever_arm[0] - w_CH_C[0] * params.lever_arm[2]
    turning[2] = w_CH_C[0] * params.lever_arm[1] - w_CH_C[1] * params.lever_arm[0]
    quat.transform_back_into(q, turning, arm_rate)
    for i in range(3):
        r[i] -= arm[i]
        axes.rail_mps[i] = v[i] - arm_rate[i]
    if params.geometry.enabled != 0:
        compensate(params.geometry, params.order, q, r, axes.rail_m, axes.gimbal_rad, jacobian)
    else:
        copy_into(axes.rail_m, r)
        quat.to_matrix_into(q, a)
        euler.from_matrix_into(a, params.order, axes.gimbal_rad)
        euler.rate_jacobian_of_matrix_into(a, params.order, jacobian)
    for i in range(3):
        axes.gimbal_radps[i] = 0.0
        for j in range(3):
            axes.gimbal_radps[i] += jacobian[i, j] * w_CH_C[j]


@kernel
def pose_on_bench(params, rail_m, gimbal_rad, r_CT_H, q_CH):
    """Write the pose ``r_CT_H`` (3,), m, ``q_CH`` (4,) of the bodies on a bench whose axes are at the given positions.

    It is what cameras on the bench see.
    """
    if params.geometry.enabled != 0:
        machine_pose(params.geometry, params.order, rail_m, gimbal_rad, r_CT_H, q_CH)
    else:
        euler.to_quaternion_into(gimbal_rad, params.order, q_CH)
        quat.transform_back_into(q_CH, params.lever_arm, r_CT_H)
        for i in range(3):
            r_CT_H[i] += rail_m[i]
    if params.reduced != 0:
        q_LH, q_CL = stack.vector(4), stack.vector(4)
        copy_into(q_CL, q_CH)
        quat.conjugate_into(params.q_HL, q_LH)
        quat.multiply_into(q_CL, q_LH, q_CH)
        quat.transform_into(params.q_HL, r_CT_H, r_CT_H)


@kernel
def pose_of_axes(params, rail_m, gimbal_rad, r_CT_H, q_CH):
    """Write the pose ``r_CT_H`` (3,), m, ``q_CH`` (4,) that a bench shows whose axes are at the given positions.

    It is another one than on the bench where this is scaled.
    """
    pose_on_bench(params, rail_m, gimbal_rad, r_CT_H, q_CH)
    square = 0.0
    for i in range(3):
        square += r_CT_H[i] ** 2
    if is_scaled(params, square):
        shown = math.sqrt(square)
        part = true_distance(params, shown) / shown
        for i in range(3):
            r_CT_H[i] *= part


@kernel
def _not_shown(params, rail_m, gimbal_rad, r_CT_H, q_CH, out):
    """Write a pose less the one that the axes show, (6,): in H, m, and the rotation from the shown one, in c, rad."""
    r, q, turned = stack.vector(3), stack.vector(4), stack.vector(3)
    pose_of_axes(params, rail_m, gimbal_rad, r, q)
    quat.rotation_between(q_CH, q, turned)
    for i in range(3):
        out[i], out[3 + i] = r_CT_H[i] - r[i], turned[i]


@kernel
def not_shown(params, rail_m, gimbal_rad, r_CT_H, q_CH, out):
    """Write ``_not_shown`` of n axes positions, (n, 3) each, and poses, (n, 3) and (n, 4), into ``out`` (n, 6)."""
    for k in range(out.shape[0]):
        _not_shown(params, rail_m[k], gimbal_rad[k], r_CT_H[k], q_CH[k], out[k])


@kernel
def unseen(params, r_CT_H, q_CH, axes, out):
    """Write what fixed axes leave out of poses, (n, 3), m, and (n, 4): as ``not_shown``, with the axes for each pose.

    axes: AXES, overwritten.
    """
    rest = stack.vector(3)
    fill(rest, 0.0)
    for k in range(out.shape[0]):
        axes_of_pose(params, r_CT_H[k], rest, q_CH[k], rest, axes)
        _not_shown(params, axes.rail_m, axes.gimbal_rad, r_CT_H[k], q_CH[k], out[k])


@kernel
def braking_speed(distance, acceleration, dt):
    """Return the fastest next step, as a speed, after which steps that each lose ``acceleration * dt`` end in time.

    With n further steps the way is ``dt ((n + 1) v - acceleration dt n (n + 1) / 2)``; it must not
    exceed ``distance``.
    """
    loss = acceleration * dt
    n = math.floor(0.5 * (math.sqrt(1.0 + 8.0 * distance / (loss * dt)) - 1.0) + 1e-9)
    return (distance / dt + 0.5 * loss * n * (n + 1.0)) / (n + 1.0)


@kernel
def _limit_axis(params, axis, position, rate, demand, demand_rate):
    """Return the rate of the next step of one axis, and whether it takes the axis to ``demand``.

    It does not where the axis would arrive faster than it could change to ``demand_rate`` in a step.
    """
    dt, acceleration, fastest = params.dt_s, params.acceleration_max[axis], params.rate_max[axis]
    target = min(params.high[axis], max(params.low[axis], demand))
    step = (target - position) / dt
    room = params.high[axis] - target if step > 0.0 else target - params.low[axis]
    slack = 1.0 + 1e-9
    if (
        target == demand
        and abs(step) <= fastest * slack
        and abs(step - rate) <= acceleration * dt * slack
        and abs(step - demand_rate) <= acceleration * dt * slack
        and (
            abs(step) <= acceleration * dt * slack  # which no braking can be too short for
            or abs(step) <= acceleration * dt * slack + braking_speed(room, acceleration, dt)
        )
    ):
        return step, True
    # a target that moves is approached relative to its motion, so that it is reached
    drift = min(fastest, max(-fastest, demand_rate)) if target == demand else 0.0
    behind = target - position - drift * dt
    # half the acceleration leaves the drive the other half to settle
    speed = braking_speed(abs(behind), acceleration if drift == 0.0 else 0.5 * acceleration, dt)
    allowed = drift + speed if behind > 0.0 else drift - speed
    allowed = min(allowed, braking_speed(max(0.0, params.high[axis] - position), acceleration, dt))
    allowed = max(allowed, -braking_speed(max(0.0, position - params.low[axis]), acceleration, dt))
    allowed = min(rate + acceleration * dt, max(rate - acceleration * dt, allowed))
    return min(fastest, max(-fastest, allowed)), False


@kernel
def ahead(position, rate, lead):
    """Return the position of an axis that moves at ``rate`` for ``lead`` s; without a lead ``position``, bit-exact.

    An axis that follows its setpoint ``lead`` late is then where it should be, but for half its
    acceleration times ``lead`` squared.
    """
    if lead == 0.0:
        return position
    return position + rate * lead


@kernel
def limit_setpoint(params, motion, goal, out):
    """Write ``out`` (AXES): the setpoint nearest to ``goal`` that travel, speed and acceleration allow.

    ``goal`` (AXES) is first taken ahead by the lead of each axis, so that the limits hold for what is sent.
    motion: MOTION, where the last setpoints are and how fast they went; moved on in place. An axis
    that is within its limits passes to the last bit; one that is not goes after its target as fast
    as it may, and brakes in time. Axes with a limit of their jerk get the mean of their last setpoints, which are
    taken ahead by its delay. Returns the number of axes that were limited.
    """
    limited = 0
    for axis in range(6):
        i = axis % 3
        feedforward = goal.rail_mps[i] if axis < 3 else goal.gimbal_radps[i]
        delay = averaging_delay(params, axis)
        target = ahead(goal.rail_m[i] if axis < 3 else goal.gimbal_rad[i], feedforward, params.lead[axis] + delay)
        # of the target taken ahead, which accelerates as the wanted one does
        target_rate = feedforward + delay * (feedforward - motion.wanted_rate[axis]) / params.dt_s
        motion.wanted_rate[axis] = feedforward
        rate, reached = _limit_axis(params, axis, motion.position[axis], motion.rate[axis], target, target_rate)
        if not (math.isfinite(target) and math.isfinite(feedforward)):
            # passed on: the driver of the axis rejects it, and the run stops
            position = target
        elif reached:
            position = target
            feedforward = min(params.rate_max[axis], max(-params.rate_max[axis], feedforward))
        else:
            limited += 1
            position = motion.position[axis] + rate * params.dt_s
            position = min(params.high[axis], max(params.low[axis], position))
            feedforward = rate
        motion.rate[axis] = rate
        motion.position[axis] = position
        write_axis(axis, position, feedforward, out)
    limit_jerk(params, motion, out)
    return limited


@kernel
def averaging_delay(params, axis):
    """Return the delay of the mean of the last setpoints of ``axis``, s; 0 without a limit of its jerk."""
    return 0.5 * (max(1, params.averaged[axis]) - 1) * params.dt_s


@kernel
def limit_jerk(params, motion, out):
    """Replace the setpoints in ``out`` (AXES) by the mean of the last ``averaged`` ones of their axis.

    The mean of n setpoints whose acceleration is at most a has at most that acceleration, and its jerk, the third
    difference over dt^3, is at most 2 a / (n dt). It is within the travel where they are. motion: MOTION.
    """
    motion.newest = (motion.newest + 1) % SETPOINTS_KEPT
    for axis in range(6):
        n, i = params.averaged[axis], axis % 3
        if n < 2:
            continue
        position = out.rail_m[i] if axis < 3 else out.gimbal_rad[i]
        rate = out.rail_mps[i] if axis < 3 else out.gimbal_radps[i]
        motion.kept_position[axis, motion.newest], motion.kept_rate[axis, motion.newest] = position, rate
        behind, rates = 0.0, 0.0
        for back in range(n):
            k = (motion.newest - back) % SETPOINTS_KEPT
            behind += position - motion.kept_position[axis, k]
            rates += motion.kept_rate[axis, k]
        write_axis(axis, position - behind / n, rates / n, out)


@kernel
def extend_span(span, target, duration_s):
    """Begin the next cycle, of ``duration_s``, where the last one ends; it ends at ``target`` (AXES).

    The first one of a motion begins where ``target`` comes from at its rates. span: SPAN.
    """
    if span.known != 0:
        copy_record(span.end, span.begin)
    else:
        copy_record(target, span.begin)
        for i in range(3):
            span.begin.rail_m[i] -= duration_s * target.rail_mps[i]
            span.begin.gimbal_rad[i] -= duration_s * target.gimbal_radps[i]
    copy_record(target, span.end)
    span.known = 1


@kernel
def within_span(span, duration_s, fraction, out):
    """Write ``out`` (AXES): positions and rates at ``fraction`` of the cycle of ``duration_s``; at 1 exactly its end.

    Cubic Hermite interpolation: off by the fourth power of the duration while the acceleration is constant.
    """
    s = fraction
    h00, h10 = (2.0 * s - 3.0) * s * s + 1.0, ((s - 2.0) * s + 1.0) * s
    h01, h11 = (3.0 - 2.0 * s) * s * s, (s - 1.0) * s * s
    d00, d10 = 6.0 * (s - 1.0) * s, (3.0 * s - 4.0) * s + 1.0
    d11 = (3.0 * s - 2.0) * s
    begin, end = span.begin, span.end
    for i in range(3):
        a, b, u, v = begin.rail_m[i], end.rail_m[i], begin.rail_mps[i], end.rail_mps[i]
        out.rail_m[i] = h00 * a + h01 * b + duration_s * (h10 * u + h11 * v)
        out.rail_mps[i] = d00 * (a - b) / duration_s + d10 * u + d11 * v
        a, b, u, v = begin.gimbal_rad[i], end.gimbal_rad[i], begin.gimbal_radps[i], end.gimbal_radps[i]
        out.gimbal_rad[i] = h00 * a + h01 * b + duration_s * (h10 * u + h11 * v)
        out.gimbal_radps[i] = d00 * (a - b) / duration_s + d10 * u + d11 * v


@kernel
def start_motion(rail_m, gimbal_rad, motion):
    """Make ``motion`` (MOTION) stand at the given positions."""
    for i in range(3):
        motion.position[i] = rail_m[i]
        motion.position[3 + i] = gimbal_rad[i]
        motion.rate[i] = motion.wanted_rate[i] = 0.0
        motion.rate[3 + i] = motion.wanted_rate[3 + i] = 0.0
    for axis in range(6):
        for k in range(SETPOINTS_KEPT):
            motion.kept_position[axis, k] = motion.position[axis]
            motion.kept_rate[axis, k] = 0.0


@kernel
def write_axis(axis, position, rate, out):
    """Write one axis, 0 to 5 (rails x y z, gimbals roll pitch yaw), into ``out`` (AXES)."""
    if axis < 3:
        out.rail_m[axis] = position
        out.rail_mps[axis] = rate
    else:
        out.gimbal_rad[axis - 3] = position
        out.gimbal_radps[axis - 3] = rate


@kernel
def write_axes(rail_m, rail_mps, gimbal_rad, gimbal_radps, out):
    """Write the four arrays (3,) into ``out`` (AXES)."""
    for i in range(3):
        out.rail_m[i] = rail_m[i]
        out.rail_mps[i] = rail_mps[i]
        out.gimbal_rad[i] = gimbal_rad[i]
        out.gimbal_radps[i] = gimbal_radps[i]
