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
_ROOT_2 = math.sqrt(2.0)
_ROOT_2PI = math.sqrt(2.0 * math.pi)


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
def point_sums(first, count, centre, blur, value, by_centre, by_blur):
    """Write the integral of a Gaussian over each of ``count`` pixels from ``first`` on, and its derivatives."""
    below = below_density = below_blur = 0.0
    for j in range(count + 1):
        z = (first - 0.5 + j - centre) / blur
        above = 0.5 * math.erf(z / _ROOT_2)
        density = math.exp(-0.5 * z * z) / (_ROOT_2PI * blur)
        above_blur = -z * density
        if j > 0:
            value[j - 1] = above - below
            by_centre[j - 1] = below_density - density
            by_blur[j - 1] = above_blur - below_blur
        below, below_density, below_blur = above, density, above_blur


@kernel
def strip_sums(first, count, centre, half, blur, value, by_centre, by_blur, by_half):
    """Write the integral over each pixel of a uniform strip, centre - half to centre + half, and its derivatives."""
    if half < 0.02 * blur:  # the strip is a point, to second order of its length
        point_sums(first, count, centre, blur, value, by_centre, by_blur)
        for j in range(count):
            by_half[j] = half / (3.0 * blur) * by_blur[j]
            value[j] += 0.5 * half * by_half[j]
        return
    scale = 0.5 / half
    below = below_centre = below_blur = below_half = 0.0
    for j in range(count + 1):
        z = first - 0.5 + j - centre
        right, left = (z + half) / blur, (z - half) / blur
        cdf_right, cdf_left = 0.5 * math.erf(right / _ROOT_2), 0.5 * math.erf(left / _ROOT_2)
        phi_right = math.exp(-0.5 * right * right) / _ROOT_2PI
        phi_left = math.exp(-0.5 * left * left) / _ROOT_2PI
        above = scale * blur * (right * cdf_right + phi_right - left * cdf_left - phi_left)
        above_centre = -scale * (cdf_right - cdf_left)
        above_blur = scale * (phi_right - phi_left)
        above_half = scale * (cdf_right + cdf_left - 2.0 * above)
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
    n = strips(height, blur)
    for k in range(n):
        eta, half, share = (0.0, 1.0, 1.0) if n == 1 else node(k, n)
        strip_sums(box[0], across, u + shear * eta, width * half, blur, along, rest[0], rest[1], rest[2])
        point_sums(box[1], down, v + height * eta, blur, up, spare[0], spare[1])
        for i in range(down):
            weight = flux * share * up[i]
            for j in range(across):
                canvas[box[1] + i, box[0] + j] += weight * along[j]
