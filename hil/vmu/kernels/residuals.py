"""Residuals of a spot's fit: outlier pixels, deviation from a round Gaussian, estimate of the shot noise."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.kalman import normalised_square
from hil.vmu.kernels.fit import FULL_SCALE, PLANE, SIGMA, U, V, gather, invert

SHAPE_TERMS = 3  # extra parameters of ``shape_chi_square``
_OUTLIER = 6.0  # sigma
_MOST_OUTLIERS = 3


@kernel
def drop_outliers(pixels, weighed, dark, per_level, model, light):
    """Exclude the pixels that are far off the model, only the worst if there are many. Return how many."""
    found = np.empty(_MOST_OUTLIERS, dtype=np.int64)
    count, worst, most = 0, 0, 0.0
    for at in range(pixels.shape[0]):
        if weighed[at] == 0.0 or (pixels[at] >= FULL_SCALE and model[at] >= FULL_SCALE):
            continue
        gap = pixels[at] - model[at]
        square = gap * gap / (dark + per_level * max(light[at], 0.0))
        if square > _OUTLIER * _OUTLIER:
            if count < _MOST_OUTLIERS:
                found[count] = at
            count += 1
            if square > most:
                worst, most = at, square
    if count > _MOST_OUTLIERS:
        weighed[worst] = 0.0
        return 1
    for k in range(count):
        weighed[found[k]] = 0.0
    return count


@kernel
def misfit(total, used, parameters):
    """Return the sum of squares per degree of freedom, and its statistical limit (5 sigma)."""
    freedom = max(used - parameters, 1)
    return total / freedom, 1.0 + 5.0 * math.sqrt(2.0 / freedom)


@kernel
def shape_chi_square(
    box, p, pixels, weighed, dark, per_level, model, light, slopes, wide_model, wide, wide_inverse, elongation
):
    """Return chi-square (three degrees of freedom) of a light's deviation from the fitted round Gaussian ``p`` (7,).

    A tilted disc is elongated (x^2 - y^2 and 2 x y times the Gaussian, two parameters), and flatter than the Gaussian
    of its width, by -a^4/384 of the Gaussian's squared Laplacian for a radius of a (r^4/s^4 - 8 r^2/s^2 + 8 times it,
    one parameter). One more step of the fit with these three gives wide_model, wide (10, pixels), its derivatives, and
    wide_inverse (10, 10), its covariance: residuals in which the light's shape is not mistaken for shot noise.
    elongation: (3,), px^2, half of the variance along u minus that along v, their covariance, and
    the standard deviation of both.
    """
    n, more = p.shape[0], SHAPE_TERMS
    square = p[PLANE + SIGMA] * p[PLANE + SIGMA] + 1.0 / 12.0
    across = box[2] - box[0]
    for at in range(pixels.shape[0]):
        du, dv = box[0] + at % across - p[PLANE + U], box[1] + at // across - p[PLANE + V]
        rho = (du * du + dv * dv) / square
        for i in range(n):
            wide[i, at] = slopes[i, at]
        wide[n, at] = -(rho * rho - 8.0 * rho + 8.0) * light[at]
        wide[n + 1, at] = (du * du - dv * dv) / square * light[at]
        wide[n + 2, at] = 2.0 * du * dv / square * light[at]
    normal, right, step = np.empty((n + more, n + more)), np.empty(n + more), np.zeros(n + more)
    gather(pixels, weighed, dark, per_level, model, light, wide, normal, right)
    if not invert(normal, wide_inverse):
        return 0.0
    for i in range(n + more):
        for j in range(n + more):
            step[i] += wide_inverse[i, j] * right[j]
    wide_model[:] = model
    for i in range(n + more):
        for at in range(pixels.shape[0]):
            wide_model[at] += wide[i, at] * step[i]
    elongation[0], elongation[1] = 2.0 * square * step[n + 1], 2.0 * square * step[n + 2]
    elongation[2] = 2.0 * square * math.sqrt(0.5 * (wide_inverse[n + 1, n + 1] + wide_inverse[n + 2, n + 2]))
    return normalised_square(step[n:], wide_inverse[n:, n:])


@kernel
def signal_to_noise(pixels, weighed, dark, per_level, light):
    """Return a light's SNR: the root of the sum of squares of its levels over their variances."""
    total = 0.0
    for at in range(pixels.shape[0]):
        if weighed[at] != 0.0:
            total += light[at] * light[at] / (dark + per_level * max(light[at], 0.0))
    return math.sqrt(total)


@kernel
def light_noise(pixels, weighed, dark, per_level, light, model, slopes, covariance):
    """Return an estimate of the variance per level of light from the residuals: numerator and denominator of a mean.

    Corrected for the fraction of each residual that the fit has absorbed (its leverage).
    """
    n = covariance.shape[0]
    above = below = 0.0
    leverage = np.zeros(pixels.shape[0])
    for i in range(n):
        for j in range(i + 1):
            part = covariance[i, j] * (1.0 if i == j else 2.0)
            for at in range(pixels.shape[0]):
                leverage[at] += part * slopes[i, at] * slopes[j, at]
    for at in range(pixels.shape[0]):
        if weighed[at] == 0.0 or pixels[at] >= FULL_SCALE or not light[at] > dark:
            continue
        variance = dark + per_level * light[at]
        kept = 1.0 - leverage[at] / variance
        if kept < 0.1:
            continue
        gap = pixels[at] - model[at]
        share = light[at] / (variance * variance)
        above += share * (gap * gap / kept - dark)
        below += share * light[at]
    return above, below
