"""Docking decision: a go is the promise that the chaser stays within Table III for a time.

A go is given when the ready state has held on the estimate for the dwell time and control can hold it for the time of
a go. Once given it stays as long as deviation and level are within Table III together: the promise is not tested again,
so that a go does not end by noise. The check notes what was missing last: ``approach_events`` has the texts.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.limits import has_held

GO, DEVIATION, HEALTH, LEVEL, ENCODERS, UNBOUNDED, FIRING, SUM, HOLD = range(9)
"""What an estimate lacks for a go, GO if nothing. UNBOUNDED: a protection level exceeds its alert limit. FIRING: the
smallest firing is too large a part of the required rate. SUM: innovations of the poses sum up. HOLD: control holds the
axis within a larger error."""

GO_CHECK = np.dtype(
    [
        ("level_m", "f8", 3),  # of the navigation, with the risk of a go; 0: it has none
        ("sum", "f8"),  # largest CUSUM of the innovations, standard deviations, its number and its limit for a go
        ("sum_of", "i8"),
        ("sum_limit", "f8"),
        ("known", "i8"),  # 1: the estimate has been compared with the encoders
        ("off", "f8", 6),  # mean of estimate minus encoders: position in H, m, rotation in c, rad
        ("firing", "f8", 6),  # m/s, rad/s: smallest change of each rate by a firing
        ("hold", "f8", 6),  # m, rad: largest error of each axis with which control holds it; 0: unknown
        ("near", "i8"),  # 1: the estimate is within Table III
        ("given", "i8"),  # 1: docking is a go
        ("lacks", "i8"),
        ("axis", "i8"),  # x, y, z, then the rotations, the velocities, the rates; of SUM the number of the sum
        ("value", "f8"),  # m, rad, m/s, rad/s; of SUM standard deviations, of HEALTH its bits
        ("limit", "f8"),
    ],
    align=True,
)
"""What a go requires beyond the ready state of the estimate, and what was missing last."""


@kernel
def _lack(go, what, axis, value, limit):
    """Write what is missing for a go."""
    go.lacks, go.axis, go.value, go.limit = what, axis, value, limit
    return False


@kernel
def _is_ready(params, estimate, beyond, rotation, go):
    """Return whether the estimate is healthy, protected and within Table III, each axis alone.

    beyond: 1 if a protection level exceeds its alert limit. rotation: (3,), written, rotation vector of the attitude.
    """
    go.near = 0
    for i in range(3):
        deviation = abs(estimate.r_CT_H[i] - params.ready_point[i])
        if not deviation <= params.ready_distance[i]:
            return _lack(go, DEVIATION, i, deviation, params.ready_distance[i])
        if not abs(estimate.v_CT_H[i]) <= params.ready_rate[i]:
            return _lack(go, DEVIATION, 6 + i, abs(estimate.v_CT_H[i]), params.ready_rate[i])
        if not abs(estimate.w_CH_C[i]) <= params.ready_angular_rate:
            return _lack(go, DEVIATION, 9 + i, abs(estimate.w_CH_C[i]), params.ready_angular_rate)
    quat.to_rotation_vector_into(estimate.q_CH, rotation)
    for i in range(3):
        if not abs(rotation[i]) <= params.ready_angle:
            return _lack(go, DEVIATION, 3 + i, abs(rotation[i]), params.ready_angle)
    go.near = 1
    if estimate.health != 0:
        return _lack(go, HEALTH, 0, estimate.health, 0.0)
    return True if beyond == 0 else _lack(go, UNBOUNDED, 0, 0.0, 0.0)


@kernel
def _is_certain(params, estimate, beyond, rotation, go):
    """Return whether the ready state is certain enough for a go; ``go`` (GO_CHECK) then has what is missing.

    The level of the certificate's risk and the deviation have to be within Table III together, and the encoders'
    pose, the estimate less its mean error, within a part of it, which leaves room for the control error: of a go that
    is given the middle between that part and all.
    """
    if not _is_ready(params, estimate, beyond, rotation, go):
        return False
    if go.sum > go.sum_limit:
        return _lack(go, SUM, go.sum_of, go.sum, go.sum_limit)
    fraction = params.go_fraction if go.given == 0 else 0.5 * (1.0 + params.go_fraction)
    for i in range(3):
        deviation, level = estimate.r_CT_H[i] - params.ready_point[i], go.level_m[i]
        if estimate.sigma_r_m[i] > 0.0:
            level = max(level, params.go_sigmas * estimate.sigma_r_m[i])
        if not abs(deviation) + level <= params.ready_distance[i]:
            return _lack(go, LEVEL, i, abs(deviation) + level, params.ready_distance[i])
        if estimate.sigma_v_mps[i] > 0.0:
            speed = abs(estimate.v_CT_H[i]) + params.go_sigmas * estimate.sigma_v_mps[i]
            if not speed <= params.ready_rate[i]:
                return _lack(go, LEVEL, 6 + i, speed, params.ready_rate[i])
        if estimate.sigma_attitude_rad[i] > 0.0:
            angle = abs(rotation[i]) + params.go_sigmas * estimate.sigma_attitude_rad[i]
            if not angle <= params.ready_angle:
                return _lack(go, LEVEL, 3 + i, angle, params.ready_angle)
        if go.known != 0:
            allowed = fraction * params.ready_distance[i]
            if not abs(deviation - go.off[i]) <= allowed:
                return _lack(go, ENCODERS, i, abs(deviation - go.off[i]), allowed)
            allowed = fraction * params.ready_angle
            if not abs(rotation[i] - go.off[3 + i]) <= allowed:
                return _lack(go, ENCODERS, 3 + i, abs(rotation[i] - go.off[3 + i]), allowed)
    go.lacks = GO
    return True


@kernel
def _is_held(params, go, estimate):
    """Return whether control can hold the ready state: a smallest firing from rest keeps the rate, the error its limit.

    A firing may take a part of the rate: arrays that swing, and the rate before it, add to it.
    The error with which an axis is held and the level of the estimate have to be within Table III together.
    """
    turn = params.go_fraction * params.ready_angular_rate
    for i in range(3):
        allowed = params.go_fraction * params.ready_rate[i]
        if not go.firing[i] <= allowed:
            return _lack(go, FIRING, 6 + i, go.firing[i], allowed)
        if not go.firing[3 + i] <= turn:
            return _lack(go, FIRING, 9 + i, go.firing[3 + i], turn)
        if not go.hold[i] + go.level_m[i] <= params.ready_distance[i]:
            return _lack(go, HOLD, i, go.hold[i] + go.level_m[i], params.ready_distance[i])
        sigma = estimate.sigma_attitude_rad[i]
        angle = go.hold[3 + i] + (params.go_sigmas * sigma if sigma > 0.0 else 0.0)
        if not angle <= params.ready_angle:
            return _lack(go, HOLD, 3 + i, angle, params.ready_angle)
    return True


@kernel
def update(params, t_s, estimate, beyond, go, supervision):
    """Write since when the ready state holds, ``supervision.ready_since_s``, nan if it does not, and ``go.given``.

    params: APPROACH_MONITOR_PARAMS. estimate: NAVIGATION, valid. Other arguments: see ``_is_ready``.
    """
    rotation = stack.vector(3)
    holds = _is_certain(params, estimate, beyond, rotation, go) and (go.given != 0 or _is_held(params, go, estimate))
    if not holds:
        supervision.ready_since_s = np.nan
        go.given = 0
        return
    if not supervision.ready_since_s <= t_s:
        supervision.ready_since_s = t_s
    go.given = 1 if has_held(supervision.ready_since_s, t_s, params.dwell_s) else 0
