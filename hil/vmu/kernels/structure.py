"""Light on a background that continues on both sides of it: on a cable, a bar of a window, next to the edge of a wall.

The background of the light is interpolated between both sides, along the direction that explains its surroundings best.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import U0, U1, V0, V1

_CLEAR_PX = 6.0  # beyond the pixels above the threshold, from which on a light is dark
_DIRECTIONS = 24
_LINES = 3  # of which a side is the mean
_RING_PX = 3.0
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
    """Write the levels across the line at ``angle``, ``reach`` px before and behind (u, v), to sides (2, n)."""
    along_u, along_v, middle = math.cos(angle), math.sin(angle), sides.shape[1] // 2
    for n in range(sides.shape[1]):
        for side in range(2):
            total = 0.0
            for k in range(_LINES):
                a, c = (reach + k) * (2 * side - 1), n - middle
                total += sample(image, u + a * along_u - c * along_v, v + a * along_v + c * along_u)
            sides[side, n] = total / _LINES


@kernel
def level_between(sides, angle, reach, x, y):
    """Return the level at (x, y) from the light, interpolated between its ``sides`` along ``angle``."""
    along_u, along_v = math.cos(angle), math.sin(angle)
    c = y * along_u - x * along_v + sides.shape[1] // 2
    n, part = int(c), min(max(0.5 + 0.5 * (x * along_u + y * along_v) / reach, 0.0), 1.0)
    before = sides[0, n] + (c - n) * (sides[0, n + 1] - sides[0, n])
    return before + part * (sides[1, n] + (c - n) * (sides[1, n + 1] - sides[1, n]) - before)


@kernel
def unexplained(image, u, v, sides, angle, reach):
    """Return by how much the surroundings of a light at (u, v) differ from what its ``sides`` along ``angle`` make."""
    total, least = 0.0, reach - _RING_PX
    for i in range(max(int(v - reach), 0), min(int(v + reach) + 1, image.shape[0])):
        for j in range(max(int(u - reach), 0), min(int(u + reach) + 1, image.shape[1])):
            x, y = j - u, i - v
            if least * least < x * x + y * y < reach * reach:
                total += abs(image[i, j] - level_between(sides, angle, reach, x, y))
    return total


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
    middle = 3 * wide // 2 + 1
    sides = np.empty((2, 2 * middle + 1))
    least, angle = np.inf, 0.0
    for d in range(_DIRECTIONS):
        fill_sides(image, u, v, math.pi * d / _DIRECTIONS, reach, sides)
        apart = unexplained(image, u, v, sides, math.pi * d / _DIRECTIONS, reach)
        if apart < least:
            least, angle = apart, math.pi * d / _DIRECTIONS
    fill_sides(image, u, v, angle, reach, sides)
    for i in range(max(int(v) - wide, 0), min(int(v) + wide + 1, rows)):
        for j in range(max(int(u) - wide, 0), min(int(u) + wide + 1, columns)):
            if image[i, j] < 255:
                flat = image[i, j] - level_between(sides, angle, reach, j - u, i - v) + level
                out[i, j] = np.uint8(min(max(round(flat), 0), 254))
