"""The ready phase on the truth: bench paper Table III, twelve deviations a moment, each axis alone.

The ready phase begins when all twelve have been within their tolerances for the dwell time without a break;
from then on their largest absolute values count.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import euler, quat, stack
from hil.maths.limits import has_held

DEVIATIONS = 12  # position, m, velocity, m/s, 3-2-1 angles, deg, and their axes' rates, deg/s, three each

READY_PARAMS = np.dtype([("axial_distance", "f8"), ("dwell_s", "f8"), ("tolerance", "f8", DEVIATIONS)], align=True)

READY_STATE = np.dtype(
    [
        ("is_ready", "i8"),  # the ready phase has begun
        ("left", "i8"),  # a tolerance was broken in it
        ("holding", "i8"),  # all deviations are within their tolerances
        ("since_s", "f8"),  # begin of that; once ready: of the dwell
        ("ready_s", "f8"),
        ("last_s", "f8"),  # time of the last cycle
        ("worst", "f8", DEVIATIONS),  # largest absolute deviations of the ready phase
        ("worst_s", "f8", DEVIATIONS),  # their times
        ("left_s", "f8"),  # when the first tolerance was broken in it ...
        ("left_by", "i8"),  # ... by this deviation
        ("left_value", "f8"),
        ("breaks", "i8", DEVIATIONS),  # how often each has ended a dwell before it
        ("break_s", "f8", DEVIATIONS),  # when first
        ("break_value", "f8", DEVIATIONS),  # largest value of these
        ("out", "i8", DEVIATIONS),  # cycles in which each was out, near the ready point without a dwell
        ("out_s", "f8", DEVIATIONS),  # when first
        ("out_value", "f8", DEVIATIONS),  # the last value of these
    ],
    align=True,
)

_YAW_PITCH_ROLL = (2, 1, 0)
_ANGLES: Final = 6  # first of the angles among the deviations


@kernel
def _linear_deviations(params, r_CT_H, v_CT_H, w_CH_C, out):
    """Write the deviations (12,) but for the angles; return whether they are within the tolerance."""
    within = True
    for i in range(3):
        out[i] = r_CT_H[i]
        out[3 + i] = v_CT_H[i]
        out[9 + i] = math.degrees(w_CH_C[i])
    out[0] -= params.axial_distance
    for i in range(DEVIATIONS):
        if not (_ANGLES <= i < _ANGLES + 3 or abs(out[i]) <= params.tolerance[i]):
            within = False
    return within


@kernel
def _angles(q_CH, out):
    """Write the angles of the deviations (12,)."""
    angles = stack.vector(3)
    euler.from_quaternion_into(q_CH, _YAW_PITCH_ROLL, angles)
    for i in range(3):
        out[_ANGLES + i] = math.degrees(angles[i])


@kernel
def deviations(params, r_CT_H, v_CT_H, q_CH, w_CH_C, out):
    """Write the deviations (12,) from the ready state: axial distance from the ready point, all else from zero.

    params: READY_PARAMS. r_CT_H: (3,), m. v_CT_H: (3,), m/s. q_CH: (4,). w_CH_C: (3,), rad/s, against H.
    """
    _linear_deviations(params, r_CT_H, v_CT_H, w_CH_C, out)
    _angles(q_CH, out)


@kernel
def is_within(params, deviation):
    """Return whether each of the ``deviation`` (12,) is within its tolerance."""
    within = True
    for i in range(DEVIATIONS):
        if not abs(deviation[i]) <= params.tolerance[i]:
            within = False
    return within


@kernel
def deviations_of(params, r_CT_H, v_CT_H, q_CH, w_CI_C, w_HI_H, out):
    """``deviations`` of a chaser whose rate is known against inertial space. w_CI_C, w_HI_H: rad/s, of c and H."""
    w_CH_C = stack.vector(3)
    quat.transform_into(q_CH, w_HI_H, w_CH_C)
    for i in range(3):
        w_CH_C[i] = w_CI_C[i] - w_CH_C[i]
    deviations(params, r_CT_H, v_CT_H, q_CH, w_CH_C, out)


@kernel
def update_from(params, state, t_s, r_CT_H, v_CT_H, q_CH, w_CH_C):
    """``update`` with the ``deviations`` at ``t_s``; the angles are computed only where they decide."""
    deviation = stack.vector(12)
    if _linear_deviations(params, r_CT_H, v_CT_H, w_CH_C, deviation) or state.is_ready != 0:
        _angles(q_CH, deviation)
        update(params, state, t_s, deviation)
    else:
        state.last_s = t_s
        for i in range(3):
            deviation[_ANGLES + i] = 0.0
        _note_out(params, state, t_s, deviation)
        state.holding = 0


@kernel
def _note_out(params, state, t_s, deviation):
    """Count which of ``deviation`` (12,) ends a dwell, or keeps one from beginning at the ready point."""
    if state.holding == 0 and not abs(deviation[0]) <= params.tolerance[0]:
        return
    for i in range(DEVIATIONS):
        value = abs(deviation[i])
        if value <= params.tolerance[i]:
            continue
        if state.holding == 0:
            if state.out[i] == 0:
                state.out_s[i] = t_s
            state.out[i] += 1
            state.out_value[i] = value
            continue
        if state.breaks[i] == 0:
            state.break_s[i] = t_s
        state.breaks[i] += 1
        state.break_value[i] = max(state.break_value[i], value)


@kernel
def update(params, state, t_s, deviation):
    """Update the state with the ``deviation`` (12,) at ``t_s``. state: READY_STATE, zeroed at the start of a run."""
    state.last_s = t_s
    within = is_within(params, deviation)
    if state.is_ready == 0:
        if not within:
            _note_out(params, state, t_s, deviation)
            state.holding = 0
            return
        if state.holding == 0:
            state.holding, state.since_s = 1, t_s
        if not has_held(state.since_s, t_s, params.dwell_s):
            return
        state.is_ready, state.ready_s = 1, t_s
    for i in range(DEVIATIONS):
        value = abs(deviation[i])
        if not (value <= state.worst[i] or math.isnan(state.worst[i])):  # nan stays
            state.worst[i], state.worst_s[i] = value, t_s
        if not within and state.left == 0 and not value <= params.tolerance[i]:
            state.left, state.left_s, state.left_by, state.left_value = 1, t_s, i, value


@kernel
def all_deviations(params, r_CT_H, v_CT_H, q_CH, w_CI_C, w_HI_H, out):
    """``deviations_of`` each row of the arrays (n, 3), q_CH (n, 4), into those of ``out`` (n, 12)."""
    for k in range(out.shape[0]):
        deviations_of(params, r_CT_H[k], v_CT_H[k], q_CH[k], w_CI_C[k], w_HI_H[k], out[k])
