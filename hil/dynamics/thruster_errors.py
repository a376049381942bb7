"""What is wrong with real thrusters: each points a little aside and pushes a little more or less than it should."""

from __future__ import annotations

import numpy as np

from hil.core.messages import Array

DRAWS_A_THRUSTER = 3  # standard normals: two tilts, one force


def as_built(
    direction: Array, force_n: Array, tilt_sigma: float, force_sigma: float, draws: Array
) -> tuple[Array, Array]:
    """Return direction (n, 3) and force (n,), N, of the thrusters as they are built.

    direction: (n, 3), unit vectors. force_n: (n,). tilt_sigma: rad, about each of two axes at right angles to the
    thrust. force_sigma: 1 sigma over the nominal force. draws: standard normals, (n, 3). A force is never negative.
    """
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin(axis=1)])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    aside = draws[:, 0:1] * first + draws[:, 1:2] * np.cross(direction, first)
    size = np.linalg.norm(aside, axis=1, keepdims=True)
    angle = tilt_sigma * size
    turned = np.cos(angle) * direction + np.sin(angle) * aside / np.where(size > 0.0, size, 1.0)
    built = np.where(angle == 0.0, direction, turned)
    return built, force_n * np.maximum(0.0, 1.0 + force_sigma * draws[:, 2])
