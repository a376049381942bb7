"""Doubts of the monitors about parameters, before a sensor is accused.

Innovations with a mean may be those of a wrong parameter of the dynamics: the rate of H, the gyros' drift, the scale of
the accelerometer. It is then estimated again: DOUBTS are added to the covariance in the next step.
"""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.gnc.estimation.integrity import SUMS
from hil.maths import elementary, quat
from hil.maths.arrays import fill

_DOUBTS_MAX = 3
_DOUBT_RADPS = 1e-5  # 1 sigma, of a rate that is estimated again
_EXCESS_MPS = 3e-4  # from which on accelerometer and commands differ
_SCALE_MAX = 0.05  # error of the accelerometer's scale that is admitted, 1 sigma
_UNKNOWN_M2PS2 = 1.0  # variance of an unknown velocity
_ALONG = 0.8  # cosine of the angle between this difference and the mean of the innovations
_ACROSS = 0.2  # part of a doubted velocity that may point elsewhere
_FOUND_S = 3.0  # after which it is found
_DISTURBED_S = 50.0  # in which the disturbance may have explained it


@kernel
def doubt_drift(params, state, doubts):
    """Let the filters estimate the rate again when the attitude's innovations have a mean, before a sensor is accused.

    Such a mean is that of a wrong rate of H (the ephemeris), or of gyros whose drift has changed. doubts: DOUBTS.
    """
    if state.doubted >= _DOUBTS_MAX:
        return
    for i in range(3, 6):
        if max(state.high[i], state.low[i]) > 0.5 * params.cusum_limit:
            state.doubted += 1
            doubts.acts, doubts.drift = 1, _DOUBT_RADPS
            for j in range(3):
                state.high[3 + j] = state.low[3 + j] = 0.0
            return


@kernel
def doubt_velocity(params, state, errors, fusion):
    """Let the filters estimate the velocity again if poses and commands agree against the accelerometer.

    The innovations of the position, in c, have a mean along the velocity that the accelerometer has read beyond the
    commands: its scale is wrong, and the velocity by as much. Each excess is admitted once. errors: ERROR_STATE.
    """
    if errors.disturbance == 0:
        return
    excess, gained = fusion.thrust.excess_C, fusion.thrust.gained_C
    size, possible, sums, along, largest = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(3):
        trend = state.high[i] - state.low[i]
        size += excess[i] ** 2
        possible += (_SCALE_MAX * gained[i]) ** 2
        sums += trend * trend
        along += trend * excess[i]
        largest = max(largest, abs(trend))
    has_mean = largest > 0.5 * params.cusum_limit or state.drags != 0
    if not has_mean or size < _EXCESS_MPS**2 or along < _ALONG * math.sqrt(size * sums):
        return
    part = min(1.0, math.sqrt(possible / size))
    for i in range(3):
        excess[i] *= part
    doubts, size = fusion.doubts, part * math.sqrt(size)
    quat.transform_back_into(fusion.filters.akf.x[0:4], excess, doubts.velocity)
    # a wrong velocity has moved the chaser, and its innovations the disturbance
    for i in range(3):
        doubts.position[i] = elementary.hypot(doubts.position[i], _FOUND_S * doubts.velocity[i])
    doubts.acts, doubts.across, doubts.disturbance = 1, _ACROSS * size, size / _DISTURBED_S
    fill(excess, 0.0)
    fusion.thrust.spread, state.drags = _UNKNOWN_M2PS2, 0  # corrections are now those of filters that converge
    fusion.thrust.jumped = fusion.cycle
    for i in range(SUMS):
        if i < 3 or i >= 6:
            state.high[i] = state.low[i] = 0.0
