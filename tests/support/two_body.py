"""Two bodies about a point mass, integrated apart in inertial axes: the truth for relative motion on an ellipse."""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

from hil.dynamics import orbit

GM, AXIS_M = 4.9028e12, 1938e3
N = math.sqrt(GM / AXIS_M**3)
ORBIT_S = 2.0 * math.pi / N


def frame(r: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the matrix to H and its rate (3,), rad/s, in H, of a target on a two-body orbit."""
    a, rate = np.empty((3, 3)), np.empty(3)
    orbit.hill_frame(r, v, a)
    orbit.hill_rate(r, v, -GM * r / np.linalg.norm(r) ** 3, a, rate)
    return a, rate


def two_body(
    e: float,
    nu: float,
    start: np.ndarray,
    t_s: float,
    thrust: Callable[[float], np.ndarray] | None = None,
    steps: np.ndarray | None = None,
) -> np.ndarray:
    """Return [r, v] in H after ``t_s``. thrust: acceleration of the chaser in H, m/s^2, with jumps at ``steps``, s."""
    r, v = orbit.state_of_elements(GM, AXIS_M, e, 1.0, 0.5, 0.2, nu)
    a, rate = frame(r, v)
    state = np.concatenate([r, v, r + a.T @ start[:3], v + a.T @ (start[3:] + np.cross(rate, start[:3]))])

    def slope(t: float, y: np.ndarray) -> np.ndarray:
        pull = [-GM * y[k : k + 3] / np.linalg.norm(y[k : k + 3]) ** 3 for k in (0, 6)]
        if thrust is not None:
            pull[1] = pull[1] + frame(y[:3], y[3:6])[0].T @ thrust(t)
        return np.concatenate([y[3:6], pull[0], y[9:], pull[1]])

    times = np.unique(np.concatenate([[0.0, t_s], [] if steps is None else steps]))
    for first, last in pairwise(times):
        state = solve_ivp(slope, (first, last), state, method="DOP853", rtol=1e-13, atol=1e-9).y[:, -1]
    a, rate = frame(state[:3], state[3:6])
    moved = a @ (state[6:9] - state[:3])
    return np.concatenate([moved, a @ (state[9:] - state[3:6]) - np.cross(rate, moved)])
