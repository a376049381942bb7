"""Quantiles of the chi-square distribution.

scipy.special has them too, but its import takes longer than a run; a test compares the two.
"""

from __future__ import annotations

import math
from functools import cache

from hil.maths import elementary, special

_STEPS = 100
_PRECISION = 1e-13  # relative size of the last step: the next one would be rounding


@cache
def lower_quantile(probability: float, dof: int) -> float:
    """Return the value that chi-square with ``dof`` degrees of freedom falls below with ``probability``, 0..1."""
    return _solve(probability, dof, lower=True)


@cache
def upper_quantile(probability: float, dof: int) -> float:
    """Return the value that chi-square with ``dof`` degrees of freedom exceeds with ``probability``, 0..1."""
    return _solve(probability, dof, lower=False)


def band_of_mean(n: int, dof: int, tail: float) -> tuple[float, float]:
    """Return the band of the mean of ``n`` independent values with ``dof`` each, ``tail`` outside on each side."""
    return lower_quantile(tail, n * dof) / n, upper_quantile(tail, n * dof) / n


def limit_of_recent_mean(window: int, dof: int, tail: float) -> float:
    """Return what an exponential mean of values with ``dof`` each and weight 1 / ``window`` exceeds with ``tail``.

    It has the variance of a plain mean over 2 window - 1 values.
    """
    n = 2 * window - 1
    return upper_quantile(tail, dof * n) / n


def two_sided_tail(sigma: float) -> float:
    """Return the probability that a normal variable is more than ``sigma`` standard deviations from its mean."""
    return special.erfc(sigma * math.sqrt(0.5))


def _solve(probability: float, dof: int, lower: bool) -> float:
    """Newton's method on the logarithm of the smaller tail, which is concave: one step overshoots at most."""
    if probability > 0.5:
        probability, lower = 1.0 - probability, not lower
    if probability <= 0.0:
        return 0.0 if lower else math.inf
    tail, direction = (_lower_tail, 1.0) if lower else (_upper_tail, -1.0)
    a = 0.5 * dof
    half = previous = a
    for _ in range(_STEPS):
        reached = tail(half, dof)
        if reached == 0.0:  # overshot to where numbers underflow
            half = 0.5 * (half + previous)
            continue
        step = direction * elementary.log(reached / probability) * reached * half / (a * _power_term(half, a))
        previous, half = half, max(half - step, 0.5 * half)
        if abs(step) <= _PRECISION * half:
            break
    return 2.0 * half


def _power_term(half: float, a: float) -> float:
    """Return half^a exp(-half) / Gamma(a + 1)."""
    return elementary.exp(a * elementary.log(half) - half - special.log_gamma(a + 1.0))


def _lower_tail(half: float, dof: int) -> float:
    """Return P(dof / 2, half) by its power series (DLMF 8.11.4)."""
    a = 0.5 * dof
    term = total = _power_term(half, a)
    while term > 1e-17 * total:
        a += 1.0
        term *= half / a
        total += term
    return total


def _upper_tail(half: float, dof: int) -> float:
    """Return Q(dof / 2, half) by recurrence from Q(1, half) or Q(1/2, half) (DLMF 8.8.6, 8.4)."""
    least, total = (1.0, elementary.exp(-half)) if dof % 2 == 0 else (0.5, special.erfc(math.sqrt(half)))
    a = 0.5 * dof - 1.0
    term = _power_term(half, a)
    while a >= least and term > 1e-17 * total:
        total += term
        term *= a / half
        a -= 1.0
    return total
