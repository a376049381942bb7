"""Light detection: background level and noise, threshold, connected components.

All tests use the sums of 3 x 3 pixels: the noise of a sum is three times that of a pixel, and
a spot of a few pixels has nearly all of its light in one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.jit import kernel

# a component, the connected pixels of a spot; a row of int64
FIRST, END = 0, 1  # its range in the queue
U0, V0, U1, V1 = 2, 3, 4, 5  # its box, the last pixel included
CLIPPED = 6  # pixels at full scale
COMPONENT_WIDTH = 7

BAD = -1  # label of a defective pixel
LARGE = -2  # label of a pixel of a component that is too large for a light
LEFT = -3  # label of one that remains so by the lines of the present length
_SHAPED_PX, _SLENDER, _SPARSE, _FULL = 24.0, 4.0, 0.15, 0.92  # extent, and limits of the shape of lights
_APART = 24  # px, half the extent over which a texture is assessed
_TEXTURE = 2.0  # variance of the sums relative to that of noise, above which the background has a texture


class Frame(NamedTuple):
    """An image that is searched for lights, and what it is searched with.

    image: (h, w), uint8. label: (h, w), int16, number of each pixel's component, all zero before and after. queue:
    (h * w,), int32, scratch. limits: LIMITS. per_level: variance of a pixel per level of light. last: SPOT of the image
    before, whose discs are where the fits of discs begin; or none. work: (3,), products that the fits
    may still cost, those that are left to the lights after the present one, and the lights that took too many.
    """

    image: npt.NDArray[np.uint8]
    label: npt.NDArray[np.int16]
    queue: npt.NDArray[np.int32]
    limits: np.void
    per_level: float
    last: np.ndarray
    work: npt.NDArray[np.float64]


class LightComponent(NamedTuple):
    """Connected pixels of an image. name: their label. row: (COMPONENT_WIDTH,). background: level of a pixel around it.

    dark: variance of a pixel without light.
    """

    name: int
    row: npt.NDArray[np.int64]
    background: float
    dark: float


class RowScan(NamedTuple):
    """Scratch for the rows of an image. threshold: of the sums. flags (of uint8) and words (of uint64) share memory.

    sums: of columns. hits: pixels above the threshold.
    """

    threshold: npt.NDArray[np.uint16]
    sums: npt.NDArray[np.uint16]
    flags: npt.NDArray[np.uint8]
    words: npt.NDArray[np.uint64]
    hits: npt.NDArray[np.int64]


@kernel
def row_scan(columns):
    """Return scratch for rows of ``columns`` pixels."""
    words = np.zeros((columns + 7) // 8, dtype=np.uint64)
    threshold, sums = np.empty(columns, dtype=np.uint16), np.empty(columns, dtype=np.uint16)
    return RowScan(threshold, sums, words.view(np.uint8), words, np.empty(columns, dtype=np.int64))


@kernel
def sum_of_nine(image, u, v):
    """Return the sum of the 3 x 3 pixels around (u, v), which is not at the image's edge."""
    total = 0
    for i in range(v - 1, v + 2):
        for j in range(u - 1, u + 2):
            total += np.int64(image[i, j])
    return total


@kernel
def level_and_variance(image, u0, v0, u1, v1, samples):
    """Return the median of the sums in a box (u1, v1 excluded), the variance of a pixel, and the variance of a sum.

    The variance of a pixel, levels^2, is about the mean of its neighbours, from about ``len(samples)`` points on a
    grid. Sums more than four sigma off the median (light, hot pixels) are excluded. It is at least that of rounding,
    1/12. That of a sum includes the texture of the background, if this exceeds the noise.
    """
    u0, v0 = max(u0, 1), max(v0, 1)
    u1, v1 = min(u1, image.shape[1] - 1), min(v1, image.shape[0] - 1)
    if u1 <= u0 or v1 <= v0:
        return 0.0, 1.0 / 12.0, 0.75
    step = max(1, math.ceil(math.sqrt((u1 - u0) * (v1 - v0) / samples.shape[0])))
    n = 0
    for i in range(v0 + (step - 1) // 2, v1, step):
        for j in range(u0 + (step - 1) // 2, u1, step):
            if n < samples.shape[0]:
                samples[n] = sum_of_nine(image, j, i)
                n += 1
    order = np.sort(samples[:n])
    median = 0.5 * (order[(n - 1) // 2] + order[n // 2])
    reach = max(4.0 * (order[(3 * n) // 4] - order[n // 4]) / 1.349, 4.0)
    squares, used = 0.0, 0
    for i in range(v0 + (step - 1) // 2, v1, step):
        for j in range(u0 + (step - 1) // 2, u1, step):
            total = sum_of_nine(image, j, i)
            if abs(total - median) <= reach:
                square = 0
                for a in range(i - 1, i + 2):
                    for b in range(j - 1, j + 2):
                        square += np.int64(image[a, b]) * np.int64(image[a, b])
                squares += square - total * total / 9.0
                used += 1
    variance = max(squares / (8.0 * max(used, 1)), 1.0 / 12.0)
    # a sensor that clips at zero reduces its noise: to a third of its variance in full darkness
    cut = max(1.0 - median / (9.0 * 1.2 * math.sqrt(variance)), 0.0)
    variance *= 1.0 + 2.0 * cut
    texture = texture_of(image, u0, v0, u1, v1, step, samples)
    return median, variance, 9.0 * variance + max(texture - _TEXTURE * 9.0 * variance, 0.0)


@kernel
def texture_of(image, u0, v0, u1, v1, step, samples):
    """Return the variance of the sums about the mean of two others on both sides, which no gradient changes.

    Robust: light on a quarter of the samples does not raise it.
    """
    n = 0
    for i in range(v0 + (step - 1) // 2, v1, step):
        for j in range(u0 + (step - 1) // 2, u1, step):
            a, b = (_APART, 0) if (i + j) // step % 2 == 0 else (0, _APART)
            inside = i - a > 0 and j - b > 0 and i + a < image.shape[0] - 1 and j + b < image.shape[1] - 1
            if n < samples.shape[0] and inside:
                around = sum_of_nine(image, j - b, i - a) + sum_of_nine(image, j + b, i + a)
                samples[n] = sum_of_nine(image, j, i) - 0.5 * around
                n += 1
    if n < 4:
        return 0.0
    order = np.sort(samples[:n])
    wide = (order[(3 * n) // 4] - order[n // 4]) / 1.349
    return wide * wide / 1.5


@kernel
def fill_background_grid(image, level, variance, spread, samples):
    """Write level (of sums), variance (of a pixel) and spread (variance of sums) of each tile of a grid over the image.

    All (rows, columns). The variances are medians over a tile and its neighbours.
    """
    rows, columns = level.shape
    raw, raw_spread = np.empty((rows, columns)), np.empty((rows, columns))
    near = np.empty(9)
    for i in range(rows):
        v0, v1 = i * image.shape[0] // rows, (i + 1) * image.shape[0] // rows
        for j in range(columns):
            u0, u1 = j * image.shape[1] // columns, (j + 1) * image.shape[1] // columns
            level[i, j], raw[i, j], raw_spread[i, j] = level_and_variance(image, u0, v0, u1, v1, samples)
    for i in range(rows):
        for j in range(columns):
            n = 0
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, columns)):
                    near[n] = raw[a, b]
                    n += 1
            variance[i, j] = np.median(near[:n])
            n = 0
            for a in range(max(i - 1, 0), min(i + 2, rows)):
                for b in range(max(j - 1, 0), min(j + 2, columns)):
                    near[n] = raw_spread[a, b]
                    n += 1
            spread[i, j] = max(np.median(near[:n]), 9.0 * variance[i, j])


@kernel
def interpolate(grid, u, v, width, height):
    """Return the value of a ``grid`` over an image at pixel (u, v), linear between and beyond the tiles' centres."""
    rows, columns = grid.shape
    y, x = (v + 0.5) * rows / height - 0.5, (u + 0.5) * columns / width - 0.5
    i, j = min(max(int(y), 0), max(rows - 2, 0)), min(max(int(x), 0), max(columns - 2, 0))
    fy, fx = (y - i if rows > 1 else 0.0), (x - j if columns > 1 else 0.0)
    k, m = min(i + 1, rows - 1), min(j + 1, columns - 1)
    upper = grid[i, j] + fx * (grid[i, m] - grid[i, j])
    lower = grid[k, j] + fx * (grid[k, m] - grid[k, j])
    return upper + fy * (lower - upper)


@kernel
def fill_threshold(level, deviation, sigmas, v, height, threshold):
    """Write the threshold of the sums along row ``v``; level, deviation: of a sum, ``fill_background_grid``."""
    width = threshold.shape[0]
    tiles = level.shape[1]
    for j in range(max(tiles - 1, 1)):
        # the line through the centres of two neighbouring tiles, out to the edge at both ends
        left, right = (j + 0.5) * width / tiles - 0.5, (j + 1.5) * width / tiles - 0.5
        at = interpolate(level, left, v, width, height) + sigmas * interpolate(deviation, left, v, width, height)
        slope = 0.0
        if tiles > 1:
            end = interpolate(level, right, v, width, height) + sigmas * interpolate(deviation, right, v, width, height)
            slope = (end - at) / (right - left)
        first = 0 if j == 0 else math.ceil(left)
        last = width if j >= tiles - 2 else math.ceil(right)
        for u in range(first, last):
            threshold[u] = np.uint16(min(max(at + slope * (u - left), 0.0), 65535.0))


@kernel
def scan_row(above, line, below, threshold, columns, flags):
    """Flag each pixel of a row of n whose sum exceeds its threshold.

    above, line, below, threshold: (n,). columns: (n,) of uint16, scratch. flags: (n,) of uint8.
    """
    n = line.shape[0]
    for j in range(n):
        columns[j] = np.uint16(above[j]) + np.uint16(line[j]) + np.uint16(below[j])
    left, middle, right = columns[0 : n - 2], columns[1 : n - 1], columns[2:n]
    inner, limit = flags[1 : n - 1], threshold[1 : n - 1]
    for j in range(n - 2):
        inner[j] = np.uint8(np.uint16(left[j] + middle[j] + right[j]) > limit[j])


@kernel
def collect_hits(image, v, u0, u1, scan):
    """Write the pixels of row ``v`` from u0 up to u1 above their threshold to the hits of ``scan``; return how many."""
    n, count = u1 - u0, 0
    flags = scan.flags
    scan_row(
        image[v - 1, u0:u1], image[v, u0:u1], image[v + 1, u0:u1], scan.threshold[u0:u1], scan.sums[:n], flags[:n]
    )  # fmt: skip
    flags[0] = 0
    flags[n - 1] = 0
    for k in range((n + 7) // 8):
        if scan.words[k] != 0:
            for j in range(8 * k, min(8 * k + 8, n)):
                if flags[j] != 0:
                    scan.hits[count] = v * image.shape[1] + u0 + j
                    count += 1
    return count


@kernel
def flood(image, label, name, start, limit, shift, most, queue, first, component):
    """Label all pixels connected to ``start`` whose sums exceed the threshold; write their record to ``component``.

    limit: threshold of each block of 2**shift x 2**shift pixels. Pixels of other lights, and those LEFT, are none of
    it. queue: (n,), pixel indices (v * width + u), filled from ``first`` on. Return its new end, or -1 if the component
    has more than ``most`` pixels, or the queue is full.
    """
    rows, columns = image.shape
    component[FIRST] = first
    component[U0], component[V0], component[U1], component[V1] = columns, rows, -1, -1
    component[CLIPPED] = 0
    queue[first] = start
    label[start // columns, start % columns] = name
    end, at = first + 1, first
    while at < end:
        v, u = queue[at] // columns, queue[at] % columns
        at += 1
        component[U0], component[U1] = min(component[U0], u), max(component[U1], u)
        component[V0], component[V1] = min(component[V0], v), max(component[V1], v)
        if image[v, u] == 255:
            component[CLIPPED] += 1
        for side in range(4):
            i = v + (1 if side == 0 else (-1 if side == 1 else 0))
            j = u + (1 if side == 2 else (-1 if side == 3 else 0))
            if i < 1 or j < 1 or i >= rows - 1 or j >= columns - 1 or (label[i, j] != 0 and label[i, j] != LARGE):
                continue
            if sum_of_nine(image, j, i) > limit[i >> shift, j >> shift]:
                if end >= queue.shape[0] or end - first >= most:
                    return -1
                label[i, j] = name
                queue[end] = i * columns + j
                end += 1
    component[END] = end
    return end


@kernel
def is_no_light(row, largest):
    """Return whether a component (COMPONENT_WIDTH,) is too large for a light, or a rectangle, line or frame of a size.

    A light is a disc, at a slant: a fraction pi / 4 of its box.
    """
    across, down = row[U1] - row[U0] + 1.0, row[V1] - row[V0] + 1.0
    if max(across, down) < _SHAPED_PX:
        return False
    if max(across, down) - 1.0 > largest or max(across, down) > _SLENDER * min(across, down):
        return True
    filled = (row[END] - row[FIRST]) / (across * down)
    return not _SPARSE < filled < _FULL
