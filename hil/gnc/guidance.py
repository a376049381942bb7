"""Guidance: the reference as a list of phases, each a path from rest to rest and a stay at its end.

A phase starts where the one before ended. Moving phases are over when their path is completed, a hold after its
duration, a wait at its time or at the order to continue; the last phase of the list never ends. The path is a straight
line (approach, final, retreat), an arc about the target on which the chaser rotates with it (fly-around), a rotation
at rest (slew), or the free motion between the burns of a transfer, which is planned from the estimate as it begins. The
attitude is H's at first. An abort leaves the list: brake from the present velocity, retreat along the docking
axis, hold, all at the attitude of the moment.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_PHASES
from hil.gnc.estimation.target_orbit import TARGET_ORBIT
from hil.gnc.guidance_transfer import TRANSFER_PLAN, least_drift_range, on_transfer, plan_transfer
from hil.gnc.impulses import TRANSFER_WORK, size_of
from hil.maths import elementary, quat, stack
from hil.maths.arrays import copy_into, fill
from hil.models.profile import along_line, duration

APPROACH, HOLD, WAIT, FINAL, RETREAT, BRAKE = range(6)
LINE, ARC, SLEW, TRANSFER = range(4)  # paths of a moving phase
STAYED, MOVED, REFUSED = range(3)  # results of advance
HOLDS_FINAL, HOLDS_HOLD = 1, 2  # bits: a final phase must not begin, a hold must not end
_STRETCH, _TRIES = 0.02, 50  # relative extension of a transfer without a plan, and number of tries
_ABORT_PHASES = 3  # brake, retreat, hold: numbered after the phases of the list

GUIDANCE_PARAMS = np.dtype(
    [
        ("start", "f8", 3),  # m, in H
        ("n_phases", "i8"),
        ("kind", "i8", MAX_PHASES),
        ("point", "f8", (MAX_PHASES, 3)),  # m, in H, where a moving phase ends
        ("speed", "f8", MAX_PHASES),  # m/s
        ("acceleration", "f8", MAX_PHASES),  # m/s^2
        ("deceleration", "f8", MAX_PHASES),  # m/s^2
        ("duration_s", "f8", MAX_PHASES),  # duration of a hold or a transfer
        ("until_s", "f8", MAX_PHASES),  # end of a wait, time of the run; inf: only an order ends it
        ("axis", "f8", 3),  # unit vector from the target outwards, in H
        ("abort_distance", "f8"),  # m, from the target
        ("abort_speed", "f8"),  # m/s
        ("abort_acceleration", "f8"),  # m/s^2, of the retreat
        ("brake", "f8"),  # m/s^2, of the brake before it
        ("path", "i8", MAX_PHASES),  # path of a moving phase
        ("full_thrust", "i8", MAX_PHASES),  # 1: takes more than a demand gives, all thrusters that push that way
        ("attitude", "f8", (MAX_PHASES, 4)),  # at the end of a slew, whose speeds are in rad/s
        ("optimal", "i8", MAX_PHASES),  # impulses of a transfer: 1 any number, 0 two
        ("passive_s", "f8", MAX_PHASES),  # for which a drift after a missed burn stays beyond ``clear_range``; 0: any
        ("clear_range", "f8"),  # m, from which on the bodies cannot meet at any attitude
        ("orbit", TARGET_ORBIT),
    ],
    align=True,
)

GUIDANCE_STATE = np.dtype(
    [
        ("phase", "i8"),
        ("since_s", "f8"),  # begin of the phase, time of the run
        ("late", "i8"),  # 1: a hold has lasted beyond its time
        ("from_H", "f8", 3),  # m, where the phase began
        ("to_H", "f8", 3),  # m, where it ends
        ("brake_H", "f8", 3),  # m/s, velocity at the start of a brake
        ("abort_range", "f8"),  # m, from the target, to which the abort retreats
        ("q_from", "f8", 4),  # attitude at the start of the phase
        ("turn_C", "f8", 3),  # rad, rotation of c over the phase, in c
        ("axis", "f8", 3),  # unit vector in H, of the rotation of an arc
        ("turns", "i8"),  # 1: c rotates over the phase
        ("length", "f8"),  # m, of the path, of a slew rad; 0 of a hold, a wait and a brake
        ("ends_s", "f8"),  # time of the run at which the phase ends by itself, inf for a wait that has no time
        ("seen_s", "f8"),  # time of the run of the last estimate, of which ``seen`` is [r, v] in H, m, m/s
        ("seen", "f8", 6),
        ("is_seen", "i8"),  # 1: there was one
        ("tries", "i8"),  # plans that the present transfer has rejected
        ("plan", TRANSFER_PLAN),
        ("work", TRANSFER_WORK),
    ],
    align=True,
)


@kernel
def kind_of(params, phase):
    """Return the kind of the phase numbered ``phase``; those after the list are brake, retreat, hold."""
    after = phase - params.n_phases
    if after < 0:
        return params.kind[phase]
    if after == 0:
        return BRAKE
    return RETREAT if after == 1 else HOLD


@kernel
def _path(params, phase):
    """Return the path of a phase; those after the list are straight."""
    return params.path[phase] if phase < params.n_phases else LINE


@kernel
def _length(params, state):
    """Return the length of the phase's path: m, of a slew rad."""
    path = _path(params, state.phase)
    if path == SLEW:
        return size_of(state.turn_C)
    if path == ARC:
        return size_of(state.turn_C) * max(size_of(state.from_H), size_of(state.to_H))
    square = 0.0
    for i in range(3):
        square += (state.to_H[i] - state.from_H[i]) ** 2
    return math.sqrt(square)


@kernel
def _aim(params, state):
    """Write ``state.to_H`` for the phase that begins at ``state.from_H``."""
    phase = state.phase
    kind = kind_of(params, phase)
    copy_into(state.to_H, state.from_H)
    if kind == BRAKE:
        speed = math.sqrt(state.brake_H[0] ** 2 + state.brake_H[1] ** 2 + state.brake_H[2] ** 2)
        for i in range(3):
            state.to_H[i] += 0.5 * state.brake_H[i] * speed / params.brake
    elif kind == RETREAT and phase >= params.n_phases:
        _aim_outwards(params, state)
    elif kind != HOLD and kind != WAIT:
        if params.path[phase] == SLEW:
            quat.rotation_between(params.attitude[phase], state.q_from, state.turn_C)
        else:
            copy_into(state.to_H, params.point[phase])
        if params.path[phase] == ARC:
            _aim_arc(state)
        elif params.path[phase] == TRANSFER:
            state.tries = 0
            _plan(params, state)
    state.turns = 0 if size_of(state.turn_C) == 0.0 else 1
    state.length = 0.0 if kind in (BRAKE, HOLD, WAIT) else _length(params, state)
    state.ends_s = _nominal_end(params, state)


@kernel
def note(state, t_s, estimate):
    """Take the estimate (NAVIGATION) of ``t_s``, from which a transfer is planned."""
    state.is_seen, state.seen_s = estimate.valid, t_s
    for i in range(3):
        state.seen[i], state.seen[3 + i] = estimate.r_CT_H[i], estimate.v_CT_H[i]


@kernel
def _plan(params, state):
    """Plan the transfer that begins, from the last estimate, or from rest without one; ``state.plan.n`` 0: none.

    The plan must be passively safe if that is asked.
    """
    phase, start = state.phase, stack.vector(6)
    fill(start, 0.0)
    for i in range(3):
        start[i] = state.from_H[i]
        if state.is_seen != 0:
            start[i] = state.seen[i] + (state.since_s - state.seen_s) * state.seen[3 + i]
            start[3 + i] = state.seen[3 + i]
        state.from_H[i] = start[i]
    duration_s = params.duration_s[phase] * (1.0 + _STRETCH * state.tries)
    plan_transfer(
        params.orbit, state.since_s, duration_s, params.optimal[phase], params.acceleration[phase], start,
        params.point[phase], state.work, state.plan,
    )  # fmt: skip
    horizon_s = params.passive_s[phase]
    if state.plan.n > 0 and horizon_s > 0.0:
        nearest = least_drift_range(params.orbit, state.plan, horizon_s, state.work.whole)
        if not nearest >= params.clear_range:
            state.plan.n = 0


@kernel
def _plan_again(params, state, t_s):
    """Plan the present transfer again with a longer time, once per cycle, if it has no plan."""
    if _path(params, state.phase) == TRANSFER and state.plan.n == 0 and state.tries < _TRIES:
        state.since_s = t_s
        state.tries += 1
        _plan(params, state)
        state.ends_s = _nominal_end(params, state)


@kernel
def _aim_arc(state):
    """Write axis and rotation of the arc about the target, the shorter way from ``state.from_H`` to ``state.to_H``."""
    a, b, axis = state.from_H, state.to_H, state.axis
    axis[0], axis[1], axis[2] = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    size = size_of(axis)
    angle = elementary.atan2(size, a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    for i in range(3):
        axis[i] = axis[i] / size if size > 0.0 else 0.0
    quat.transform_into(state.q_from, axis, state.turn_C)
    for i in range(3):
        state.turn_C[i] *= angle


@kernel
def _turned(state, fraction, q):
    """Write the attitude ``q`` (4,) at ``fraction`` of the phase's rotation."""
    if state.turns == 0:
        copy_into(q, state.q_from)
        return
    part, rotation, turned = stack.vector(3), stack.vector(4), stack.vector(4)
    for i in range(3):
        part[i] = fraction * state.turn_C[i]
    quat.from_rotation_vector_into(part, rotation)
    quat.multiply_into(rotation, state.q_from, turned)
    quat.normalise(turned)
    copy_into(q, turned)


@kernel
def _keep_attitude(state, fraction):
    """Begin the next phase at the attitude of ``fraction`` of this one's rotation."""
    q = stack.vector(4)
    _turned(state, fraction, q)
    copy_into(state.q_from, q)
    fill(state.turn_C, 0.0)
    state.turns = 0


@kernel
def _aim_outwards(params, state):
    """Write ``state.to_H``: along the docking axis until the range is ``state.abort_range``.

    On the far side of the target the path is radial, so that the range never decreases.
    """
    square = 0.0
    axial = 0.0
    for i in range(3):
        square += state.from_H[i] ** 2
        axial += state.from_H[i] * params.axis[i]
    distance = math.sqrt(square)
    if distance >= state.abort_range or distance == 0.0:
        return
    length = math.sqrt(axial * axial + state.abort_range**2 - square) - axial
    for i in range(3):
        if axial > 0.0:
            state.to_H[i] = state.from_H[i] + length * params.axis[i]
        else:
            state.to_H[i] = state.from_H[i] * state.abort_range / distance


@kernel
def start(params, state):
    """Begin the first phase at t = 0."""
    state.phase = 0
    state.since_s = 0.0
    state.q_from[0] = state.q_from[1] = state.q_from[2] = 0.0
    state.q_from[3] = 1.0
    fill(state.turn_C, 0.0)
    copy_into(state.from_H, params.start)
    _aim(params, state)


@kernel
def start_abort(params, state, t_s, r_CT_H, v_CT_H):
    """Leave the list at ``t_s``: brake from ``r_CT_H``, m, and ``v_CT_H``, m/s.

    The retreat goes to the abort distance, or to the present range if that is larger.
    """
    distance = math.sqrt(r_CT_H[0] ** 2 + r_CT_H[1] ** 2 + r_CT_H[2] ** 2)
    state.abort_range = max(params.abort_distance, distance)
    _keep_attitude(state, _fraction(params, state, t_s))
    state.phase = params.n_phases
    state.since_s = t_s
    copy_into(state.from_H, r_CT_H)
    copy_into(state.brake_H, v_CT_H)
    _aim(params, state)


@kernel
def is_at_rest(params, state):
    """Return whether the retreat after a brake is over."""
    return state.phase == params.n_phases + _ABORT_PHASES - 1


@kernel
def resume(params, state, t_s, phase):
    """Return to the list at ``t_s``, from rest: to the last moving phase up to ``phase``, the first one without any."""
    while phase > 0 and kind_of(params, phase) in (HOLD, WAIT):
        phase -= 1
    state.phase = phase
    state.since_s = t_s
    copy_into(state.from_H, state.to_H)
    _keep_attitude(state, 1.0)
    _aim(params, state)


@kernel
def _limits(params, phase):
    """Return speed, acceleration and deceleration of a moving phase."""
    if phase >= params.n_phases:
        return params.abort_speed, params.abort_acceleration, params.abort_acceleration
    return params.speed[phase], params.acceleration[phase], params.deceleration[phase]


@kernel
def _fraction(params, state, t_s):
    """Return the fraction of the phase's rotation at ``t_s``."""
    if state.turns == 0:
        return 0.0
    along = stack.vector(3)
    speed, acceleration, deceleration = _limits(params, state.phase)
    along_line(state.length, speed, acceleration, deceleration, t_s - state.since_s, along)
    return along[0] / state.length


@kernel
def _nominal_end(params, state):
    """Return ``state.ends_s`` for the phase that begins.

    The last phase of the list has a nominal end as well, after which the reference stays where it is.
    """
    phase = state.phase
    kind = kind_of(params, phase)
    if kind == BRAKE:
        speed = math.sqrt(state.brake_H[0] ** 2 + state.brake_H[1] ** 2 + state.brake_H[2] ** 2)
        return state.since_s + speed / params.brake
    if kind == HOLD:
        return state.since_s + params.duration_s[phase] if phase < params.n_phases else np.inf
    if kind == WAIT:
        return params.until_s[phase]
    if _path(params, phase) == TRANSFER:
        return state.since_s + state.plan.duration_s if state.plan.n > 0 else np.inf
    speed, acceleration, deceleration = _limits(params, phase)
    return state.since_s + duration(state.length, speed, acceleration, deceleration)


@kernel
def _ends_at(params, state, go):
    """Return the time of the run at which the next phase may begin, inf if that is unknown or there is none."""
    phase = state.phase
    if phase == params.n_phases - 1 or phase == params.n_phases + _ABORT_PHASES - 1:
        return np.inf
    if go != 0 and kind_of(params, phase) == WAIT:
        return -np.inf
    return state.ends_s


@kernel
def advance(params, state, t_s, go, held):
    """Move ``state`` on to the phase of ``t_s``; return STAYED, MOVED or REFUSED.

    go: 1 at the order to continue, refused if the next phase is not allowed. held: HOLDS_FINAL, HOLDS_HOLD, 0.
    """
    move = STAYED
    if go != 0 and kind_of(params, state.phase) == WAIT:
        move = REFUSED
    _plan_again(params, state, t_s)
    ends = _ends_at(params, state, go)
    while ends <= t_s:
        if held & HOLDS_FINAL != 0 and kind_of(params, state.phase + 1) == FINAL:
            break
        if held & HOLDS_HOLD != 0 and kind_of(params, state.phase) == HOLD:
            state.late = 1
            break
        if kind_of(params, state.phase) == WAIT or state.late != 0:
            state.since_s = t_s
            go = state.late = 0
        else:
            state.since_s = ends
        copy_into(state.from_H, state.to_H)
        _keep_attitude(state, 1.0)
        state.phase += 1
        _aim(params, state)
        move = MOVED
        ends = _ends_at(params, state, go)
    return move


@kernel
def reference(params, state, t_s, out):
    """Write ``out`` (REFERENCE) for ``t_s``, time of the run, in the phase of ``state``."""
    since = t_s - state.since_s
    kind = kind_of(params, state.phase)
    copy_into(out.from_H, state.from_H)
    copy_into(out.to_H, state.to_H)
    out.phase = state.phase
    out.boost = 1 if kind == BRAKE or (state.phase < params.n_phases and params.full_thrust[state.phase] != 0) else 0
    _turned(state, _fraction(params, state, t_s), out.q_CH)
    if kind == BRAKE:
        speed = math.sqrt(state.brake_H[0] ** 2 + state.brake_H[1] ** 2 + state.brake_H[2] ** 2)
        takes = speed / params.brake
        t = min(since, takes)
        for i in range(3):
            loss = state.brake_H[i] / takes if since < takes else 0.0
            out.a_CT_H[i] = -loss
            out.v_CT_H[i] = loss * (takes - t)
            out.r_CT_H[i] = state.from_H[i] + state.brake_H[i] * t - 0.5 * loss * t * t
        return
    if _path(params, state.phase) == TRANSFER:
        _on_transfer(params, state, since, out)
        return
    length, along = state.length, stack.vector(3)
    fill(along, 0.0)
    if length > 0.0:
        speed, acceleration, deceleration = _limits(params, state.phase)
        along_line(length, speed, acceleration, deceleration, since, along)
    path = LINE if length == 0.0 else _path(params, state.phase)
    if path == ARC:
        _on_arc(state, length, along, out)
        return
    for i in range(3):
        unit = (state.to_H[i] - state.from_H[i]) / length if length > 0.0 else 0.0
        out.r_CT_H[i] = state.from_H[i] + along[0] * unit
        out.v_CT_H[i] = along[1] * unit
        out.a_CT_H[i] = along[2] * unit


@kernel
def _on_transfer(params, state, since, out):
    """Write position and velocity ``since`` the start of a transfer, and the acceleration by thrust; rest without plan.

    The corridor is about the reference itself.
    """
    moved = stack.vector(6)
    for i in range(3):
        moved[i], moved[3 + i], out.a_CT_H[i] = state.from_H[i], 0.0, 0.0
    if state.plan.n > 0 and since > state.plan.duration_s:  # of the last phase, which never ends
        copy_into(moved[:3], state.to_H)
    elif state.plan.n > 0:
        on_transfer(params.orbit, state.plan, state.plan.n, since, state.work.whole, moved, out.a_CT_H)
    for i in range(3):
        out.r_CT_H[i], out.v_CT_H[i] = moved[i], moved[3 + i]
    copy_into(out.from_H, out.r_CT_H)
    copy_into(out.to_H, out.r_CT_H)


@kernel
def _on_arc(state, length, along, out):
    """Write position, velocity and acceleration on an arc about the target, whose radius changes evenly along it.

    along: path length, m, and its first and second rate (3,). The corridor is about the reference itself.
    """
    angle, before, after = size_of(state.turn_C), size_of(state.from_H), size_of(state.to_H)
    theta, rate, change = angle * along[0] / length, angle * along[1] / length, angle * along[2] / length
    step = (after - before) / length
    radius, radius_rate, radius_change = before + step * along[0], step * along[1], step * along[2]
    n, u, s, c = state.axis, state.from_H, elementary.sin(theta), elementary.cos(theta)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        side = (n[j] * u[k] - n[k] * u[j]) / before
        outwards, forwards = u[i] / before * c + side * s, side * c - u[i] / before * s
        out.r_CT_H[i] = radius * outwards
        out.v_CT_H[i] = radius_rate * outwards + radius * rate * forwards
        out.a_CT_H[i] = (radius_change - radius * rate * rate) * outwards
        out.a_CT_H[i] += (2.0 * radius_rate * rate + radius * change) * forwards
    copy_into(out.from_H, out.r_CT_H)
    copy_into(out.to_H, out.r_CT_H)
