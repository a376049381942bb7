"""Kalman updates in plain loops: no library call, no heap. States: up to MAX_STATES, else ValueError.

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
def gain_of_three(p, h, r, gain, s_inverse):
    """Write the gain (n, 3) and the inverse innovation covariance (3, 3) of a three-component measurement.

    Return whether the latter is positive definite. p: (n, n). h: (3, n). r: (3, 3).
    """
    n = p.shape[0]
    if n > MAX_STATES:
        raise ValueError("too many states")
    ph, s = stack.matrix(MAX_STATES, 3), stack.matrix(3, 3)
    for i in range(n):
        for j in range(3):
            total = 0.0
            for m in range(n):
                total += p[i, m] * h[j, m]
            ph[i, j] = total
    for i in range(3):
        for j in range(3):
            total = r[i, j]
            for m in range(n):
                total += h[i, m] * ph[m, j]
            s[i, j] = total
    is_positive = invert_symmetric_3(s, s_inverse)
    for i in range(n):
        for j in range(3):
            gain[i, j] = ph[i, 0] * s_inverse[0, j] + ph[i, 1] * s_inverse[1, j] + ph[i, 2] * s_inverse[2, j]
    return is_positive


@kernel
def joseph(p, h, r, gain):
    """Replace ``p`` by ``(I - K H) p (I - K H).T + K R K.T``: symmetric and positive whatever the gain."""
    n = p.shape[0]
    if n > MAX_STATES:
        raise ValueError("too many states")
    a, noise = stack.matrix(MAX_STATES, MAX_STATES), stack.matrix(MAX_STATES, MAX_STATES)
    for i in range(n):
        for j in range(n):
            a[i, j] = -(gain[i, 0] * h[0, j] + gain[i, 1] * h[1, j] + gain[i, 2] * h[2, j])
        a[i, i] += 1.0
    for i in range(n):
        kr0 = gain[i, 0] * r[0, 0] + gain[i, 1] * r[1, 0] + gain[i, 2] * r[2, 0]
        kr1 = gain[i, 0] * r[0, 1] + gain[i, 1] * r[1, 1] + gain[i, 2] * r[2, 1]
        kr2 = gain[i, 0] * r[0, 2] + gain[i, 1] * r[1, 2] + gain[i, 2] * r[2, 2]
        for j in range(n):
            noise[i, j] = kr0 * gain[j, 0] + kr1 * gain[j, 1] + kr2 * gain[j, 2]
    propagate_covariance(p, a, noise)


@kernel
def update_three(x, p, h, r, innovation):
    """Fuse a three-component measurement into ``x`` (n,) and ``p`` (n, n), in place; return the NIS.

    h: (3, n). r: (3, 3). innovation: (3,), measured minus expected.
    """
    n = x.shape[0]
    if n > MAX_STATES:
        raise ValueError("too many states")
    gain, s_inverse = stack.matrix(MAX_STATES, 3), stack.matrix(3, 3)
    gain_of_three(p, h, r, gain, s_inverse)
    for i in range(n):
        x[i] += gain[i, 0] * innovation[0] + gain[i, 1] * innovation[1] + gain[i, 2] * innovation[2]
    joseph(p, h, r, gain)
    nis = 0.0
    for i in range(3):
        for j in range(3):
            nis += innovation[i] * s_inverse[i, j] * innovation[j]
    return nis


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
