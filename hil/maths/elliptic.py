"""Jacobi's elliptic functions."""

from __future__ import annotations

import math
from typing import Final

from hil.core.jit import kernel
from hil.maths import stack

_STEPS: Final = 10
_CONVERGED: Final = 1e-16


@kernel
def jacobi_into(u, m, out):
    """Write sn, cn and dn of ``u`` for the parameter ``m``, 0 to below 1, into ``out`` (3,).

    Descending Landen transformation by the arithmetic-geometric mean (Abramowitz and Stegun 1964, 16.4).
    """
    mean, half_difference = stack.vector(11), stack.vector(11)
    mean[0], other = 1.0, math.sqrt(1.0 - m)
    n, scale = 0, 1.0
    half_difference[0] = math.sqrt(m)
    while n < _STEPS and abs(half_difference[n]) > _CONVERGED * mean[n]:
        product = math.sqrt(mean[n] * other)
        half_difference[n + 1] = 0.5 * (mean[n] - other)
        mean[n + 1] = 0.5 * (mean[n] + other)
        other = product
        n += 1
        scale *= 2.0
    angle = scale * mean[n] * u
    while n > 0:
        angle = 0.5 * (angle + math.asin(half_difference[n] / mean[n] * math.sin(angle)))
        n -= 1
    out[0], out[1] = math.sin(angle), math.cos(angle)
    out[2] = math.sqrt(1.0 - m * out[0] * out[0])
