"""Maximum-likelihood fit of a spot's shape to the pixels of a window (weighted least squares).

Parameters, (n,): background at the window's middle and its two slopes, then either for each of a few points of
light flux, u, v and sigma (n = 3 + 4 k), or for one disc flux, u, v, sigma, width, shear and height as in
``disc`` (n = 10). A pixel's variance is the dark variance plus its light over the electrons per level; a
pixel at full scale gives only a lower bound of the light.
"""

from __future__ import annotations

import math
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
_REACH = 6.5  # sigmas of the blur, beyond which a strip of a disc has no light
_DARK = 1e-10  # fraction of a light's flux: pixels with less have none


class LightFit(NamedTuple):
    """A model of one or a few lights, its parameters, and the pixels of the window that it is fitted to, row by row.

    p: (n,). covariance: (n, n). elongation: (3,), px^2, half of the variance along u minus that along v, their
    covariance, and the standard deviation of both. box: u and v of the window's first pixel, and of the one after the
    last. pixels: (count,), levels. weighed: (count,), 0 for an excluded pixel, else 1. dark: variance of a pixel
    without light. per_level: variance per level of light. model, light: (count,), image of the parameters with and
    without background. slopes: (n, count), derivatives of the model. spans: (n, 2), first pixel and the one after the
    last whose derivative is not zero. work: (2,), products that fits may still cost, and those that are left to others.
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
    spans: npt.NDArray[np.int64]
    work: Array


@kernel
def light_fit(is_disc, p, box, dark, per_level, work):
    """Return a model of the parameters ``p`` in the window ``box``, whose pixels are not yet read."""
    n, count = p.shape[0], (box[2] - box[0]) * (box[3] - box[1])
    return LightFit(
        is_disc, p, np.zeros((n, n)), np.full(3, np.nan), box, np.empty(count), np.empty(count), dark, per_level,
        np.empty(count), np.empty(count), np.empty((n, count)), whole_spans(n, count), work,
    )  # fmt: skip


@kernel
def whole_spans(n, count):
    """Return the spans of ``n`` parameters that all of ``count`` pixels depend on."""
    spans = np.zeros((n, 2), np.int64)
    spans[:, 1] = count
    return spans


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
def fill_points(box, p, model, light, slopes, spans):
    """Write the image of points of light in a box: ``model`` and ``light`` (without background), (pixels,).

    slopes: (n, pixels), the derivatives, spans: (n, 2), where they are not zero. box: u and v of the first pixel, and
    of the one after the last.
    """
    across, down = box[2] - box[0], box[3] - box[1]
    _fill_plane(box, p, model, light, slopes)
    slopes[PLANE:] = 0.0
    by_u, by_v = np.empty((3, across)), np.empty((3, down))
    edges_u, edges_v = np.empty((6, across + 1)), np.empty((6, down + 1))
    for k in range((p.shape[0] - PLANE) // POINT):
        a = PLANE + POINT * k
        flux = p[a]
        point_sums(box[0], across, p[a + U], p[a + SIGMA], edges_u, by_u[0], by_u[1], by_u[2])
        point_sums(box[1], down, p[a + V], p[a + SIGMA], edges_v, by_v[0], by_v[1], by_v[2])
        widest, first, last = by_u[0].max(), down, 0
        for i in range(down):
            if by_v[0, i] * widest < _DARK:
                continue
            first, last = min(first, i), i + 1
            for j in range(across):
                at = i * across + j
                share = by_v[0, i] * by_u[0, j]
                if share < _DARK:
                    continue
                model[at] += flux * share
                light[at] += flux * share
                slopes[a, at] = share
                slopes[a + U, at] = flux * by_v[0, i] * by_u[1, j]
                slopes[a + V, at] = flux * by_v[1, i] * by_u[0, j]
                slopes[a + SIGMA, at] = flux * (by_v[2, i] * by_u[0, j] + by_v[0, i] * by_u[2, j])
        for m in range(a, a + POINT):
            spans[m, 0] = min(first, last) * across // 8 * 8  # as ``dot`` groups them
            spans[m, 1] = last * across


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
        centre, long, middle = p[PLANE + U] + shear * eta, abs(width) * half, p[PLANE + V] + height * eta
        first = min(max(math.floor(middle - _REACH * blur) - box[1], 0), down)
        last = min(max(math.ceil(middle + _REACH * blur) + 1 - box[1], first), down)
        rows = last - first
        strip_sums(box[0], across, centre, long, blur, edges_u, value, by_centre, by_blur, by_half)
        point_sums(box[1] + first, rows, middle, blur, edges_v, here, moved, blurred)
        part = flux * share
        _add(to_flux[first:last], share, here, value)
        _add(to_u[first:last], part, here, by_centre)
        _add(to_v[first:last], part, moved, value)
        _add(to_blur[first:last], part, blurred, value)
        _add(to_blur[first:last], part, here, by_blur)
        _add(to_width[first:last], part * (half if width >= 0.0 else -half), here, by_half)
        _add(to_shear[first:last], part * eta, here, by_centre)
        _add(to_height[first:last], part * eta, moved, value)
    for at in range(down * across):
        light[at] = flux * slopes[PLANE, at]
        model[at] += light[at]


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
def dot(x, y):
    """Return the product of two vectors.

    In eight partial sums: the processor adds four at once, and the next four while it waits for these. Only a loop
    that begins at a constant is vectorised: of an index that may be negative, Numba tests the sign.
    """
    n = x.shape[0]
    whole = n - n % 8
    a = b = c = d = e = f = g = h = 0.0
    for k in range(0, whole, 8):
        a += x[k] * y[k]
        b += x[k + 1] * y[k + 1]
        c += x[k + 2] * y[k + 2]
        d += x[k + 3] * y[k + 3]
        e += x[k + 4] * y[k + 4]
        f += x[k + 5] * y[k + 5]
        g += x[k + 6] * y[k + 6]
        h += x[k + 7] * y[k + 7]
    for k in range(whole, n):
        a += x[k] * y[k]
    return ((a + b) + (c + d)) + ((e + f) + (g + h))


@kernel
def gather(f, normal, right):
    """Write normal matrix (n, n) and right side (n,); return the sum of squared residuals over their variance."""
    n, count = normal.shape[0], f.pixels.shape[0]
    weight, gap, scaled = np.empty(count), np.empty(count), np.empty(count)
    for at in range(count):
        level, model, light = f.pixels[at], f.model[at], f.light[at]
        clipped = level >= FULL_SCALE and model >= FULL_SCALE  # its light is only known to be as much
        gap[at] = 0.0 if clipped else level - model
        weight[at] = 0.0 if clipped else f.weighed[at] / (f.dark + f.per_level * (light if light > 0.0 else 0.0))
        scaled[at] = weight[at] * gap[at]
    total = dot(scaled, gap)
    products = 0.0
    for i in range(n):
        first, last = f.spans[i, 0], f.spans[i, 1]
        here, slopes, by = scaled[first:last], f.slopes[i, first:last], weight[first:last]
        for at in range(here.shape[0]):
            here[at] = by[at] * slopes[at]
        right[i] = dot(here, gap[first:last])
        for j in range(i + 1):
            begin, end = max(first, f.spans[j, 0]), min(last, f.spans[j, 1])
            normal[i, j] = dot(scaled[begin:end], f.slopes[j, begin:end]) if begin < end else 0.0
            normal[j, i] = normal[i, j]
            products += max(end - begin, 0) * (0.5 if i == j else 1.0)
    f.work[0] -= products + count * _WORK_OF_PIXEL
    return total


@kernel
def _fill(f, p):
    if f.is_disc:
        fill_disc(f.box, p, f.model, f.light, f.slopes)
    else:
        fill_points(f.box, p, f.model, f.light, f.slopes, f.spans)


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
        if f.work[0] < f.work[1]:
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
            # of a chi-square, in units of what the pixels differ from the model: the next step would be far smaller
            if gain < (0.3 if f.is_disc else 0.01) * max(total / f.pixels.shape[0], 1.0):
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
