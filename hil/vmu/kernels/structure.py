"""Light on a background that continues on both sides of it: on a cable, a bar of a window, next to the edge of a wall.

Along the direction in which both sides look most alike, what lies behind the light is interpolated between them.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import U0, U1, V0, V1

_CLEAR_PX = 6.0  # beyond the pixels above the threshold, from which on a light is dark
_DIRECTIONS = 24
_LINES = 5  # of which a side is the mean
_BESIDE_PX = 8  # over which the background of a fit extends beyond
_MARGIN_PX = 40


@kernel
def sample(image, u, v):
    """Return the level of an image at (u, v), linear between the pixels, that of its edge beyond."""
    u, v = min(max(u, 0.0), image.shape[1] - 1.001), min(max(v, 0.0), image.shape[0] - 1.001)
    j, i = int(u), int(v)
    x, y = u - j, v - i
    above = image[i, j] * (1.0 - x) + image[i, j + 1] * x
    return above * (1.0 - y) + (image[i + 1, j] * (1.0 - x) + image[i + 1, j + 1] * x) * y


@kernel
def fill_sides(image, u, v, angle, reach, sides):
    """Write the levels across the line through (u, v) at ``angle``, ``reach`` px before and behind it, to sides (2, n).

    Return by how much they differ on the whole over the light.
    """
    along_u, along_v, middle = math.cos(angle), math.sin(angle), sides.shape[1] // 2
    apart = 0.0
    for n in range(sides.shape[1]):
        for side in range(2):
            total = 0.0
            for k in range(_LINES):
                a, c = (reach + k) * (2 * side - 1), n - middle
                total += sample(image, u + a * along_u - c * along_v, v + a * along_v + c * along_u)
            sides[side, n] = total / _LINES
        if abs(n - middle) <= reach:
            apart += abs(sides[1, n] - sides[0, n])
    return apart


@kernel
def flatten(image, row, level, out):
    """Write the image around a component (COMPONENT_WIDTH,) to ``out`` (h, w), with ``level`` as its background."""
    rows, columns = image.shape
    u, v = 0.5 * (row[U0] + row[U1]), 0.5 * (row[V0] + row[V1])
    half = 0.5 * max(row[U1] - row[U0], row[V1] - row[V0])
    reach, wide = half + _CLEAR_PX, int(half + _CLEAR_PX) + _BESIDE_PX
    around = int(4.0 * half) + _MARGIN_PX
    for i in range(max(int(v) - around, 0), min(int(v) + around + 1, rows)):
        for j in range(max(int(u) - around, 0), min(int(u) + around + 1, columns)):
            out[i, j] = image[i, j]
    middle = 2 * wide
    sides, tried = np.empty((2, 2 * middle + 1)), np.empty((2, 2 * middle + 1))
    least, angle = np.inf, 0.0
    for d in range(_DIRECTIONS):
        apart = fill_sides(image, u, v, math.pi * d / _DIRECTIONS, reach, tried)
        if apart < least:
            least, angle = apart, math.pi * d / _DIRECTIONS
    fill_sides(image, u, v, angle, reach, sides)
    along_u, along_v = math.cos(angle), math.sin(angle)
    for i in range(max(int(v) - wide, 0), min(int(v) + wide + 1, rows)):
        for j in range(max(int(u) - wide, 0), min(int(u) + wide + 1, columns)):
            if image[i, j] == 255:
                continue
            a, c = (j - u) * along_u + (i - v) * along_v, (i - v) * along_u - (j - u) * along_v + middle
            n, part = int(c), min(max(0.5 + 0.5 * a / reach, 0.0), 1.0)
            before = sides[0, n] + (c - n) * (sides[0, n + 1] - sides[0, n])
            behind = sides[1, n] + (c - n) * (sides[1, n + 1] - sides[1, n])
            flat = image[i, j] - (before + part * (behind - before)) + level
            out[i, j] = np.uint8(min(max(round(flat), 0), 254))
