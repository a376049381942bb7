"""Relative motion about a target on an ellipse, linear in range over orbit radius, in the target's orbital frame H.

Source: Yamanaka and Ankersen, New State Transition Matrix for Relative Motion on an Arbitrary Elliptical Orbit, Journal
of Guidance, Control, and Dynamics 25 (2002), eq. (74) to (88). Their axes are those of H: x along the horizontal
velocity, y against the orbit normal, z to the central body.
"""

from __future__ import annotations

import math

import numpy as np

from hil.maths.kepler import mean_anomaly, true_anomaly


def transition(mean_motion: float, eccentricity: float, nu: float, t_s: float) -> np.ndarray:
    """Return the transition matrix (6, 6) of [r, v] in H over ``t_s``, from the true anomaly ``nu``, rad, on.

    mean_motion: rad/s, not zero. eccentricity: 0 to below 0.1.
    """
    m0 = mean_anomaly(eccentricity, nu)
    start, end = true_anomaly(eccentricity, m0), true_anomaly(eccentricity, m0 + mean_motion * t_s)
    k_squared = mean_motion / (1.0 - eccentricity**2) ** 1.5  # h / p^2
    solutions = np.linalg.solve(
        _solutions(eccentricity, start, 0.0).T, _solutions(eccentricity, end, k_squared * t_s).T
    ).T
    moved: np.ndarray = solutions @ _scaled(eccentricity, start, k_squared)
    return np.asarray(np.linalg.solve(_scaled(eccentricity, end, k_squared), moved))


def _scaled(e: float, nu: float, k_squared: float) -> np.ndarray:
    """Return the matrix (6, 6) to the scaled state: rho r, and its derivative by the true anomaly."""
    rho = 1.0 + e * math.cos(nu)
    whole = np.zeros((6, 6))
    whole[:3, :3] = rho * np.eye(3)
    whole[3:, :3] = -e * math.sin(nu) * np.eye(3)
    whole[3:, 3:] = np.eye(3) / (k_squared * rho)
    return whole


def _solutions(e: float, nu: float, j: float) -> np.ndarray:
    """Return six independent solutions (6, 6) of the scaled motion, one per column; j: h / p^2 times the time."""
    rho = 1.0 + e * math.cos(nu)
    s, c = rho * math.sin(nu), rho * math.cos(nu)
    ds, dc = math.cos(nu) + e * math.cos(2.0 * nu), -(math.sin(nu) + e * math.sin(2.0 * nu))
    found = np.zeros((6, 6))
    found[0, :4] = 1.0, -c * (1.0 + 1.0 / rho), s * (1.0 + 1.0 / rho), 3.0 * rho**2 * j
    found[2, :4] = 0.0, s, c, 2.0 - 3.0 * e * s * j
    found[3, :4] = 0.0, 2.0 * s, 2.0 * c - e, 3.0 * (1.0 - 2.0 * e * s * j)
    found[5, :4] = 0.0, ds, dc, -3.0 * e * (ds * j + s / rho**2)
    found[1, 4:] = math.cos(nu), math.sin(nu)
    found[4, 4:] = -math.sin(nu), math.cos(nu)
    return found
