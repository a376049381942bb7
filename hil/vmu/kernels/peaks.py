"""Analysis of a component: defective pixels, one light or several, initial parameters of each fit."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import BAD, END, FIRST, U0, V0
from hil.vmu.kernels.fit import FLUX, PLANE, POINT, SIGMA, U, V


@kernel
def mark_hot(frame, component):
    """Label the pixels of a component that are far brighter than all their neighbours; return how many.

    No lens is that sharp: of a spot of sigma 0.5 px in mid-pixel, the next pixels have a fifth of the peak.
    """
    image, queue, background = frame.image, frame.queue, component.background
    columns, deviation = image.shape[1], math.sqrt(component.dark)
    hot = 0
    for at in range(component.row[FIRST], component.row[END]):
        v, u = queue[at] // columns, queue[at] % columns
        excess = image[v, u] - background
        if not excess > 6.0 * deviation:
            continue
        next_best = -np.inf
        for i in range(v - 1, v + 2):
            for j in range(u - 1, u + 2):
                if i != v or j != u:
                    next_best = max(next_best, image[i, j] - background)
        if next_best < 0.2 * excess + 2.0 * deviation:
            frame.label[v, u] = BAD
            hot += 1
    return hot


@kernel
def sum_patch(frame, component, patch):
    """Write the sums of 3 x 3 above the background over the component's box to ``patch``; bad pixels count as zero."""
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            v, u = component.row[V0] + i, component.row[U0] + j
            total = 0.0
            for a in range(v - 1, v + 2):
                for b in range(u - 1, u + 2):
                    if frame.label[a, b] != BAD:
                        total += frame.image[a, b] - component.background
            patch[i, j] = total


@kernel
def _is_peak(patch, i, j):
    here = patch[i, j]
    for a in range(max(i - 2, 0), min(i + 3, patch.shape[0])):
        for b in range(max(j - 2, 0), min(j + 3, patch.shape[1])):
            if patch[a, b] > here or (patch[a, b] == here and (a < i or (a == i and b < j))):
                return False
    return True


@kernel
def _dip(patch, i, j, k, m):
    """Return the minimum on the straight line between two points of a patch."""
    steps = 2 * max(abs(k - i), abs(m - j))
    least = np.inf
    for n in range(1, steps):
        part = n / steps
        least = min(least, patch[round(i + part * (k - i)), round(j + part * (m - j))])
    return least


@kernel
def _pixels_dip(frame, component, i, j, k, m):
    """Return whether the pixels between a peak i, j and a brighter one k, m of the image dip by a third and 5 sigma."""
    image, label, background = frame.image, frame.label, component.background
    here, least = image[i, j] - background, np.inf
    steps = 2 * max(abs(k - i), abs(m - j))
    for n in range(1, steps):
        part = n / steps
        v, u = round(i + part * (k - i)), round(j + part * (m - j))
        if label[v, u] != BAD:
            least = min(least, image[v, u] - background)
    sigma = math.sqrt(component.dark + frame.per_level * here)
    return label[i, j] != BAD and least < 0.67 * here and here - least > 5.0 * sigma


@kernel
def find_peaks(patch, frame, component, peaks):
    """Write the positions (row, column of ``patch``) of up to len(peaks) lights, brightest first; return how many.

    patch: from ``sum_patch``. A second light counts only if the sums between it and a brighter one dip by a sixth and
    five sigma, or the pixels of the image, which the sums blur, by a third.
    """
    count, v0, u0 = 0, component.row[V0], component.row[U0]
    least, n = 0.05 * patch.max(), 0
    height, at = np.empty(patch.size), np.empty((patch.size, 2), np.int64)
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            own = frame.label[v0 + i, u0 + j] == component.name
            if own and patch[i, j] > least and _is_peak(patch, i, j):
                height[n], at[n, 0], at[n, 1] = -patch[i, j], i, j
                n += 1
    for k in np.argsort(height[:n]):
        if count == peaks.shape[0]:
            break
        best, at_i, at_j = -height[k], at[k, 0], at[k, 1]
        sigma = math.sqrt(9.0 * component.dark + frame.per_level * best)
        apart = True
        for m in range(count):
            to_i, to_j = peaks[m, 0], peaks[m, 1]
            dip = _dip(patch, at_i, at_j, to_i, to_j)
            if not (dip < 0.83 * best and best - dip > 5.0 * sigma):
                apart = apart and _pixels_dip(frame, component, v0 + at_i, u0 + at_j, v0 + to_i, u0 + to_j)
        if apart:
            peaks[count, 0], peaks[count, 1] = at_i, at_j
            count += 1
    return count


@kernel
def start_points(frame, component, peaks, count, p):
    """Write initial parameters of ``count`` points of light: moments of the pixels nearest to each peak."""
    columns, row = frame.image.shape[1], component.row
    sums = np.zeros((count, 4))
    for at in range(row[FIRST], row[END]):
        v, u = frame.queue[at] // columns, frame.queue[at] % columns
        excess = frame.image[v, u] - component.background
        if frame.label[v, u] == BAD or not excess > 0.0:
            continue
        nearest, least = 0, np.inf
        for k in range(count):
            distance = (v - row[V0] - peaks[k, 0]) ** 2 + (u - row[U0] - peaks[k, 1]) ** 2
            if distance < least:
                nearest, least = k, distance
        sums[nearest, 0] += excess
        sums[nearest, 1] += excess * u
        sums[nearest, 2] += excess * v
        sums[nearest, 3] += excess * (u * u + v * v)
    p[0] = component.background
    p[1] = p[2] = 0.0
    for k in range(count):
        a = PLANE + POINT * k
        if not sums[k, 0] > 0.0:
            return False
        u, v = sums[k, 1] / sums[k, 0], sums[k, 2] / sums[k, 0]
        p[a + FLUX], p[a + U], p[a + V] = sums[k, 0], u, v
        p[a + SIGMA] = math.sqrt(max(0.5 * (sums[k, 3] / sums[k, 0] - u * u - v * v), 0.64))
    return True
