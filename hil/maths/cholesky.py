"""Symmetric positive definite systems of a few unknowns, in plain loops."""

from __future__ import annotations

import math

from hil.maths.jit import kernel


@kernel
def factor(a, low):
    """Write the lower triangle L of ``a = L L.T`` (n, n) to low; return False where ``a`` is not positive definite."""
    n = a.shape[0]
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for m in range(j):
                s -= low[i, m] * low[j, m]
            if i == j:
                if not s > 0.0:
                    return False
                low[i, i] = math.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    return True


@kernel
def solve(low, b, x):
    """Write the x (n,) with ``L L.T x = b``; x may be b itself."""
    n = b.shape[0]
    for i in range(n):
        s = b[i]
        for m in range(i):
            s -= low[i, m] * x[m]
        x[i] = s / low[i, i]
    for k in range(n):
        i = n - 1 - k
        s = x[i]
        for m in range(i + 1, n):
            s -= low[m, i] * x[m]
        x[i] = s / low[i, i]


@kernel
def invert(low, column, out):
    """Write the inverse of ``L L.T`` to out (n, n). column: (n,), scratch."""
    n = low.shape[0]
    for j in range(n):
        for i in range(n):
            column[i] = 1.0 if i == j else 0.0
        solve(low, column, column)
        for i in range(n):
            out[i, j] = column[i]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (out[i, j] + out[j, i])
            out[i, j] = mean
            out[j, i] = mean
