"""Speed profiles along a path, rest to rest."""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.maths import stack


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
        to_go_s = t_up + t_cruise + t_down - t_s
        out[0], out[1], out[2] = length - 0.5 * deceleration * to_go_s * to_go_s, deceleration * to_go_s, -deceleration
    else:
        out[0], out[1], out[2] = length, 0.0, 0.0


@kernel
def _path_integral(length, speed, acceleration, deceleration, t_s):
    """Return the integral of the path length of ``along_line`` up to ``t_s``, m s."""
    if t_s <= 0.0:
        return 0.0
    inverse = 1.0 / acceleration + 1.0 / deceleration
    peak = min(speed, math.sqrt(2.0 * length / inverse))
    t_up, t_down = peak / acceleration, peak / deceleration
    t_cruise = (length - 0.5 * peak * (t_up + t_down)) / peak if peak > 0.0 else 0.0
    rising = min(t_s, t_up)
    cruising = min(max(0.0, t_s - t_up), t_cruise)
    braking = min(max(0.0, t_s - t_up - t_cruise), t_down)
    standing = max(0.0, t_s - t_up - t_cruise - t_down)
    to_go_s = t_down - braking
    return (
        acceleration * rising**3 / 6.0
        + 0.5 * peak * (t_up + cruising) * cruising
        + length * braking
        - deceleration * (t_down**3 - to_go_s**3) / 6.0
        + length * standing
    )


@kernel
def along_smooth_line(length, speed, acceleration, deceleration, window_s, t_s, out):
    """Write path length, m, and its rate, m/s, at ``t_s`` to ``out`` (2,): mean of ``along_line`` over ``window_s``.

    The jerk is at most the sum of both accelerations over ``window_s``, and the move ends by ``window_s`` later.
    """
    along = stack.vector(3)
    along_line(length, speed, acceleration, deceleration, t_s, along)
    out[0], out[1] = along[0], along[1]
    if window_s > 0.0:
        behind = t_s - window_s
        out[0] = _path_integral(length, speed, acceleration, deceleration, t_s)
        out[0] = (out[0] - _path_integral(length, speed, acceleration, deceleration, behind)) / window_s
        out[1] = along[0] / window_s
        along_line(length, speed, acceleration, deceleration, behind, along)
        out[1] -= along[0] / window_s


@kernel
def duration(length, speed, acceleration, deceleration):
    """Return the duration of ``along_line`` over ``length``, s."""
    inverse = 1.0 / acceleration + 1.0 / deceleration
    peak = min(speed, math.sqrt(2.0 * length / inverse))
    if peak <= 0.0:
        return 0.0
    ramps = peak * inverse
    return ramps + (length - 0.5 * peak * ramps) / peak
