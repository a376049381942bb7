"""Rotating frame: rate of a body that tumbles without torque, and accelerations in its axes.

The rate is the closed solution of Euler's equations for any principal moments (Landau and Lifshitz, Mechanics, 37):
each principal component is an elliptic function of time. ``hil.params.target`` computes its constants.
"""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel
from hil.maths import stack
from hil.maths.arrays import cross_into
from hil.maths.special import STEPS, jacobi_into

TUMBLE = np.dtype(
    [
        ("rotates", "i8"),  # 1: the frame is that of a body that tumbles; 0: the Hill frame
        ("amplitude", "f8", (3, 3)),  # rad/s, columns: vectors in the body's axes that sn, cn and dn multiply
        ("frequency", "f8"),  # rad/s, of the functions' argument
        ("phase", "f8"),  # argument at the start of the run
        ("parameter", "f8"),  # m, the square of the modulus
        ("moduli", "f8", STEPS),  # of it, ``landen_moduli``
        ("steps", "i8"),  # their number
    ],
    align=True,
)


@kernel
def tumble_rate(tumble, t_s, rate, rate_of_change):
    """Write the rate (3,), rad/s, and its rate of change (3,), rad/s^2, in the body's axes at ``t_s`` of the run."""
    f = stack.vector(3)
    jacobi_into(tumble.phase + tumble.frequency * t_s, tumble.moduli, tumble.steps, f)
    sn, cn, dn = f[0], f[1], f[2]
    ds, dc, dd = cn * dn, -sn * dn, -tumble.parameter * sn * cn
    for i in range(3):
        a, b, c = tumble.amplitude[i, 0], tumble.amplitude[i, 1], tumble.amplitude[i, 2]
        rate[i] = a * sn + b * cn + c * dn
        rate_of_change[i] = tumble.frequency * (a * ds + b * dc + c * dd)


@kernel
def euler_acceleration(moments, rate, out):
    """Write the torque-free rate of change (3,), rad/s^2, of ``rate`` (3,), both in principal axes."""
    out[0] = (moments[1] - moments[2]) / moments[0] * rate[1] * rate[2]
    out[1] = (moments[2] - moments[0]) / moments[1] * rate[2] * rate[0]
    out[2] = (moments[0] - moments[1]) / moments[2] * rate[0] * rate[1]


@kernel
def frame_acceleration(rate, rate_of_change, r, v, out):
    """Write the acceleration, m/s^2, that a motion in a rotating frame needs beyond its own into ``out`` (3,).

    ``2 w x v + w x (w x r) + w' x r``. rate, rate_of_change: of the frame. r, v: m and m/s, in its axes. All (3,).
    """
    wr, wwr, wv, er = stack.vector(3), stack.vector(3), stack.vector(3), stack.vector(3)
    cross_into(rate, r, wr)
    cross_into(rate, wr, wwr)
    cross_into(rate, v, wv)
    cross_into(rate_of_change, r, er)
    for i in range(3):
        out[i] = 2.0 * wv[i] + wwr[i] + er[i]
