"""Covariances of filters in plain loops: no library call, no heap. States: up to MAX_STATES, else ValueError.

A product is summed up row by row, ``row += a[i, m] * b[m]``: the inner loop runs along memory without a chain
of sums, and zeros in ``a``, most of a transition, are skipped.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky, stack

MAX_STATES: Final = 12
"""Of any filter; a larger one would not fit on the stack."""
_ASYMMETRY_MAX = 1e-6  # relative to the standard deviations


@kernel
def propagate_covariance(p, phi, noise):
    """Replace ``p`` by ``phi p phi.T + noise``; all (n, n), ``p`` and ``noise`` symmetric."""
    n = p.shape[0]
    if n > MAX_STATES:
        raise ValueError("too many states")
    row = stack.vector(MAX_STATES)
    turned = stack.matrix(MAX_STATES, MAX_STATES)  # (phi p).T
    for i in range(n):
        for j in range(n):
            row[j] = 0.0
        for m in range(n):
            factor = phi[i, m]
            if factor != 0.0:
                for j in range(n):
                    row[j] += factor * p[m, j]
        for j in range(n):
            turned[j, i] = row[j]
    for i in range(n):
        for j in range(n):
            row[j] = noise[i, j]
        for m in range(n):
            factor = phi[i, m]
            if factor != 0.0:
                for j in range(n):
                    row[j] += factor * turned[m, j]
        for j in range(i, n):
            p[i, j] = row[j]
            p[j, i] = row[j]


@kernel
def is_covariance_3(p, sigma_max):
    """Return whether ``p`` (3, 3) is finite, symmetric and positive definite, with no sigma above ``sigma_max``."""
    limit = sigma_max * sigma_max
    for i in range(3):
        if not 0.0 < p[i, i] <= limit:
            return False
        for j in range(i):
            if not abs(p[i, j] - p[j, i]) <= _ASYMMETRY_MAX * math.sqrt(p[i, i] * p[j, j]):
                return False
    a = p[0, 1] / math.sqrt(p[0, 0] * p[1, 1])
    b = p[0, 2] / math.sqrt(p[0, 0] * p[2, 2])
    c = p[1, 2] / math.sqrt(p[1, 1] * p[2, 2])
    return 1.0 - a * a > 0.0 and 1.0 + 2.0 * a * b * c - a * a - b * b - c * c > 0.0


@kernel
def invert_symmetric_3(s, out):
    """Write the inverse of the symmetric ``s`` (3, 3) by its cofactors; return whether it is positive definite."""
    c00 = s[1, 1] * s[2, 2] - s[1, 2] * s[1, 2]
    c01 = s[0, 2] * s[1, 2] - s[0, 1] * s[2, 2]
    c02 = s[0, 1] * s[1, 2] - s[0, 2] * s[1, 1]
    det = s[0, 0] * c00 + s[0, 1] * c01 + s[0, 2] * c02
    out[0, 0] = c00 / det
    out[0, 1] = out[1, 0] = c01 / det
    out[0, 2] = out[2, 0] = c02 / det
    out[1, 1] = (s[0, 0] * s[2, 2] - s[0, 2] * s[0, 2]) / det
    out[1, 2] = out[2, 1] = (s[0, 1] * s[0, 2] - s[0, 0] * s[1, 2]) / det
    last = s[0, 0] * s[1, 1] - s[0, 1] * s[0, 1]
    out[2, 2] = last / det
    return 0.0 < s[0, 0] < np.inf and last > 0.0 and 0.0 < det < np.inf


@kernel
def inverse_root_3(s, out):
    """Write the lower triangle W with ``W.T W`` the inverse of the symmetric ``s`` (3, 3), whose root is ``W^-1``."""
    w00 = 1.0 / math.sqrt(s[0, 0])
    a, b = s[1, 0] * w00, s[2, 0] * w00
    w11 = 1.0 / math.sqrt(s[1, 1] - a * a)
    c = (s[2, 1] - a * b) * w11
    w22 = 1.0 / math.sqrt(s[2, 2] - b * b - c * c)
    out[0, 0], out[0, 1], out[0, 2] = w00, 0.0, 0.0
    out[1, 0], out[1, 1], out[1, 2] = -a * w00 * w11, w11, 0.0
    out[2, 0], out[2, 1], out[2, 2] = (a * c * w11 - b) * w00 * w22, -c * w11 * w22, w22


@kernel
def normalised_square(error, p):
    """Return ``error.T p^-1 error`` for a positive definite ``p`` (n, n), by Cholesky; nan if it is not."""
    n = error.shape[0]
    if n > MAX_STATES:
        raise ValueError("too many states")
    low, y = stack.matrix(MAX_STATES, MAX_STATES), stack.vector(MAX_STATES)
    if not cholesky.factor(p, n, low):
        return np.nan
    total = 0.0
    for i in range(n):
        s = error[i]
        for m in range(i):
            s -= low[i, m] * y[m]
        y[i] = s / low[i, i]
        total += y[i] * y[i]
    return total
