"""Speed profiles along a path, rest to rest."""

from __future__ import annotations

import math

from hil.core.jit import kernel


@kernel
def along_line(length, speed, acceleration, deceleration, t_s, out):
    """Write path length, m, its rate, m/s, and its second rate, m/s^2, at ``t_s`` to ``out`` (3,).

    Trapezoidal speed from rest to rest over ``length``; if that is too short to reach ``speed`` the peak is lower.
    Any unit of length may be used.
    """
    inverse = 1.0 / acceleration + 1.0 / deceleration
    peak = min(speed, math.sqrt(2.0 * length / inverse))
    t_up = peak / acceleration
    t_down = peak / deceleration
    t_cruise = (length - 0.5 * peak * (t_up + t_down)) / peak if peak > 0.0 else 0.0
    if t_s <= 0.0:
        out[0], out[1], out[2] = 0.0, 0.0, 0.0
    elif t_s < t_up:
        out[0], out[1], out[2] = 0.5 * acceleration * t_s * t_s, acceleration * t_s, acceleration
    elif t_s < t_up + t_cruise:
        out[0], out[1], out[2] = 0.5 * peak * t_up + peak * (t_s - t_up), peak, 0.0
    elif t_s < t_up + t_cruise + t_down:
        left = t_up + t_cruise + t_down - t_s
        out[0], out[1], out[2] = length - 0.5 * deceleration * left * left, deceleration * left, -deceleration
    else:
        out[0], out[1], out[2] = length, 0.0, 0.0


@kernel
def duration(length, speed, acceleration, deceleration):
    """Return the duration of ``along_line`` over ``length``, s."""
    inverse = 1.0 / acceleration + 1.0 / deceleration
    peak = min(speed, math.sqrt(2.0 * length / inverse))
    if peak <= 0.0:
        return 0.0
    ramps = peak * inverse
    return ramps + (length - 0.5 * peak * ramps) / peak
