"""Lights before a background of steps: walls, windows, borders of the image.

A background that has a step floods as one component, far too large for a light. Here it is taken apart: blocks of the
image have their largest sum of 3 x 3 pixels, and the background at a block is the opening of these by a line of blocks,
the largest over four directions. That is what continues over the whole line on one side at least: a wall, its edge, a
cable; a light that is shorter than the line is no part of it. Short lines first, so that lights next to an edge stand
out, then longer ones for larger lights.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import (
    END,
    FIRST,
    LARGE,
    LEFT,
    U0,
    U1,
    V0,
    V1,
    flood,
    is_no_light,
    level_and_variance,
    sum_of_nine,
)

_SHIFT = 3  # a block is 8 x 8 pixels
_LENGTHS = (3, 7, 13)  # of a line, blocks
_AROUND_PX = 12  # from a light, over which its noise is measured
_SAMPLES = 64
_PARTS = 6  # along each side of a box
_MARGIN_PX = 32  # around a window
_ABOVE = 0.3
_STRUCTURED, _OF_SIDES = 3.0, 1.3  # variance relative to noise: from which a light is flattened, and after it
_BEYOND_PX, _DIRECTIONS = 4.0, 12  # of the places around a light that it has to exceed
_FRINGE, _LARGE = 12, 300  # pixels above the threshold
_BESIDE = 3  # px


@kernel
def is_large(row, largest):
    """Return whether a component (COMPONENT_WIDTH,) is too large for a light."""
    return max(row[U1] - row[U0], row[V1] - row[V0]) > largest


@kernel
def is_fringe(label, components, k):
    """Return whether component ``k`` is a few pixels next to a large light: noise of that light's edge."""
    if components[k, END] - components[k, FIRST] > _FRINGE:
        return False
    for i in range(max(components[k, V0] - _BESIDE, 0), min(components[k, V1] + _BESIDE + 1, label.shape[0])):
        for j in range(max(components[k, U0] - _BESIDE, 0), min(components[k, U1] + _BESIDE + 1, label.shape[1])):
            other = label[i, j] - 1
            if other >= 0 and components[other, END] - components[other, FIRST] > _LARGE:
                return True
    return False


@kernel
def split_large(frame, components, lights, count):
    """Replace the components that are no lights by the lights in them; return the number of all.

    Lights that belong to none of them stay as they are. TOO_MANY, -1, if these are too many.
    """
    rows, columns = frame.image.shape
    u0, v0, u1, v1 = columns, rows, -1, -1
    for k in range(count):
        if is_no_light(components[k], frame.limits.largest):
            u0, v0 = min(u0, components[k, U0]), min(v0, components[k, V0])
            u1, v1 = max(u1, components[k, U1]), max(v1, components[k, V1])
    if u1 < 0:
        return count
    fringe = np.empty(count, np.bool_)
    for k in range(count):
        fringe[k] = is_fringe(frame.label, components, k)
    kept, end = 0, 0
    for k in range(count):
        large = is_no_light(components[k], frame.limits.largest)
        first = components[k, FIRST]
        n = components[k, END] - first
        for at in range(n):
            pixel = frame.queue[first + at]
            frame.queue[end + at] = pixel
            frame.label[pixel // columns, pixel % columns] = LARGE if large else (0 if fringe[k] else kept + 1)
        if not large and not fringe[k]:
            components[kept], lights[kept] = components[k], lights[k]
            components[kept, FIRST], components[kept, END] = end, end + n
            kept, end = kept + 1, end + n
    return lights_in(frame, u0, v0, u1 + 1, v1 + 1, components, lights, kept)


@kernel
def lights_of_steps(frame, windows, components, lights):
    """Write the lights of a background of steps, of the whole image or around ``windows`` (k, 4); return how many.

    TOO_MANY, -1, if these are too many.
    """
    rows, columns = frame.image.shape
    frame.label[:] = LARGE if windows.shape[0] == 0 else 0
    if windows.shape[0] == 0:
        return lights_in(frame, 0, 0, columns, rows, components, lights, 0)
    count = 0
    for k in range(windows.shape[0]):
        u0, v0 = max(windows[k, 0] - _MARGIN_PX, 0), max(windows[k, 1] - _MARGIN_PX, 0)
        u1, v1 = min(windows[k, 2] + _MARGIN_PX, columns), min(windows[k, 3] + _MARGIN_PX, rows)
        for v in range(v0, v1):
            for u in range(u0, u1):
                if frame.label[v, u] == 0:
                    frame.label[v, u] = LARGE
        if u0 < u1 and v0 < v1 and count >= 0:
            count = lights_in(frame, u0, v0, u1, v1, components, lights, count)
    return count


@kernel
def lights_in(frame, u0, v0, u1, v1, components, lights, count):
    """Append the lights in the pixels labelled LARGE of a box (u1, v1 excluded); return the number of components.

    TOO_MANY, -1, if these are too many. No pixel is labelled LARGE afterwards.
    """
    rows, columns = frame.image.shape
    shape = (((rows - 1) >> _SHIFT) + 1, ((columns - 1) >> _SHIFT) + 1)
    box = (u0 >> _SHIFT, v0 >> _SHIFT, ((u1 - 1) >> _SHIFT) + 1, ((v1 - 1) >> _SHIFT) + 1)
    maxima, limit, least = np.zeros(shape), np.full(shape, np.inf), np.empty(shape)
    _fill_maxima(frame.image, u0, v0, u1, v1, maxima)
    dark = _quiet_variance(frame.image, u0, v0, u1, v1)
    for length in _LENGTHS:
        if count >= 0:
            _fill_limit(frame, maxima, box, length, dark, least, limit)
            count = _flood_large(frame, maxima, box, length, limit, dark, components, lights, count)
    for v in range(v0, v1):
        for u in range(u0, u1):
            if frame.label[v, u] < 0:
                frame.label[v, u] = 0
    return count


@kernel
def _fill_maxima(image, u0, v0, u1, v1, maxima):
    """Write the largest sum of 3 x 3 pixels of each block of a box."""
    rows, columns = image.shape
    sums = np.empty(columns, np.int64)
    for v in range(max(v0, 1), min(v1, rows - 1)):
        above, line, below = image[v - 1], image[v], image[v + 1]
        for u in range(columns):
            sums[u] = np.int64(above[u]) + np.int64(line[u]) + np.int64(below[u])
        for u in range(max(u0, 1), min(u1, columns - 1)):
            total = float(sums[u - 1] + sums[u] + sums[u + 1])
            if total > maxima[v >> _SHIFT, u >> _SHIFT]:
                maxima[v >> _SHIFT, u >> _SHIFT] = total


@kernel
def _quiet_variance(image, u0, v0, u1, v1):
    """Return the variance of a pixel of a box where it has no edges: the lower quartile of that of its parts."""
    parts, samples = np.empty(_PARTS * _PARTS), np.empty(_SAMPLES)
    for i in range(_PARTS):
        for j in range(_PARTS):
            _, parts[i * _PARTS + j], _ = level_and_variance(
                image, u0 + j * (u1 - u0) // _PARTS, v0 + i * (v1 - v0) // _PARTS, u0 + (j + 1) * (u1 - u0) // _PARTS,
                v0 + (i + 1) * (v1 - v0) // _PARTS, samples,
            )  # fmt: skip
    return np.sort(parts)[_PARTS * _PARTS // 4]


@kernel
def _fill_limit(frame, maxima, box, length, dark, least, limit):
    """Write the threshold of the sums in each block of a box of blocks; lines are ``length`` blocks long.

    dark: variance of a pixel. least: scratch, the least of ``maxima`` on the line that begins at each block.
    """
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            limit[i, j] = -1.0
    for d in range(4):
        down, across = (0, 1, 1, 1)[d], (1, 0, 1, -1)[d]
        for i in range(box[1], box[3]):
            for j in range(box[0], box[2]):
                e, f = i + (length - 1) * down, j + (length - 1) * across
                if e >= box[3] or f >= box[2] or f < box[0]:
                    least[i, j] = -1.0
                    continue
                lowest = np.inf
                for k in range(length):
                    lowest = min(lowest, maxima[i + k * down, j + k * across])
                least[i, j] = lowest
        for i in range(box[1], box[3]):
            for j in range(box[0], box[2]):
                for k in range(length):
                    a, b = i - k * down, j - k * across
                    if a >= box[1] and box[0] <= b < box[2]:
                        limit[i, j] = max(limit[i, j], least[a, b])
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            level = limit[i, j]
            variance = 9.0 * (dark + frame.per_level * level / 9.0)
            # no line fits into a narrow box
            limit[i, j] = np.inf if level < 0.0 else level + frame.limits.sigmas * math.sqrt(variance)


@kernel
def stands_out(frame, row):
    """Return whether a component is a peak in all directions: a piece of an edge or a cable continues along its own.

    Its largest sum has to exceed, by a part of what it is above its surroundings, the lower one of the sums on both
    sides along each direction. A light on a bright pane is above the pane by less than above the dark frame next to it.
    """
    rows, columns = frame.image.shape
    peak, u, v = -1, 0, 0
    for at in range(row[FIRST], row[END]):
        i, j = frame.queue[at] // columns, frame.queue[at] % columns
        total = sum_of_nine(frame.image, j, i)
        if total > peak:
            peak, u, v = total, j, i
    reach = 0.5 * max(row[U1] - row[U0], row[V1] - row[V0]) + _BEYOND_PX
    lowest, highest = float(peak), 0.0
    for k in range(_DIRECTIONS):
        across, down = reach * math.cos(math.pi * k / _DIRECTIONS), reach * math.sin(math.pi * k / _DIRECTIONS)
        least = np.inf
        for side in (-1.0, 1.0):
            j, i = round(u + side * across), round(v + side * down)
            if 1 <= i < rows - 1 and 1 <= j < columns - 1:
                least = min(least, float(sum_of_nine(frame.image, j, i)))
        if least < np.inf:
            lowest, highest = min(lowest, least), max(highest, least)
    return peak - highest > _ABOVE * (peak - lowest)


@kernel
def _flood_large(frame, maxima, box, length, limit, dark, components, lights, count):
    """Append the lights above ``limit`` in the pixels labelled LARGE, of up to a line's length."""
    rows, columns = frame.image.shape
    largest = min(float(length << _SHIFT), frame.limits.largest)
    end = components[count - 1, END] if count > 0 else 0
    refused = 0
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            if not maxima[i, j] > limit[i, j]:
                continue
            for v in range(max(i << _SHIFT, 1), min((i + 1) << _SHIFT, rows - 1)):
                for u in range(max(j << _SHIFT, 1), min((j + 1) << _SHIFT, columns - 1)):
                    if frame.label[v, u] != LARGE or not sum_of_nine(frame.image, u, v) > limit[i, j]:
                        continue
                    if count == components.shape[0]:
                        return -1
                    end, taken = _flood_light(
                        frame, v * columns + u, count, largest, limit, dark, end, components, lights
                    )  # fmt: skip
                    count += taken
                    refused += 1 - taken
    if refused > 0:
        for v in range(box[1] << _SHIFT, min(box[3] << _SHIFT, rows)):
            for u in range(box[0] << _SHIFT, min(box[2] << _SHIFT, columns)):
                if frame.label[v, u] == LEFT:
                    frame.label[v, u] = LARGE
    return count


@kernel
def _flood_light(frame, start, count, largest, limit, dark, end, components, lights):
    """Flood a component from pixel ``start``; return the new end of the queue, and 1 if it may be a light, else 0."""
    columns = frame.image.shape[1]
    row = components[count]
    stop = flood(frame.image, frame.label, count + 1, start, limit, _SHIFT, frame.queue.shape[0], frame.queue, end, row)
    if is_large(row, largest) or not stands_out(frame, row):
        for at in range(end, stop):
            frame.label[frame.queue[at] // columns, frame.queue[at] % columns] = LEFT
        row[FIRST] = row[END] = end
        return end, 0
    lights[count, 0], lights[count, 1], _ = level_and_variance(
        frame.image, row[U0] - _AROUND_PX, row[V0] - _AROUND_PX, row[U1] + _AROUND_PX, row[V1] + _AROUND_PX,
        np.empty(_SAMPLES),
    )  # fmt: skip
    quiet = dark + frame.per_level * lights[count, 0] / 9.0
    lights[count, 2] = 1.0 if lights[count, 1] > _STRUCTURED * quiet else 0.0
    if lights[count, 2] > 0.0:
        lights[count, 1] = _OF_SIDES * quiet
    return stop, 1
