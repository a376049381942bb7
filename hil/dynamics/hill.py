"""Relative motion in the target's orbital frame H, linear in range over orbit radius.

H: x along velocity, y = minus orbit normal, z to the central body; ``omega_H = [0, -w0, 0]`` in H.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary
from hil.maths.elementary import square


@kernel
def hill_acceleration(r_CT_H, v_CT_H, w0, out):
    """Write the free relative acceleration in H, (3,), m/s^2 (bench paper eq. (11)); w0 in rad/s."""
    out[0] = 2.0 * w0 * v_CT_H[2]
    out[1] = -w0 * w0 * r_CT_H[1]
    out[2] = -2.0 * w0 * v_CT_H[0] + 3.0 * w0 * w0 * r_CT_H[2]


def transition(w0: float, t_s: float) -> np.ndarray:
    """Return the exact transition matrix (6, 6) of [r, v] in H over ``t_s`` (Clohessy and Wiltshire 1960).

    w0: orbital rate, rad/s, not zero.
    """
    c, s, a = elementary.cos(w0 * t_s), elementary.sin(w0 * t_s), w0 * t_s
    return np.array(
        [
            [1.0, 0.0, 6.0 * (a - s), 4.0 * s / w0 - 3.0 * t_s, 0.0, 2.0 * (1.0 - c) / w0],
            [0.0, c, 0.0, 0.0, s / w0, 0.0],
            [0.0, 0.0, 4.0 - 3.0 * c, -2.0 * (1.0 - c) / w0, 0.0, s / w0],
            [0.0, 0.0, 6.0 * w0 * (1.0 - c), 4.0 * c - 3.0, 0.0, 2.0 * s],
            [0.0, -w0 * s, 0.0, 0.0, c, 0.0],
            [0.0, 0.0, 3.0 * w0 * s, -2.0 * s, 0.0, c],
        ]
    )


def input_response(w0: float, t_s: float) -> np.ndarray:
    """Return Psi (6, 3): what a constant acceleration in H, m/s^2, adds to [r, v] over ``t_s``.

    The integral over ``t_s`` of the last three columns of ``transition``.
    """
    s, a = elementary.sin(w0 * t_s), w0 * t_s
    versine = 2.0 * square(elementary.sin(0.5 * a))  # 1 - cos, without its cancellation over a short step
    xx = 4.0 * versine / square(w0) - 1.5 * square(t_s)
    xz = 2.0 * _angle_less_sine(a) / square(w0)
    xdot_x = 4.0 * s / w0 - 3.0 * t_s
    xdot_z = 2.0 * versine / w0
    zz = versine / square(w0)
    return np.array(
        [
            [xx, 0.0, xz],
            [0.0, zz, 0.0],
            [-xz, 0.0, zz],
            [xdot_x, 0.0, xdot_z],
            [0.0, s / w0, 0.0],
            [-xdot_z, 0.0, s / w0],
        ]
    )


def _angle_less_sine(a: float) -> float:
    """Return a - sin(a), by its series where the difference would cancel."""
    if abs(a) > 0.1:
        return a - elementary.sin(a)
    return a * square(a) / 6.0 * (1.0 - square(a) / 20.0 * (1.0 - square(a) / 42.0 * (1.0 - square(a) / 72.0)))
