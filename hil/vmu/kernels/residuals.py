"""Residuals of a spot's fit: outlier pixels, deviation from a round Gaussian, estimate of the shot noise."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.arrays import copy_into
from hil.maths.kalman import normalised_square
from hil.vmu.kernels.fit import FULL_SCALE, PLANE, SIGMA, LightFit, U, V, gather, invert, whole_spans

SHAPE_TERMS = 3  # extra parameters of ``shape_chi_square``
_OUTLIER = 6.0  # sigma
_MOST_OUTLIERS = 3


@kernel
def drop_outliers(f):
    """Exclude the pixels that are far off the model, only the worst if there are many. Return how many."""
    outliers = np.empty(_MOST_OUTLIERS, dtype=np.int64)
    count, worst, most = 0, 0, 0.0
    for at in range(f.pixels.shape[0]):
        if f.weighed[at] == 0.0 or (f.pixels[at] >= FULL_SCALE and f.model[at] >= FULL_SCALE):
            continue
        gap = f.pixels[at] - f.model[at]
        square = gap * gap / (f.dark + f.per_level * max(f.light[at], 0.0))
        if square > _OUTLIER * _OUTLIER:
            if count < _MOST_OUTLIERS:
                outliers[count] = at
            count += 1
            if square > most:
                worst, most = at, square
    if count > _MOST_OUTLIERS:
        f.weighed[worst] = 0.0
        return 1
    for k in range(count):
        f.weighed[outliers[k]] = 0.0
    return count


@kernel
def misfit(total, used, parameters):
    """Return the sum of squares per degree of freedom, and its statistical limit (5 sigma)."""
    freedom = max(used - parameters, 1)
    return total / freedom, 1.0 + 5.0 * math.sqrt(2.0 / freedom)


@kernel
def widened(f):
    """Return a fit to the same pixels with the three further parameters of ``shape_chi_square``."""
    n, count = f.p.shape[0] + SHAPE_TERMS, f.pixels.shape[0]
    return LightFit(
        f.is_disc, f.p, np.zeros((n, n)), f.elongation, f.box, f.pixels, f.weighed, f.dark, f.per_level,
        np.empty(count), f.light, np.empty((n, count)), whole_spans(n, count), f.work,
    )  # fmt: skip


@kernel
def shape_chi_square(f, wide):
    """Return chi-square (three degrees of freedom) of a light's deviation from the fitted round Gaussian ``f``.

    A tilted disc is elongated (x^2 - y^2 and 2 x y times the Gaussian, two parameters), and flatter than the Gaussian
    of its width, by -a^4/384 of the Gaussian's squared Laplacian for a radius of a (r^4/s^4 - 8 r^2/s^2 + 8 times it,
    one parameter). One more step of the fit with these three gives model, slopes and covariance of ``wide``, residuals
    in which the light's shape is not mistaken for shot noise, and the elongation of ``f``.
    """
    n, more, p = f.p.shape[0], SHAPE_TERMS, f.p
    square = p[PLANE + SIGMA] * p[PLANE + SIGMA] + 1.0 / 12.0
    across = f.box[2] - f.box[0]
    for at in range(f.pixels.shape[0]):
        du, dv = f.box[0] + at % across - p[PLANE + U], f.box[1] + at // across - p[PLANE + V]
        rho = (du * du + dv * dv) / square
        for i in range(n):
            wide.slopes[i, at] = f.slopes[i, at]
        wide.slopes[n, at] = -(rho * rho - 8.0 * rho + 8.0) * f.light[at]
        wide.slopes[n + 1, at] = (du * du - dv * dv) / square * f.light[at]
        wide.slopes[n + 2, at] = 2.0 * du * dv / square * f.light[at]
    copy_into(wide.model, f.model)
    normal, right, step = np.empty((n + more, n + more)), np.empty(n + more), np.zeros(n + more)
    gather(wide, normal, right)
    if not invert(normal, wide.covariance):
        return 0.0
    for i in range(n + more):
        for j in range(n + more):
            step[i] += wide.covariance[i, j] * right[j]
    for i in range(n + more):
        for at in range(f.pixels.shape[0]):
            wide.model[at] += wide.slopes[i, at] * step[i]
    f.elongation[0], f.elongation[1] = 2.0 * square * step[n + 1], 2.0 * square * step[n + 2]
    variance = 0.5 * (wide.covariance[n + 1, n + 1] + wide.covariance[n + 2, n + 2])
    f.elongation[2] = 2.0 * square * math.sqrt(variance)
    return normalised_square(step[n:], wide.covariance[n:, n:])


@kernel
def signal_to_noise(f):
    """Return a light's SNR: the root of the sum of squares of its levels over their variances."""
    total = 0.0
    for at in range(f.pixels.shape[0]):
        if f.weighed[at] != 0.0:
            total += f.light[at] * f.light[at] / (f.dark + f.per_level * max(f.light[at], 0.0))
    return math.sqrt(total)


@kernel
def light_noise(f):
    """Return an estimate of the variance per level of light from the residuals: numerator and denominator of a mean.

    Corrected for the fraction of each residual that the fit has absorbed (its leverage).
    """
    n = f.covariance.shape[0]
    above = below = 0.0
    leverage = np.zeros(f.pixels.shape[0])
    for i in range(n):
        for j in range(i + 1):
            part = f.covariance[i, j] * (1.0 if i == j else 2.0)
            for at in range(f.pixels.shape[0]):
                leverage[at] += part * f.slopes[i, at] * f.slopes[j, at]
    for at in range(f.pixels.shape[0]):
        if f.weighed[at] == 0.0 or f.pixels[at] >= FULL_SCALE or not f.light[at] > f.dark:
            continue
        variance = f.dark + f.per_level * f.light[at]
        kept = 1.0 - leverage[at] / variance
        if kept < 0.1:
            continue
        gap = f.pixels[at] - f.model[at]
        share = f.light[at] / (variance * variance)
        above += share * (gap * gap / kept - f.dark)
        below += share * f.light[at]
    return above, below
