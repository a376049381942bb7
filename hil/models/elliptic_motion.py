"""Relative motion about a target on an ellipse, linear in range over orbit radius, in the target's orbital frame H.

Source: Yamanaka and Ankersen, New State Transition Matrix for Relative Motion on an Arbitrary Elliptical Orbit, Journal
of Guidance, Control, and Dynamics 25 (2002), eq. (74) to (88). Their axes are those of H: x along the horizontal
velocity, y against the orbit normal, z to the central body. On a circle it is the motion of Clohessy and Wiltshire.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary, stack
from hil.maths.kepler import mean_anomaly, true_anomaly


def transition(mean_motion: float, eccentricity: float, nu: float, t_s: float) -> np.ndarray:
    """Return the transition matrix (6, 6) of [r, v] in H over ``t_s``, from the true anomaly ``nu``, rad, on.

    mean_motion: rad/s, not zero. eccentricity: 0 to 0.7.
    """
    out = np.empty((6, 6))
    transition_into(mean_motion, eccentricity, mean_anomaly(eccentricity, nu), t_s, out)
    return out


@kernel
def transition_into(mean_motion, eccentricity, m, t_s, out):
    """Write the matrix of ``transition`` to ``out`` (6, 6); m: mean anomaly at its begin, rad."""
    e, square = eccentricity, 1.0 - eccentricity * eccentricity
    k_squared = mean_motion / (square * math.sqrt(square))  # h / p^2
    start, end = true_anomaly(e, m), true_anomaly(e, m + mean_motion * t_s)
    rho, last_rho = 1.0 + e * elementary.cos(start), 1.0 + e * elementary.cos(end)
    s, c = rho * elementary.sin(start), rho * elementary.cos(start)
    scaled, constants, moved = stack.vector(6), stack.vector(4), stack.vector(6)
    for column in range(6):
        for i in range(6):  # rho r, and its derivative by the true anomaly
            scaled[i] = 0.0
        if column < 3:
            scaled[column], scaled[3 + column] = rho, -e * elementary.sin(start)
        else:
            scaled[column] = 1.0 / (k_squared * rho)
        x, z, vx, vz = scaled[0], scaled[2], scaled[3], scaled[5]
        constants[0] = (
            x
            + (3.0 * e * s * (1.0 / rho + 1.0 / rho**2) * z - e * s * (1.0 + 1.0 / rho) * vx + (2.0 - e * c) * vz)
            / square
        )
        constants[1] = (
            -3.0 * s * (1.0 / rho + e * e / rho**2) * z + s * (1.0 + 1.0 / rho) * vx + (c - 2.0 * e) * vz
        ) / square
        constants[2] = (-3.0 * (c / rho + e) * z + (c * (1.0 + 1.0 / rho) + e) * vx - s * vz) / square
        constants[3] = ((3.0 * rho + e * e - 1.0) * z - rho**2 * vx + e * s * vz) / square
        _in_plane(e, end, k_squared * t_s, constants, moved)
        cos, sin = elementary.cos(end - start), elementary.sin(end - start)
        moved[1] = cos * scaled[1] + sin * scaled[4]
        moved[4] = cos * scaled[4] - sin * scaled[1]
        for i in range(3):
            out[i, column] = moved[i] / last_rho
            out[3 + i, column] = k_squared * (last_rho * moved[3 + i] + e * elementary.sin(end) * moved[i])


@kernel
def _in_plane(e, nu, j, constants, out):
    """Write x, z and their derivatives by nu of the scaled motion with four ``constants`` to ``out`` (6,).

    j: h / p^2 times the time since the start.
    """
    rho = 1.0 + e * elementary.cos(nu)
    s, c = rho * elementary.sin(nu), rho * elementary.cos(nu)
    ds, dc = elementary.cos(nu) + e * elementary.cos(2.0 * nu), -(elementary.sin(nu) + e * elementary.sin(2.0 * nu))
    k1, k2, k3, k4 = constants[0], constants[1], constants[2], constants[3]
    out[0] = k1 - c * (1.0 + 1.0 / rho) * k2 + s * (1.0 + 1.0 / rho) * k3 + 3.0 * rho**2 * j * k4
    out[2] = s * k2 + c * k3 + (2.0 - 3.0 * e * s * j) * k4
    out[3] = 2.0 * s * k2 + (2.0 * c - e) * k3 + 3.0 * (1.0 - 2.0 * e * s * j) * k4
    out[5] = ds * k2 + dc * k3 - 3.0 * e * (ds * j + s / rho**2) * k4
