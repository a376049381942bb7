"""Symmetric positive definite systems of a few unknowns, by Cholesky in plain loops.

n: number of leading rows and columns of the system; the arrays may be larger.
"""

from __future__ import annotations

import math
from typing import Final

from hil.core.jit import kernel

LEAST_RESIDUE: Final = 1e-14
"""Least remaining fraction of a diagonal element in least squares of many points."""


@kernel
def factor(a, n, low, least_residue=0.0):
    """Write the lower triangle L of ``a = L L.T`` to low, which may be a; return False if there is none.

    least_residue: least remaining fraction of each diagonal element after elimination of the unknowns before it.
    """
    for i in range(n):
        for j in range(i + 1):
            s = a[i, j]
            for m in range(j):
                s -= low[i, m] * low[j, m]
            if i == j:
                if not s > 0.0 or s <= least_residue * abs(a[i, i]):
                    return False
                low[i, i] = math.sqrt(s)
            else:
                low[i, j] = s / low[j, j]
    return True


@kernel
def solve(low, n, b, x):
    """Write the x with ``L L.T x = b``; x may be b itself."""
    for i in range(n):
        s = b[i]
        for m in range(i):
            s -= low[i, m] * x[m]
        x[i] = s / low[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for m in range(i + 1, n):
            s -= low[m, i] * x[m]
        x[i] = s / low[i, i]


@kernel
def solve_system(a, b, x):
    """Write the solution of ``a x = b`` to x, (n,); return whether ``a`` (n, n) is positive definite. a, b are kept."""
    n = b.shape[0]
    low = a.copy()
    if not factor(low, n, low, LEAST_RESIDUE):
        return False
    solve(low, n, b, x)
    return True


@kernel
def invert(low, column, out):
    """Write the inverse of ``L L.T`` to out (n, n). column: (n,), scratch."""
    n = low.shape[0]
    for j in range(n):
        for i in range(n):
            column[i] = 1.0 if i == j else 0.0
        solve(low, n, column, column)
        for i in range(n):
            out[i, j] = column[i]
    for i in range(n):
        for j in range(i):
            mean = 0.5 * (out[i, j] + out[j, i])
            out[i, j] = mean
            out[j, i] = mean
