"""Maximum-likelihood fit of a spot's shape to the pixels of a window (weighted least squares).

Parameters, (n,): background at the window's middle and its two slopes, then either for each of a few points of
light flux, u, v and sigma (n = 3 + 4 k), or for one disc flux, u, v, sigma, width, shear and height as in
``disc`` (n = 10). A pixel's variance is the dark variance plus its light over the electrons per level; a
pixel at full scale gives only a lower bound of the light.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.jit import kernel
from hil.core.messages import Array
from hil.maths import cholesky
from hil.maths.arrays import copy_into
from hil.vmu.kernels.disc import node, point_sums, strip_sums, strips

PLANE = 3  # parameters of the background
POINT = 4  # parameters of a point of light
DISC = 7
FLUX, U, V, SIGMA, WIDTH, SHEAR, HEIGHT = 0, 1, 2, 3, 4, 5, 6
FULL_SCALE = 255.0
_LEAST_SIGMA = 0.25  # px
_LEAST_RESIDUE = 1e-12  # of ``cholesky.factor``
_WORK_OF_PIXEL = 20.0  # for its model, in products
_DARK = 1e-10  # fraction of a light's flux: pixels with less have none


class LightFit(NamedTuple):
    """A model of one or a few lights, its parameters, and the pixels of the window that it is fitted to, row by row.

    p: (n,). covariance: (n, n). elongation: (3,), px^2, half of the variance along u minus that along v, their
    covariance, and the standard deviation of both. box: u and v of the window's first pixel, and of the one after the
    last. pixels: (count,), levels. weighed: (count,), 0 for an excluded pixel, else 1. dark: variance of a pixel
    without light. per_level: variance per level of light. model, light: (count,), image of the parameters with and
    without background. slopes: (n, count), derivatives of the model. work: (1,), products that fits may
    still cost.
    """

    is_disc: bool
    p: Array
    covariance: Array
    elongation: Array
    box: npt.NDArray[np.int64]
    pixels: Array
    weighed: Array
    dark: float
    per_level: float
    model: Array
    light: Array
    slopes: Array
    work: Array


@kernel
def light_fit(is_disc, p, box, dark, per_level, work):
    """Return a model of the parameters ``p`` in the window ``box``, whose pixels are not yet read."""
    n, count = p.shape[0], (box[2] - box[0]) * (box[3] - box[1])
    return LightFit(
        is_disc, p, np.zeros((n, n)), np.full(3, np.nan), box, np.empty(count), np.empty(count), dark, per_level,
        np.empty(count), np.empty(count), np.empty((n, count)), work,
    )  # fmt: skip


@kernel
def _fill_plane(box, p, model, light, slopes):
    across, down = box[2] - box[0], box[3] - box[1]
    for i in range(down):
        y = i - 0.5 * (down - 1)
        for j in range(across):
            x, at = j - 0.5 * (across - 1), i * across + j
            model[at] = p[0] + x * p[1] + y * p[2]
            light[at] = 0.0
            slopes[0, at] = 1.0
            slopes[1, at] = x
            slopes[2, at] = y


@kernel
def fill_points(box, p, model, light, slopes):
    """Write the image of points of light in a box: ``model`` and ``light`` (without background), (pixels,).

    slopes: (n, pixels), the derivatives. box: u and v of the first pixel, and of the one after the last.
    """
    across, down = box[2] - box[0], box[3] - box[1]
    _fill_plane(box, p, model, light, slopes)
    by_u, by_v = np.empty((3, across)), np.empty((3, down))
    edges_u, edges_v = np.empty((6, across + 1)), np.empty((6, down + 1))
    for k in range((p.shape[0] - PLANE) // POINT):
        a = PLANE + POINT * k
        flux = p[a]
        point_sums(box[0], across, p[a + U], p[a + SIGMA], edges_u, by_u[0], by_u[1], by_u[2])
        point_sums(box[1], down, p[a + V], p[a + SIGMA], edges_v, by_v[0], by_v[1], by_v[2])
        for i in range(down):
            for j in range(across):
                at = i * across + j
                share = by_v[0, i] * by_u[0, j]
                if share < _DARK:
                    for m in range(POINT):
                        slopes[a + m, at] = 0.0
                    continue
                model[at] += flux * share
                light[at] += flux * share
                slopes[a, at] = share
                slopes[a + U, at] = flux * by_v[0, i] * by_u[1, j]
                slopes[a + V, at] = flux * by_v[1, i] * by_u[0, j]
                slopes[a + SIGMA, at] = flux * (by_v[2, i] * by_u[0, j] + by_v[0, i] * by_u[2, j])


@kernel
def _add(to, factor, down, across):
    """Add ``factor`` times the product of ``down`` (n,) and ``across`` (m,) to ``to`` (n, m).

    One sum at a time, which is vectorised.
    """
    for i in range(to.shape[0]):
        here = factor * down[i]
        for j in range(to.shape[1]):
            to[i, j] += here * across[j]


@kernel
def fill_disc(box, p, model, light, slopes):
    """Write the image of a disc in a box, as ``fill_points`` does."""
    across, down = box[2] - box[0], box[3] - box[1]
    _fill_plane(box, p, model, light, slopes)
    flux, blur = p[PLANE], p[PLANE + SIGMA]
    width, shear, height = p[PLANE + WIDTH], p[PLANE + SHEAR], p[PLANE + HEIGHT]
    n = strips(height, blur)
    by_u, by_v = np.empty((4, across)), np.empty((3, down))
    value, by_centre, by_blur, by_half = by_u[0], by_u[1], by_u[2], by_u[3]
    here, moved, blurred = by_v[0], by_v[1], by_v[2]
    edges_u, edges_v = np.empty((6, across + 1)), np.empty((6, down + 1))
    slopes[PLANE:] = 0.0
    to = slopes[PLANE:].reshape((DISC, down, across))
    to_flux, to_u, to_v, to_blur = to[FLUX], to[U], to[V], to[SIGMA]
    to_width, to_shear, to_height = to[WIDTH], to[SHEAR], to[HEIGHT]
    for k in range(n):
        eta, half, share = (0.0, 1.0, 1.0) if n == 1 else node(k, n)
        centre, long = p[PLANE + U] + shear * eta, abs(width) * half
        strip_sums(box[0], across, centre, long, blur, edges_u, value, by_centre, by_blur, by_half)
        point_sums(box[1], down, p[PLANE + V] + height * eta, blur, edges_v, here, moved, blurred)
        part = flux * share
        _add(to_flux, share, here, value)
        _add(to_u, part, here, by_centre)
        _add(to_v, part, moved, value)
        _add(to_blur, part, blurred, value)
        _add(to_blur, part, here, by_blur)
        _add(to_width, part * (half if width >= 0.0 else -half), here, by_half)
        _add(to_shear, part * eta, here, by_centre)
        _add(to_height, part * eta, moved, value)
    for at in range(down * across):
        light[at] = flux * slopes[PLANE, at]
        model[at] += light[at]


@kernel
def residual(level, model):
    """Return the residual of a pixel's level; 0 for a saturated pixel if the model is at or above full scale."""
    if level >= FULL_SCALE and model >= FULL_SCALE:
        return 0.0
    return level - model


@kernel
def invert(a, out):
    """Write the inverse of the positive definite ``a`` (n, n) by Cholesky; return False if it is not definite."""
    n = a.shape[0]
    low, half = np.zeros((n, n)), np.zeros((n, n))
    if not cholesky.factor(a, n, low, _LEAST_RESIDUE):
        return False
    cholesky.invert_factor(low, half)
    for i in range(n):
        for j in range(i + 1):
            s = 0.0
            for m in range(i, n):
                s += half[m, i] * half[m, j]
            out[i, j] = s
            out[j, i] = s
    return True


@kernel
def dot(a, b):
    """Return the product of two vectors, in four partial sums that the processor adds at once."""
    n = a.shape[0]
    whole = n - n % 4
    first = second = third = fourth = 0.0
    for k in range(0, whole, 4):
        first += a[k] * b[k]
        second += a[k + 1] * b[k + 1]
        third += a[k + 2] * b[k + 2]
        fourth += a[k + 3] * b[k + 3]
    for k in range(whole, n):
        first += a[k] * b[k]
    return (first + second) + (third + fourth)


@kernel
def gather(f, normal, right):
    """Write normal matrix (n, n) and right side (n,); return the sum of squared residuals over their variance."""
    n, count = normal.shape[0], f.pixels.shape[0]
    f.work[0] -= count * (0.5 * n * n + _WORK_OF_PIXEL)
    weight, gap, scaled = np.empty(count), np.empty(count), np.empty(count)
    total = 0.0
    for at in range(count):
        gap[at] = residual(f.pixels[at], f.model[at])
        weight[at] = f.weighed[at] / (f.dark + f.per_level * max(f.light[at], 0.0))
        total += weight[at] * gap[at] * gap[at]
        if f.pixels[at] >= FULL_SCALE and gap[at] == 0.0:
            weight[at] = 0.0
    for i in range(n):
        for at in range(count):
            scaled[at] = weight[at] * f.slopes[i, at]
        right[i] = dot(scaled, gap)
        for j in range(i + 1):
            normal[i, j] = dot(scaled, f.slopes[j])
            normal[j, i] = normal[i, j]
    return total


@kernel
def _fill(f, p):
    if f.is_disc:
        fill_disc(f.box, p, f.model, f.light, f.slopes)
    else:
        fill_points(f.box, p, f.model, f.light, f.slopes)


@kernel
def _restrain(is_disc, p):
    """Keep the parameters within their valid range."""
    step = DISC if is_disc else POINT
    for a in range(PLANE, p.shape[0], step):
        p[a + SIGMA] = max(abs(p[a + SIGMA]), _LEAST_SIGMA)
        if is_disc:
            p[a + WIDTH] = abs(p[a + WIDTH])
            if p[a + HEIGHT] < 0.0:
                p[a + HEIGHT], p[a + SHEAR] = -p[a + HEIGHT], -p[a + SHEAR]


@kernel
def fit(f, most):
    """Improve the parameters by up to ``most`` Levenberg steps; write their covariance.

    Return the sum of squares over the variances, or NaN if the pixels do not determine the parameters.
    """
    n = f.p.shape[0]
    normal, low = np.empty((n, n)), np.empty((n, n))
    right, step, tried = np.empty(n), np.empty(n), np.empty(n)
    damping = 1e-3 if f.is_disc else 1e-5
    _fill(f, f.p)
    total = gather(f, normal, right)
    for _ in range(most):
        if f.work[0] < 0.0:
            return np.nan
        if not cholesky.solve_damped(normal, damping, right, low, step, _LEAST_RESIDUE):
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e6:
                return np.nan
            continue
        gain = 0.0
        for i in range(n):
            gain += step[i] * right[i]
            tried[i] = f.p[i] + step[i]
        _restrain(f.is_disc, tried)
        _fill(f, tried)
        squares = gather(f, normal, right)
        # the variances move with the light, so near the end the sum may rise a little
        if squares <= total * 1.02 + 0.1:
            copy_into(f.p, tried)
            total = squares
            damping = max(0.1 * damping, 1e-9)
            if gain < (0.3 if f.is_disc else 0.01):  # of a chi-square: the next step would be far smaller
                break
        else:
            damping = max(10.0 * damping, 1e-3)
            _fill(f, f.p)
            total = gather(f, normal, right)
    if not invert(normal, f.covariance):
        if not f.is_disc:
            return np.nan
        for i in range(n):  # width, shear or height has vanished: hold what is not observable
            normal[i, i] = normal[i, i] * (1.0 + 1e-6) + 1e-12
        if not invert(normal, f.covariance):
            return np.nan
    return total
