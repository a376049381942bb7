"""Distance between two convex hulls, each given by its vertices.

Minimum-norm point of the difference of the hulls (Gilbert, Johnson, Keerthi 1988) by the active-set method of Wolfe
(1976, "Finding the nearest point in a polytope"). Each iterate gives a plane that separates the hulls, hence a distance
that they certainly have: an early end makes the result smaller, never larger.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import stack

_STEPS = 64
_GAP = 1e-12  # relative, between the distance and its bound
_DEGENERATE = 1e-13  # pivot relative to the diagonal: a vertex in the affine hull of the others


@kernel
def _combine(points, weights, n, x):
    """Write the sum of the first ``n`` points (4, 3) by their weights to ``x``; return its square."""
    square = 0.0
    for i in range(3):
        x[i] = 0.0
        for k in range(n):
            x[i] += weights[k] * points[k, i]
        square += x[i] * x[i]
    return square


@kernel
def _affine_weights(points, n, weights):
    """Write the barycentric ``weights`` (4,) of the point nearest to the origin in the affine hull of ``n`` points.

    The normal equations of the differences from the last point, by Cholesky; one that depends on the others gets 0.
    """
    factor, right, last = stack.matrix(3, 3), stack.vector(3), n - 1
    for k in range(last):
        right[k] = 0.0
        for i in range(3):
            right[k] -= (points[k, i] - points[last, i]) * points[last, i]
        for m in range(k + 1):
            total = 0.0
            for i in range(3):
                total += (points[k, i] - points[last, i]) * (points[m, i] - points[last, i])
            diagonal = total
            for i in range(m):
                total -= factor[k, i] * factor[m, i]
            if m < k:
                factor[k, m] = total / factor[m, m] if factor[m, m] > 0.0 else 0.0
            else:
                factor[k, k] = math.sqrt(total) if total > _DEGENERATE * diagonal else 0.0
        for m in range(k):
            right[k] -= factor[k, m] * right[m]
        right[k] = right[k] / factor[k, k] if factor[k, k] > 0.0 else 0.0
    weights[last] = 1.0
    for k in range(last - 1, -1, -1):
        for m in range(k + 1, last):
            right[k] -= factor[m, k] * right[m]
        right[k] = right[k] / factor[k, k] if factor[k, k] > 0.0 else 0.0
        weights[k] = right[k]
        weights[last] -= right[k]


@kernel
def _nearest_in_hull(points, weights, n, x):
    """Write the point of the hull of ``n`` points nearest to the origin to ``x``; return how many points span it.

    points (4, 3) and weights (4,), of a point in the hull, keep only those that span it.
    """
    target = stack.vector(4)
    while True:
        _affine_weights(points, n, target)
        step = 1.0
        for k in range(n):
            if target[k] <= 0.0 and weights[k] - target[k] > 0.0:
                step = min(step, weights[k] / (weights[k] - target[k]))
        kept = 0
        for k in range(n):
            weight = weights[k] + step * (target[k] - weights[k])
            if weight > 1e-15 or (step == 1.0 and target[k] > 0.0):
                weights[kept] = weight
                for i in range(3):
                    points[kept, i] = points[k, i]
                kept += 1
        if kept == n or kept <= 1:
            _combine(points, weights, kept, x)
            return kept
        n = kept


@kernel
def separation(a, n_a, b, n_b, normal):
    """Return the distance between the hulls of the first ``n_a`` rows of ``a`` and ``n_b`` of ``b``, 0 if they meet.

    a, b: (n, 3), of one frame and unit. normal: (3,), receives the unit vector from ``b`` to ``a`` between the nearest
    points: the gradient of the distance with respect to a translation of ``a``; zero if the hulls meet.
    """
    points, weights = stack.matrix(4, 3), stack.vector(4)
    x = stack.vector(3)
    for i in range(3):
        normal[i] = 0.0
        x[i] = points[0, i] = a[0, i] - b[0, i]
    weights[0] = 1.0
    n, least = 1, 0.0
    for _ in range(_STEPS):
        square = x[0] * x[0] + x[1] * x[1] + x[2] * x[2]
        if square == 0.0:
            return least
        nearest, farthest, of_a, of_b = np.inf, -np.inf, 0, 0
        for k in range(n_a):
            along = a[k, 0] * x[0] + a[k, 1] * x[1] + a[k, 2] * x[2]
            if along < nearest:
                nearest, of_a = along, k
        for k in range(n_b):
            along = b[k, 0] * x[0] + b[k, 1] * x[1] + b[k, 2] * x[2]
            if along > farthest:
                farthest, of_b = along, k
        length = math.sqrt(square)
        bound = (nearest - farthest) / length
        if bound > least:
            least = bound
            for i in range(3):
                normal[i] = x[i] / length
        if n == 4 or length - bound <= _GAP * length:
            return least
        for i in range(3):
            points[n, i] = a[of_a, i] - b[of_b, i]
        weights[n] = 0.0
        n = _nearest_in_hull(points, weights, n + 1, x)
    return least
