"""Eigenvalues of symmetric matrices of three rows."""

from __future__ import annotations

import math

from hil.core.jit import kernel
from hil.maths import elementary, stack


@kernel
def largest_eigenvalue(m):
    """Return the largest eigenvalue of the symmetric matrix ``m`` (3, 3), by the cubic's cosine (Smith 1961)."""
    mean = (m[0, 0] + m[1, 1] + m[2, 2]) / 3.0
    square = 2.0 * (m[0, 1] ** 2 + m[0, 2] ** 2 + m[1, 2] ** 2)
    for i in range(3):
        square += (m[i, i] - mean) ** 2
    scale = math.sqrt(square / 6.0)
    if not scale > 0.0:
        return mean
    b = stack.matrix(3, 3)
    for i in range(3):
        for j in range(3):
            b[i, j] = (m[i, j] - (mean if i == j else 0.0)) / scale
    half = 0.5 * (
        b[0, 0] * (b[1, 1] * b[2, 2] - b[1, 2] * b[2, 1])
        - b[0, 1] * (b[1, 0] * b[2, 2] - b[1, 2] * b[2, 0])
        + b[0, 2] * (b[1, 0] * b[2, 1] - b[1, 1] * b[2, 0])
    )
    return mean + 2.0 * scale * elementary.cos(elementary.acos(max(-1.0, min(1.0, half))) / 3.0)
