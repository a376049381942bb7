"""Symmetric positive definite systems of a few unknowns, by Cholesky in plain loops.

n: number of leading rows and columns of the system; the arrays may be larger.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

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
def forward(low, n, b, x):
    """Write the x with ``L x = b``; x may be b itself."""
    for i in range(n):
        s = b[i]
        for m in range(i):
            s -= low[i, m] * x[m]
        x[i] = s / low[i, i]


@kernel
def backward(low, n, b, x):
    """Write the x with ``L.T x = b``; x may be b itself."""
    for i in range(n - 1, -1, -1):
        s = b[i]
        for m in range(i + 1, n):
            s -= low[m, i] * x[m]
        x[i] = s / low[i, i]


@kernel
def solve(low, n, b, x):
    """Write the x with ``L L.T x = b``; x may be b itself."""
    forward(low, n, b, x)
    backward(low, n, x, x)


@kernel
def solve_damped(a, damping, b, low, x, least_residue=0.0):
    """Write the x with ``(a + damping diag(a)) x = b``, a step by Levenberg; return False if there is none.

    a: (n, n), kept, as b is. low: (n, n), scratch.
    """
    n = b.shape[0]
    for i in range(n):
        for j in range(i):
            low[i, j] = a[i, j]
        low[i, i] = a[i, i] * (1.0 + damping) + 1e-12
    if not factor(low, n, low, least_residue):
        return False
    solve(low, n, b, x)
    return True


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
def invert_factor(low, out):
    """Write the inverse of L (n, n) to the lower triangle of out."""
    n = low.shape[0]
    for j in range(n):
        out[j, j] = 1.0 / low[j, j]
        for i in range(j + 1, n):
            s = 0.0
            for m in range(j, i):
                s -= low[i, m] * out[m, j]
            out[i, j] = s / low[i, i]


@kernel
def invert(low, out):
    """Write the inverse of ``L L.T`` (n, n) to out."""
    n = low.shape[0]
    column = np.empty(n)
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
