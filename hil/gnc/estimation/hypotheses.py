"""What may explain innovations that are not those of their covariance, before a device is named.

The reaction does not wait for a name. The vision unit is named if nothing that the IMU has shown by itself explains the
innovations as well: a chaser that swings by a flexible mode or slosh, a disturbance that has changed such as a leak, an
accelerometer that reads other than the commands along the corrections of the velocity. Nor is it named for a mean of
the attitude alone, which an ephemeris or gyros that are wrong leave as well, nor, where the budget has noise that is
correlated, for what such noise does if it is more or lasts longer than the budget's.
"""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.gnc.estimation.integrity import CAUSE_UNKNOWN, VISION_LOST, VISION_SUSPECT

NONE, NAMED, SWING, DISTURBANCE, SCALE, ATTITUDE, READINGS, COMMANDS, CORRELATED = range(9)
"""Hypothesis of an inconsistency: none seen, the vision unit, or what explains it as well. READINGS: the IMU and the
commands contradict each other, and the evidence names no device. COMMANDS: they replace the IMU. CORRELATED: noise."""
_RECENT_S = 60.0  # after which a swing or a change of the disturbance explains nothing any more
_EXCESS_MPS = 1e-3  # from which on accelerometer and commands differ
_CORRELATED = 2.0  # sums or corrections of the velocity over their limits, up to which such noise explains them
_ALONG = 0.8  # cosine of the angle between this difference and the corrections of the velocity


@kernel
def _is_along(excess, corrected):
    """Return whether the poses have taken the ``excess`` (3,), m/s, of the accelerometer back by ``corrected`` (3,)."""
    size, total, product = 0.0, 0.0, 0.0
    for i in range(3):
        size += excess[i] ** 2
        total += corrected[i] ** 2
        product -= excess[i] * corrected[i]
    return size > _EXCESS_MPS**2 and product > _ALONG * math.sqrt(size * total)


@kernel
def _explains(params, state, fusion, fraction, dt_s):
    """Return the hypothesis that explains an inconsistency as well as the vision unit, otherwise ``NAMED``."""
    thrust, turns, moves = fusion.thrust, 0.0, 0.0
    if thrust.without_imu == 1:
        return COMMANDS
    if thrust.swing.until > 0 and (fusion.cycle - thrust.swing.until) * dt_s < _RECENT_S:
        return SWING
    if state.worst_of < 3 and thrust.swing.halves[state.worst_of] > 0:  # slosh shows itself once, firings move it again
        return SWING
    if thrust.jumped > 0 and (fusion.cycle - thrust.jumped) * dt_s < _RECENT_S:
        return DISTURBANCE
    if thrust.without_imu == 0 and _is_along(thrust.excess_C, fusion.corrected):
        return SCALE
    for i in range(state.high.shape[0]):
        larger = max(state.high[i], state.low[i])
        if 3 <= i < 6:
            turns = max(turns, larger)
        else:
            moves = max(moves, larger)
    if state.biased != 0 and state.drags == 0 and moves < 0.5 * turns:
        return ATTITUDE
    # neither poses that are rejected nor a mean NIS that is too large
    has_mean = (state.biased != 0 or state.drags != 0) and fusion.rejected_in_a_row < params.suspect_after
    return CORRELATED if fraction > 0.0 and has_mean and max(state.peak, state.dragged) < _CORRELATED else NAMED


@kernel
def name_cause(params, state, fusion, fraction, dt_s, health):
    """Return ``health``, in which an inconsistency that is not the vision unit's alone has an unknown cause.

    params, state, fusion: INTEGRITY_PARAMS, INTEGRITY_STATE, FUSION_STATE. fraction: of the noise, correlated. dt_s: of
    a step of the filters. The cause is that of its first cycle, but for noise, which explains no more than it can.
    """
    if health & VISION_SUSPECT == 0:
        state.cause = NONE
        return health
    if state.cause == NONE or state.cause == CORRELATED:
        state.cause = _explains(params, state, fusion, fraction, dt_s)
    if state.cause == NAMED:
        return health
    rejected = VISION_LOST if fusion.rejected_in_a_row > 0 else 0  # the poses, not the unit, are lost
    return (health & ~(VISION_SUSPECT | rejected)) | CAUSE_UNKNOWN
