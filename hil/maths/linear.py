"""Sums, products and systems of equations of a few numbers, each in the order of its indices.

BLAS and LAPACK choose the order by the processor, Python's ``sum`` by its version; these are the same everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

Array = np.ndarray
_SWEEPS = 30  # of Jacobi's method, which converges quadratically


def total(values: Iterable[float]) -> float:
    """Return the sum of ``values``, one after the other."""
    result = 0.0
    for value in values:
        result += value
    return result


def length(vector: Any) -> float:
    """Return the Euclidean norm of ``vector`` (n,)."""
    return math.sqrt(total(float(v) * float(v) for v in vector))


def lengths(vectors: Any) -> Array:
    """Return the Euclidean norms of ``vectors`` (..., n), (...)."""
    vectors = np.asarray(vectors, dtype=float)
    squares = np.zeros(vectors.shape[:-1])
    for k in range(vectors.shape[-1]):
        squares = squares + vectors[..., k] * vectors[..., k]
    norms: Array = np.sqrt(squares)
    return norms


def product(a: Any, b: Any) -> Any:
    """Return ``a`` (..., n) times ``b``, (n,) or (..., n, m), as ``a @ b`` does."""
    a, b = np.asarray(a), np.asarray(b)
    if b.ndim == 1:
        result: Any = a[..., 0] * b[0]
        for k in range(1, len(b)):
            result = result + a[..., k] * b[k]
    elif a.ndim == 1:
        result = a[0] * b[..., 0, :]
        for k in range(1, len(a)):
            result = result + a[k] * b[..., k, :]
    else:
        result = a[..., :, 0, None] * b[..., None, 0, :]
        for k in range(1, a.shape[-1]):
            result = result + a[..., :, k, None] * b[..., None, k, :]
    return result


def solve(a: Any, b: Any) -> Array:
    """Return x of ``a x = b``, b of shape (n,) or (n, m), by Gaussian elimination with pivots.

    Raises ValueError if ``a`` is singular.
    """
    right = np.asarray(b, dtype=float)
    rows: list[list[float]] = np.column_stack([a, right]).tolist()
    n = len(rows)
    for k in range(n):
        pivot = max(range(k, n), key=lambda i: abs(rows[i][k]))
        rows[k], rows[pivot] = rows[pivot], rows[k]
        if not abs(rows[k][k]) > 0.0:
            raise ValueError("the matrix is singular")
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    for k in range(n - 1, -1, -1):
        rows[k] = [x / rows[k][k] for x in rows[k]]
        for i in range(k):
            factor = rows[i][k]
            rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return np.array([row[n:] for row in rows]).reshape(right.shape)


def inverse(a: Any) -> Array:
    """Return the inverse of ``a`` (n, n). Raises ValueError if it is singular."""
    return solve(a, np.eye(len(a)))


def eigenvalues(a: Any) -> list[float]:
    """Return the eigenvalues of the symmetric ``a`` (n, n), the smallest first, by Jacobi's method."""
    m: list[list[float]] = np.asarray(a, dtype=float).tolist()
    n = len(m)
    pairs = [(p, q) for p in range(n) for q in range(p + 1, n)]
    for _ in range(_SWEEPS):
        if not any(m[p][q] for p, q in pairs):
            break
        for p, q in pairs:
            if m[p][q] == 0.0:
                continue
            theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q])
            t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
            c = 1.0 / math.sqrt(t * t + 1.0)
            s = t * c
            upper, lower = m[p], m[q]
            m[p] = [c * x - s * y for x, y in zip(upper, lower, strict=True)]
            m[q] = [s * x + c * y for x, y in zip(upper, lower, strict=True)]
            for row in m:
                row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
            m[p][q] = m[q][p] = 0.0
    return sorted(m[i][i] for i in range(n))
