"""Rendering of flat parts of a target: each pixel is weighted by the area that a part covers of it.

The area is exact for polygons: every edge adds its signed area and height to the pixels it crosses, and the running
sum along a row is the covered fraction (the accumulation of font rasterisers). There is no sampling grid, so an edge
in the image has its geometric position at any slope.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.models import docking_view

NEAREST_M = 0.02  # parts nearer to the camera's plane are clipped


@kernel
def _cut_near(points, count, out):
    """Write the part of the polygon ``points`` (count, 3), m in S, beyond NEAREST_M to ``out``; return its count."""
    kept = 0
    for i in range(count):
        j = i + 1 if i + 1 < count else 0
        here, there = points[i, 2] - NEAREST_M, points[j, 2] - NEAREST_M
        if here >= 0.0:
            for axis in range(3):
                out[kept, axis] = points[i, axis]
            kept += 1
        if (here < 0.0) != (there < 0.0):
            share = here / (here - there)
            for axis in range(3):
                out[kept, axis] = points[i, axis] + share * (points[j, axis] - points[i, axis])
            kept += 1
    return kept


@kernel
def _add_span(row, x_top, x_bottom, height):
    """Add an edge within one row to ``row`` (w + 2,): columns ``x_top`` to ``x_bottom`` over the signed ``height``."""
    low, high = min(x_top, x_bottom), max(x_top, x_bottom)
    first, last = math.floor(low), math.ceil(high)
    i, k = first, last
    if k <= i + 1:
        share = 0.5 * (low + high) - first
        row[i] += height * (1.0 - share)
        row[i + 1] += height * share
        return
    slope = 1.0 / (high - low)
    before, after = low - first, high - last + 1.0
    at_first = 0.5 * slope * (1.0 - before) * (1.0 - before)
    at_last = 0.5 * slope * after * after
    row[i] += height * at_first
    if k == i + 2:
        row[i + 1] += height * (1.0 - at_first - at_last)
    else:
        second = slope * (1.5 - before)
        row[i + 1] += height * (second - at_first)
        for column in range(i + 2, k - 1):
            row[column] += height * slope
        row[k - 1] += height * (1.0 - second - (k - i - 3) * slope - at_last)
    row[k] += height * at_last


@kernel
def _add_straight(area, x0, y0, x1, y1, sign):
    """Add an edge that runs down from y0 to y1 within the columns; ``area`` (h, w + 2)."""
    slope = (x1 - x0) / (y1 - y0)
    for line in range(math.floor(y0), min(area.shape[0], math.ceil(y1))):
        top, bottom = max(y0, float(line)), min(y1, line + 1.0)
        if bottom > top:
            left = x0 + slope * (top - y0)
            right = x0 + slope * (bottom - y0)
            low, high = min(x0, x1), max(x0, x1)
            left, right = min(max(left, low), high), min(max(right, low), high)
            _add_span(area[line], left, right, sign * (bottom - top))


@kernel
def _add_edge(area, x0, y0, x1, y1):
    """Add the edge of a polygon to ``area`` (h, w + 2); coordinates count from the image's upper left corner."""
    if y0 == y1:
        return
    sign = 1.0
    if y0 > y1:
        sign = -1.0
        x0, y0, x1, y1 = x1, y1, x0, y0
    slope = (x1 - x0) / (y1 - y0)
    top, bottom = max(y0, 0.0), min(y1, float(area.shape[0]))
    if bottom <= top:
        return
    right = float(area.shape[1] - 2)
    # an edge that leaves the image at a side continues along that side: what is left of the image still
    # covers all pixels to the right of it
    ya, yb = bottom, bottom
    if slope != 0.0:
        ya = min(max(y0 + (0.0 - x0) / slope, top), bottom)
        yb = min(max(y0 + (right - x0) / slope, top), bottom)
        if ya > yb:
            ya, yb = yb, ya
    start = top
    for stop in (ya, yb, bottom):
        if stop > start:
            xa = min(max(x0 + slope * (start - y0), 0.0), right)
            xb = min(max(x0 + slope * (stop - y0), 0.0), right)
            middle = x0 + slope * (0.5 * (start + stop) - y0)
            if middle <= 0.0:
                xa, xb = 0.0, 0.0
            elif middle >= right:
                xa, xb = right, right
            _add_straight(area, xa, start, xb, stop, sign)
            start = stop


@kernel
def _paint(image, area, top, bottom, level):
    """Blend ``level`` into ``image`` (h, w) by the fraction in ``area`` for the rows top to bottom; clear area."""
    width = image.shape[1]
    for line in range(top, bottom):
        row, share_row = image[line], area[line]
        total = 0.0
        for column in range(width):
            total += share_row[column]
            share_row[column] = 0.0
            share = abs(total)
            if share > 1e-9:
                row[column] += min(share, 1.0) * (level - row[column])
        share_row[width] = 0.0
        share_row[width + 1] = 0.0


@kernel
def draw_parts(lens, d, phi, corners, starts, levels, area, image):
    """Draw flat parts, back to front, over ``image`` (h, w), grey values.

    lens: (3,): f, cx, cy, px. d (3,), m, phi (3,), rad: the camera's pose. corners: (n, 3), m, in C; part i has the
    corners starts[i] to starts[i + 1] and the grey value levels[i]. area: (h, w + 2), all zero before and after.
    """
    a = docking_view.attitude(phi)
    y = np.empty(3)
    longest = 0
    for part in range(levels.shape[0]):
        longest = max(longest, starts[part + 1] - starts[part])
    seen, cut = np.empty((longest, 3)), np.empty((2 * longest, 3))
    for part in range(levels.shape[0]):
        count = starts[part + 1] - starts[part]
        for i in range(count):
            for axis in range(3):
                y[axis] = corners[starts[part] + i, axis]
            x = docking_view.to_camera(a, d, y)
            for axis in range(3):
                seen[i, axis] = x[axis]
        kept = _cut_near(seen, count, cut)
        if kept < 3:
            continue
        low, high = math.inf, -math.inf
        for i in range(kept):
            u, v = docking_view.project_point(lens[0], lens[1], lens[2], cut[i])
            cut[i, 0], cut[i, 1] = u + 0.5, v + 0.5
            low, high = min(low, v + 0.5), max(high, v + 0.5)
        for i in range(kept):
            j = i + 1 if i + 1 < kept else 0
            _add_edge(area, cut[i, 0], cut[i, 1], cut[j, 0], cut[j, 1])
        top = int(min(max(math.floor(low), 0.0), image.shape[0]))
        bottom = int(min(max(math.ceil(high), 0.0), image.shape[0]))
        _paint(image, area, top, bottom, levels[part])


@kernel
def expose(clean, light, glare, read, k, normals, out):
    """Write the camera's grey values to ``out`` (h, w), uint8, for the brightness ``clean`` (h, w).

    light: (4,): gain, offset in grey values, fraction by which the gain grows from the middle to the right and to the
    lower edge. glare: (m, 4): u, v, px, height in grey values, radius (1 sigma), px. Noise of variance
    ``read^2 + k level``, from the standard normals ``normals`` (h, w).
    """
    height, width = clean.shape
    for line in range(height):
        down = light[3] * (2.0 * line / (height - 1) - 1.0)
        for column in range(width):
            gain = light[0] * (1.0 + down + light[2] * (2.0 * column / (width - 1) - 1.0))
            level = gain * clean[line, column] + light[1]
            for spot in range(glare.shape[0]):
                du, dv = column - glare[spot, 0], line - glare[spot, 1]
                square = (du * du + dv * dv) / (glare[spot, 3] * glare[spot, 3])
                if square < 40.0:
                    level += glare[spot, 2] * math.exp(-0.5 * square)
            value = level + math.sqrt(read * read + k * max(level, 0.0)) * normals[line, column]
            out[line, column] = int(min(max(value + 0.5, 0.0), 255.0))
