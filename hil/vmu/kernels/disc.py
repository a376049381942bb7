"""The image of a small bright disc: an ellipse of even brightness, blurred by a Gaussian, summed over pixels.

The ellipse is the unit disc (xi, eta) drawn to ``u + width xi + shear eta``, ``v + height eta``; width, shear
and height are in px and zero for a point of light. The disc is cut into strips of constant eta at the nodes
cos(k pi / (n + 1)) of Chebyshev's second kind, whose weight sqrt(1 - eta^2) is the strips' length; along a
strip and over the pixel the Gaussian is integrated in closed form. For n from ``strips`` the sum is good to 1e-4
of the peak or better.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel

MOST_STRIPS = 64
_ROOT_2PI = math.sqrt(2.0 * math.pi)
_TAIL_SCALE = 0.4 / math.sqrt(2.0)
_TAIL = (
    0.225675833787, 0.225675858152, 0.207615743196, 0.171699690878, 0.119326870876, 0.0825543914795, -0.0434848663588,
    0.13239546403, -0.23086792421, 0.138144084736, -0.0287351510356,
)  # fmt: skip
"""Coefficients c of exp(x^2) erfc(x) = sum c_m t^(m + 1) with t = 1 / (1 + 0.4 x), for x >= 0."""


@kernel
def strips(height, blur):
    """Return the number of strips for a disc of half-height ``height`` px under a blur of sigma ``blur`` px."""
    if height < 1e-6 * blur:
        return 1
    return min(MOST_STRIPS, 2 + math.ceil(2.4 * height / blur))


@kernel
def node(k, n):
    """Return eta of strip ``k`` of ``n``, the strip's half-length in widths, and its fraction of the disc."""
    angle = math.pi * (k + 1) / (n + 1)
    half = math.sin(angle)
    return math.cos(angle), half, 2.0 / (n + 1) * half * half


@kernel
def gauss_edges(first, count, centre, blur, z, density, rise):
    """Write z, exp(-z^2 / 2) and erf(z / sqrt 2) / 2 at the edges of ``count`` pixels from ``first`` on, (count + 1,).

    z: distance from ``centre`` in ``blur``. The edges are evenly spaced: from the one nearest to the centre, each value
    of the exponential follows from the one before. The error function is that times a polynomial, good to 5e-9.
    """
    step = 1.0 / blur
    nearest = min(max(math.floor(centre - first + 1.0), 0), count)
    at = (first - 0.5 + nearest - centre) * step
    bend = math.exp(-step * step)
    density[nearest] = math.exp(-0.5 * at * at)
    if nearest < count:
        factor = math.exp(-step * (at + 0.5 * step))
        for j in range(nearest + 1, count + 1):
            density[j] = density[j - 1] * factor
            factor *= bend
    if nearest > 0:
        factor = math.exp(step * (at - 0.5 * step))
        for j in range(nearest - 1, -1, -1):
            density[j] = density[j + 1] * factor
            factor *= bend
    for j in range(count + 1):
        z[j] = at + (j - nearest) * step
        t = 1.0 / (1.0 + _TAIL_SCALE * abs(z[j]))
        tail = _TAIL[10]
        for m in range(9, -1, -1):
            tail = tail * t + _TAIL[m]
        half = 0.5 - 0.5 * density[j] * tail * t
        rise[j] = half if z[j] >= 0.0 else -half


@kernel
def point_sums(first, count, centre, blur, edges, value, by_centre, by_blur):
    """Write the integral of a Gaussian over each of ``count`` pixels from ``first`` on, and its derivatives.

    edges: (6, count + 1), scratch.
    """
    z, density, rise = edges[0], edges[1], edges[2]
    gauss_edges(first, count, centre, blur, z, density, rise)
    scale = 1.0 / (_ROOT_2PI * blur)
    for j in range(count):
        value[j] = rise[j + 1] - rise[j]
        by_centre[j] = scale * (density[j] - density[j + 1])
        by_blur[j] = scale * (z[j] * density[j] - z[j + 1] * density[j + 1])


@kernel
def strip_sums(first, count, centre, half, blur, edges, value, by_centre, by_blur, by_half):
    """Write the integral over each pixel of a uniform strip, centre - half to centre + half, and its derivatives.

    edges: (6, count + 1), scratch.
    """
    if half < 0.02 * blur:  # the strip is a point, to second order of its length
        point_sums(first, count, centre, blur, edges, value, by_centre, by_blur)
        for j in range(count):
            by_half[j] = half / (3.0 * blur) * by_blur[j]
            value[j] += 0.5 * half * by_half[j]
        return
    right, phi_right, cdf_right = edges[0], edges[1], edges[2]
    left, phi_left, cdf_left = edges[3], edges[4], edges[5]
    gauss_edges(first, count, centre - half, blur, right, phi_right, cdf_right)
    gauss_edges(first, count, centre + half, blur, left, phi_left, cdf_left)
    scale = 0.5 / half
    below = below_centre = below_blur = below_half = 0.0
    for j in range(count + 1):
        height = (phi_right[j] - phi_left[j]) / _ROOT_2PI
        above = scale * blur * (right[j] * cdf_right[j] - left[j] * cdf_left[j] + height)
        above_centre = -scale * (cdf_right[j] - cdf_left[j])
        above_blur = scale * height
        above_half = scale * (cdf_right[j] + cdf_left[j] - 2.0 * above)
        if j > 0:
            value[j - 1] = above - below
            by_centre[j - 1] = above_centre - below_centre
            by_blur[j - 1] = above_blur - below_blur
            by_half[j - 1] = above_half - below_half
        below, below_centre, below_blur, below_half = above, above_centre, above_blur, above_half


@kernel
def add_disc(canvas, u, v, width, shear, height, blur, flux, box):
    """Add a disc's image of ``flux`` levels to ``canvas`` (h, w); write the pixels touched to box (4,).

    box: u and v of the first pixel and of the one after the last, inside the canvas; empty when outside of it.
    """
    reach_u = math.sqrt(width * width + shear * shear) + 5.5 * blur + 1.0
    reach_v = height + 5.5 * blur + 1.0
    rows, columns = canvas.shape
    box[0] = int(min(max(math.floor(u - reach_u), 0.0), columns))
    box[1] = int(min(max(math.floor(v - reach_v), 0.0), rows))
    box[2] = int(min(max(math.ceil(u + reach_u) + 1.0, 0.0), columns))
    box[3] = int(min(max(math.ceil(v + reach_v) + 1.0, 0.0), rows))
    across, down = box[2] - box[0], box[3] - box[1]
    if not (across > 0 and down > 0):
        return
    along, rest = np.empty(across), np.empty((3, across))
    up, spare = np.empty(down), np.empty((2, down))
    edges_u, edges_v = np.empty((6, across + 1)), np.empty((6, down + 1))
    n = strips(height, blur)
    for k in range(n):
        eta, half, share = (0.0, 1.0, 1.0) if n == 1 else node(k, n)
        strip_sums(box[0], across, u + shear * eta, width * half, blur, edges_u, along, rest[0], rest[1], rest[2])
        point_sums(box[1], down, v + height * eta, blur, edges_v, up, spare[0], spare[1])
        for i in range(down):
            weight = flux * share * up[i]
            for j in range(across):
                canvas[box[1] + i, box[0] + j] += weight * along[j]
