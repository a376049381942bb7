"""What is wrong with real thrusters: each points a little aside and pushes a little more or less than it should."""

from __future__ import annotations

import numpy as np

from hil.messages import Array

DRAWS_A_THRUSTER = 3  # standard normals: two tilts, one force


def as_built(
    direction: Array, force_n: Array, tilt_sigma: float, force_sigma: float, draws: Array
) -> tuple[Array, Array]:
    """Return direction (n, 3) and force (n,), N, of the thrusters as they are built.

    direction: (n, 3), unit vectors. force_n: (n,). tilt_sigma: rad, about each of two axes at right angles to the
    thrust. force_sigma: 1 sigma over the nominal force. draws: standard normals, (n, 3). A force is never negative.
    """
    built = np.empty_like(direction)
    for j, nominal in enumerate(direction):
        first = np.cross(nominal, np.eye(3)[int(np.argmin(np.abs(nominal)))])
        first /= np.linalg.norm(first)
        aside = draws[j, 0] * first + draws[j, 1] * np.cross(nominal, first)
        size = float(np.linalg.norm(aside))
        angle = tilt_sigma * size
        built[j] = nominal if angle == 0.0 else np.cos(angle) * nominal + np.sin(angle) * aside / size
    return built, force_n * np.maximum(0.0, 1.0 + force_sigma * draws[:, 2])
