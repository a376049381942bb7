"""Guidance: the reference as a list of phases, each a straight line from rest to rest and a stay at its end.

A phase starts where the one before ended. Moving phases (approach, final, retreat) are over when
their line is completed, a hold after its duration, a wait at its time or at the order to continue; the last
phase of the list never ends. An abort leaves the list: brake from the present velocity, retreat along the
docking axis, hold. The reference's attitude is that of H throughout.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import MAX_PHASES
from hil.maths import stack
from hil.maths.arrays import copy_into, fill
from hil.models.profile import along_line, duration

APPROACH, HOLD, WAIT, FINAL, RETREAT, BRAKE = range(6)
STAYED, MOVED, REFUSED = range(3)  # results of advance
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
        ("duration_s", "f8", MAX_PHASES),  # of a hold
        ("until_s", "f8", MAX_PHASES),  # of a wait, time of the run; inf: an order only
        ("axis", "f8", 3),  # unit vector from the target outwards, in H
        ("abort_distance", "f8"),  # m, from the target
        ("abort_speed", "f8"),  # m/s
        ("abort_acceleration", "f8"),  # m/s^2, of the retreat
        ("brake", "f8"),  # m/s^2, of the brake before it
    ],
    align=True,
)

GUIDANCE_STATE = np.dtype(
    [
        ("phase", "i8"),
        ("since_s", "f8"),  # begin of the phase, time of the run
        ("from_H", "f8", 3),  # m, where the phase began
        ("to_H", "f8", 3),  # m, where it ends
        ("brake_H", "f8", 3),  # m/s, velocity at the start of a brake
        ("abort_range", "f8"),  # m, from the target, to which the abort retreats
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
def _length(state):
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
        copy_into(state.to_H, params.point[phase])


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
    copy_into(state.from_H, params.start)
    _aim(params, state)


@kernel
def start_abort(params, state, t_s, r_CT_H, v_CT_H):
    """Leave the list at ``t_s``: brake from ``r_CT_H``, m, and ``v_CT_H``, m/s.

    The retreat goes to the abort distance, or to the present range if that is larger.
    """
    distance = math.sqrt(r_CT_H[0] ** 2 + r_CT_H[1] ** 2 + r_CT_H[2] ** 2)
    state.abort_range = max(params.abort_distance, distance)
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
    _aim(params, state)


@kernel
def _limits(params, phase):
    """Return speed, acceleration and deceleration of a moving phase."""
    if phase >= params.n_phases:
        return params.abort_speed, params.abort_acceleration, params.abort_acceleration
    return params.speed[phase], params.acceleration[phase], params.deceleration[phase]


@kernel
def nominal_end(params, state):
    """Return the time of the run at which the present phase ends by itself, s; inf for a wait that has no time.

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
    speed, acceleration, deceleration = _limits(params, phase)
    return state.since_s + duration(_length(state), speed, acceleration, deceleration)


@kernel
def _ends_at(params, state, go):
    """Return the time of the run at which the next phase may begin, inf if that is unknown or there is none."""
    phase = state.phase
    if phase == params.n_phases - 1 or phase == params.n_phases + _ABORT_PHASES - 1:
        return np.inf
    if go != 0 and kind_of(params, phase) == WAIT:
        return -np.inf
    return nominal_end(params, state)


@kernel
def advance(params, state, t_s, go, held):
    """Move ``state`` on to the phase of ``t_s``; return STAYED, MOVED or REFUSED.

    go: 1 at the order to continue, refused if the next phase is not allowed. held: 1 if a final phase must not begin.
    """
    found = STAYED
    if go != 0 and kind_of(params, state.phase) == WAIT:
        found = REFUSED
    ends = _ends_at(params, state, go)
    while ends <= t_s:
        if held != 0 and kind_of(params, state.phase + 1) == FINAL:
            break
        if kind_of(params, state.phase) == WAIT:
            state.since_s = t_s
            go = 0
        else:
            state.since_s = ends
        copy_into(state.from_H, state.to_H)
        state.phase += 1
        _aim(params, state)
        found = MOVED
        ends = _ends_at(params, state, go)
    return found


@kernel
def reference(params, state, t_s, out):
    """Write ``out`` (REFERENCE) for ``t_s``, time of the run, in the phase of ``state``."""
    since = t_s - state.since_s
    kind = kind_of(params, state.phase)
    copy_into(out.from_H, state.from_H)
    copy_into(out.to_H, state.to_H)
    out.phase = state.phase
    out.boost = 1 if kind == BRAKE else 0
    for i in range(3):
        out.q_CH[i] = 0.0
    out.q_CH[3] = 1.0
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
    length = 0.0 if kind in (HOLD, WAIT) else _length(state)
    along = stack.vector(3)
    fill(along, 0.0)
    if length > 0.0:
        speed, acceleration, deceleration = _limits(params, state.phase)
        along_line(length, speed, acceleration, deceleration, since, along)
    for i in range(3):
        unit = (state.to_H[i] - state.from_H[i]) / length if length > 0.0 else 0.0
        out.r_CT_H[i] = state.from_H[i] + along[0] * unit
        out.v_CT_H[i] = along[1] * unit
        out.a_CT_H[i] = along[2] * unit
