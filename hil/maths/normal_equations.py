"""Small symmetric systems of least squares, by Cholesky in plain loops."""

from __future__ import annotations

import math

import numpy as np

from hil.maths.jit import kernel


@kernel
def factorise(a, n):
    """Replace the lower triangle of the leading (n, n) of ``a`` by its Cholesky factor; return whether it has one."""
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for m in range(j):
                s -= a[i, m] * a[j, m]
            if i == j:
                if not s > 1e-14 * abs(a[i, i]) or not s > 0.0:
                    return False
                a[i, i] = math.sqrt(s)
            else:
                a[i, j] = s / a[j, j]
    return True


@kernel
def substitute(factor, n, b):
    """Replace the first n of ``b`` by the solution of ``L L.T x = b``, L the lower triangle of ``factor``."""
    for i in range(n):
        s = b[i]
        for m in range(i):
            s -= factor[i, m] * b[m]
        b[i] = s / factor[i, i]
    for i in range(n - 1, -1, -1):
        s = b[i]
        for m in range(i + 1, n):
            s -= factor[m, i] * b[m]
        b[i] = s / factor[i, i]


@kernel
def solve(a, b, x):
    """Write the solution of ``a x = b`` to ``x``; return whether ``a`` (n, n) is positive definite. a, b are kept."""
    n = b.shape[0]
    factor = a.copy()
    if not factorise(factor, n):
        return False
    for i in range(n):
        x[i] = b[i]
    substitute(factor, n, x)
    return True


@kernel
def invert(a, out):
    """Write the inverse of the positive definite ``a`` (n, n) to ``out``; return whether it has one."""
    n = a.shape[0]
    factor = a.copy()
    if not factorise(factor, n):
        return False
    column = np.empty(n)
    for j in range(n):
        for i in range(n):
            column[i] = 1.0 if i == j else 0.0
        substitute(factor, n, column)
        for i in range(n):
            out[i, j] = column[i]
    return True
