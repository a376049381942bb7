"""From one component, the pixels of a light that touch, to spots with the covariance of their centres."""

from __future__ import annotations

import math

import numpy as np

from hil.maths.jit import kernel
from hil.vmu.kernels.fit import (
    DISC,
    FLUX,
    FULL_SCALE,
    HEIGHT,
    PLANE,
    POINT,
    SHEAR,
    SIGMA,
    WIDTH,
    U,
    V,
    fit,
    light_noise,
)
from hil.vmu.kernels.light import BAD, CLIPPED, END, FIRST, U0, U1, V0, V1
from hil.vmu.spots import AT_BORDER, MERGED, SATURATED

LIMITS = np.dtype(
    [
        ("sigmas", "f8"),  # threshold of the sums of 3 x 3, in sigma
        ("least_snr", "f8"),  # of a spot's flux
        ("narrowest", "f8"),  # px, sigma below which a light is a pixel's fault
        ("largest", "f8"),  # px, diameter of the largest spot
    ],
    align=True,
)

MOST_PEAKS = 3
_OUTLIER = 6.0  # sigma
_MOST_OUTLIERS = 3
_MOST_STEPS = 12


@kernel
def mark_hot(image, label, queue, component, background, deviation):
    """Label the pixels of a component that are far brighter than all their neighbours; return how many.

    No lens is that sharp: of a spot of sigma 0.5 px in mid-pixel, the next pixels have a fifth of the peak.
    """
    columns = image.shape[1]
    hot = 0
    for at in range(component[FIRST], component[END]):
        v, u = queue[at] // columns, queue[at] % columns
        excess = image[v, u] - background
        if not excess > 6.0 * deviation:
            continue
        next_best = -np.inf
        for i in range(v - 1, v + 2):
            for j in range(u - 1, u + 2):
                if i != v or j != u:
                    next_best = max(next_best, image[i, j] - background)
        if next_best < 0.12 * excess + 2.0 * deviation:
            label[v, u] = BAD
            hot += 1
    return hot


@kernel
def sum_patch(image, label, component, background, patch):
    """Write the sums of 3 x 3 above the background over the component's box to ``patch``; bad pixels count nothing."""
    for i in range(patch.shape[0]):
        for j in range(patch.shape[1]):
            v, u = component[V0] + i, component[U0] + j
            total = 0.0
            for a in range(v - 1, v + 2):
                for b in range(u - 1, u + 2):
                    if label[a, b] != BAD:
                        total += image[a, b] - background
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
    """Return the least value on the straight line between two places of a patch."""
    steps = 2 * max(abs(k - i), abs(m - j))
    least = np.inf
    for n in range(1, steps):
        part = n / steps
        least = min(least, patch[int(round(i + part * (k - i))), int(round(j + part * (m - j)))])
    return least


@kernel
def find_peaks(patch, label, name, component, dark, per_level, peaks):
    """Write the places (row, column of ``patch``) of up to len(peaks) lights, brightest first; return how many.

    A second light counts only where the sums between it and a brighter one dip by a sixth and five sigma.
    """
    count = 0
    before = np.inf
    while count < peaks.shape[0]:
        best, at_i, at_j = -np.inf, -1, -1
        for i in range(patch.shape[0]):
            for j in range(patch.shape[1]):
                if best < patch[i, j] < before and _is_peak(patch, i, j):
                    if label[component[V0] + i, component[U0] + j] == name:
                        best, at_i, at_j = patch[i, j], i, j
        if at_i < 0 or not best > 0.05 * patch.max():
            break
        before = best
        sigma = math.sqrt(9.0 * dark + per_level * best)
        apart = True
        for k in range(count):
            dip = _dip(patch, at_i, at_j, peaks[k, 0], peaks[k, 1])
            if not (dip < 0.83 * best and best - dip > 5.0 * sigma):
                apart = False
        if apart:
            peaks[count, 0], peaks[count, 1] = at_i, at_j
            count += 1
    return count


@kernel
def start_points(image, label, queue, component, background, peaks, count, p):
    """Write first parameters of ``count`` points of light: moments of the pixels nearest to each peak."""
    columns = image.shape[1]
    sums = np.zeros((count, 4))
    for at in range(component[FIRST], component[END]):
        v, u = queue[at] // columns, queue[at] % columns
        excess = image[v, u] - background
        if label[v, u] == BAD or not excess > 0.0:
            continue
        nearest, least = 0, np.inf
        for k in range(count):
            distance = (v - component[V0] - peaks[k, 0]) ** 2 + (u - component[U0] - peaks[k, 1]) ** 2
            if distance < least:
                nearest, least = k, distance
        sums[nearest, 0] += excess
        sums[nearest, 1] += excess * u
        sums[nearest, 2] += excess * v
        sums[nearest, 3] += excess * (u * u + v * v)
    p[0] = background
    p[1] = p[2] = 0.0
    for k in range(count):
        a = PLANE + POINT * k
        if not sums[k, 0] > 0.0:
            return False
        u, v = sums[k, 1] / sums[k, 0], sums[k, 2] / sums[k, 0]
        p[a + FLUX], p[a + U], p[a + V] = sums[k, 0], u, v
        p[a + SIGMA] = math.sqrt(max(0.5 * (sums[k, 3] / sums[k, 0] - u * u - v * v), 0.64))
    return True


@kernel
def window_box(shape, p, reach, component, box):
    """Write the window of a fit: ``reach`` sigmas about each point, the component's box at least, in the image."""
    u0, v0 = component[U0] - 1.0, component[V0] - 1.0
    u1, v1 = component[U1] + 2.0, component[V1] + 2.0
    for a in range(PLANE, p.shape[0] - POINT + 1, POINT):
        around = reach * p[a + SIGMA] + 1.5
        u0, v0 = min(u0, p[a + U] - around), min(v0, p[a + V] - around)
        u1, v1 = max(u1, p[a + U] + around + 1.0), max(v1, p[a + V] + around + 1.0)
    box[0], box[1] = int(max(u0, 0.0)), int(max(v0, 0.0))
    box[2], box[3] = int(min(u1, shape[1])), int(min(v1, shape[0]))


@kernel
def read_window(image, label, name, box, pixels, weighed):
    """Write a window's levels, and 0 for each pixel that another light or a fault has, else 1; return how many ones."""
    at = used = 0
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            pixels[at] = image[i, j]
            good = label[i, j] == 0 or label[i, j] == name
            weighed[at] = 1.0 if good else 0.0
            used += 1 if good else 0
            at += 1
    return used


@kernel
def drop_outliers(pixels, weighed, dark, per_level, model, light):
    """Leave out the pixels that are far off the model, if they are few; return how many, or -1 for too many."""
    found = np.empty(_MOST_OUTLIERS, dtype=np.int64)
    count = 0
    for at in range(pixels.shape[0]):
        if weighed[at] == 0.0 or (pixels[at] >= FULL_SCALE and model[at] >= FULL_SCALE):
            continue
        gap = pixels[at] - model[at]
        if gap * gap > _OUTLIER * _OUTLIER * (dark + per_level * max(light[at], 0.0)):
            if count == _MOST_OUTLIERS:
                return -1
            found[count] = at
            count += 1
    for k in range(count):
        weighed[found[k]] = 0.0
    return count


@kernel
def misfit(total, used, parameters):
    """Return the sum of squares per degree of freedom, and how much of it chance allows (5 sigma)."""
    freedom = max(used - parameters, 1)
    return total / freedom, 1.0 + 5.0 * math.sqrt(2.0 / freedom)


@kernel
def fit_cleaned(is_disc, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes):
    """Fit, leave out the few pixels that do not belong, and fit again. Return as ``misfit``, or NaN."""
    n = p.shape[0]
    total = fit(is_disc, box, pixels, weighed, dark, per_level, _MOST_STEPS, p, covariance, model, light, slopes)
    for _ in range(2):
        if not math.isfinite(total) or drop_outliers(pixels, weighed, dark, per_level, model, light) <= 0:
            break
        total = fit(is_disc, box, pixels, weighed, dark, per_level, _MOST_STEPS, p, covariance, model, light, slopes)
    return misfit(total, weighed.sum(), n)


@kernel
def disc_start(p, disc):
    """Write first parameters of a disc that is as wide as the point of light ``p``."""
    for i in range(PLANE + SIGMA):
        disc[i] = p[i]
    total = p[PLANE + SIGMA]
    blur = max(0.55 * total, min(total, 0.8))
    radius = 2.0 * math.sqrt(max(total * total - blur * blur, 0.04))
    disc[PLANE + SIGMA] = blur
    disc[PLANE + WIDTH], disc[PLANE + SHEAR], disc[PLANE + HEIGHT] = radius, 0.0, radius


@kernel
def size_of(p, a, is_disc):
    """Return the RMS extent along one axis, px, of the light whose parameters begin at ``a``."""
    square = p[a + SIGMA] * p[a + SIGMA]
    if is_disc:
        square += 0.125 * (p[a + WIDTH] ** 2 + p[a + SHEAR] ** 2 + p[a + HEIGHT] ** 2)
    return math.sqrt(square)


@kernel
def write_spot(image, box, p, a, is_disc, covariance, stretch, component, split, pixels, weighed, limits, spot):
    """Write a light as SPOT; return False where it is none: too weak, too narrow, too large, not in the image."""
    flux, u, v = p[a], p[a + U], p[a + V]
    rows, columns = image.shape
    if not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5):
        return False
    if not (box[0] - 1.0 <= u <= box[2] and box[1] - 1.0 <= v <= box[3]):
        return False
    spread = math.sqrt(max(covariance[a, a], 0.0) * stretch)
    if not flux > limits.least_snr * spread:
        return False
    size = size_of(p, a, is_disc)
    least = 2.0 * math.sqrt(max(covariance[a + SIGMA, a + SIGMA], 0.0)) if not is_disc else 0.0
    if size + least < limits.narrowest or 4.0 * size > limits.largest:
        return False
    spot.u, spot.v = u, v
    spot.var_u, spot.var_v = stretch * covariance[a + U, a + U], stretch * covariance[a + V, a + V]
    spot.cov_uv = stretch * covariance[a + U, a + V]
    if not (spot.var_u < limits.largest**2 and spot.var_v < limits.largest**2):
        return False
    across, down = box[2] - box[0], box[3] - box[1]
    above, peak = 0.0, 0.0
    for i in range(down):
        for j in range(across):
            at = i * across + j
            if weighed[at] != 0.0 and abs(box[0] + j - u) < 2.0 * size + 1.5 and abs(box[1] + i - v) < 2.0 * size + 1.5:
                excess = pixels[at] - p[0] - p[1] * (j - 0.5 * (across - 1)) - p[2] * (i - 0.5 * (down - 1))
                above += excess
                peak = max(peak, excess)
    spot.flux = above if component[CLIPPED] > 0 else flux
    spot.peak, spot.size, spot.pixels = peak, size, component[END] - component[FIRST]
    edge = min(min(u, columns - 1.0 - u), min(v, rows - 1.0 - v))
    spot.flags = 0
    if component[CLIPPED] > 0:
        spot.flags |= SATURATED
    if edge < 2.5 * size:
        spot.flags |= AT_BORDER
    if split:
        spot.flags |= MERGED
    return True


@kernel
def measure(image, label, name, queue, component, level, dark, per_level, limits, spots, count, noise):
    """Append the lights of a component to ``spots`` and return the new count.

    level: of the background, of a sum of 3 x 3. dark: variance of a pixel without light. per_level: variance
    per level of light. noise: (2,), numerator and denominator as of ``light_noise``, written here.
    """
    noise[0] = noise[1] = 0.0
    background, deviation = level / 9.0, math.sqrt(dark)
    if max(component[U1] - component[U0], component[V1] - component[V0]) > limits.largest:
        return count
    hot = mark_hot(image, label, queue, component, background, deviation)
    patch = np.empty((component[V1] - component[V0] + 1, component[U1] - component[U0] + 1))
    sum_patch(image, label, component, background, patch)
    if hot > 0 and patch.max() < 3.0 * limits.sigmas * deviation:
        return count
    peaks = np.empty((MOST_PEAKS, 2), dtype=np.int64)
    found = find_peaks(patch, label, name, component, dark, per_level, peaks)
    if found == 0:
        return count
    p = np.empty(PLANE + POINT * found)
    if not start_points(image, label, queue, component, background, peaks, found, p):
        return count
    return _fit_and_write(
        image, label, name, component, dark, per_level, limits, p, background, spots, count, noise
    )  # fmt: skip


@kernel
def _fit_and_write(image, label, name, component, dark, per_level, limits, p, background, spots, count, noise):
    found = (p.shape[0] - PLANE) // POINT
    box = np.empty(4, dtype=np.int64)
    chi2, allowed, first_sigma = np.nan, np.nan, 0.0
    is_disc = False
    for attempt in range(2):
        window_box(image.shape, p, 4.3, component, box)
        size = (box[2] - box[0]) * (box[3] - box[1])
        if size > 4.0 * limits.largest**2:
            return count
        pixels, weighed, model, light = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
        slopes = np.empty((size, max(p.shape[0], PLANE + DISC)))
        if read_window(image, label, name, box, pixels, weighed) <= p.shape[0] + 2:
            return count
        covariance = np.empty((p.shape[0], p.shape[0]))
        first_sigma = p[PLANE + SIGMA]
        chi2, allowed = fit_cleaned(
            False, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes[:, : p.shape[0]]
        )  # fmt: skip
        if not math.isfinite(chi2) or p[PLANE + SIGMA] < 1.25 * first_sigma or p[PLANE + SIGMA] > limits.largest:
            break
    if not math.isfinite(chi2):
        return count
    if found == 1 and chi2 > allowed and p[PLANE + SIGMA] > 0.9:
        disc, disc_covariance = np.empty(PLANE + DISC), np.empty((PLANE + DISC, PLANE + DISC))
        disc_start(p, disc)
        kept = weighed.copy()
        read_window(image, label, name, box, pixels, weighed)
        disc_chi2, disc_allowed = fit_cleaned(
            True, box, pixels, weighed, dark, per_level, disc, disc_covariance, model, light, slopes
        )  # fmt: skip
        if math.isfinite(disc_chi2) and disc_chi2 < 0.9 * chi2:
            is_disc, p, covariance, chi2, allowed = True, disc, disc_covariance, disc_chi2, disc_allowed
        else:
            weighed = kept
            n = p.shape[0]
            fit(False, box, pixels, weighed, dark, per_level, 0, p, covariance, model, light, slopes[:, :n])
    stretch = chi2 if chi2 > allowed else 1.0
    before = count
    for k in range(found):
        if count < spots.shape[0]:
            split = found > 1 or chi2 > 2.0 * allowed
            a = PLANE + POINT * k
            if write_spot(
                image, box, p, a, is_disc, covariance, stretch, component, split, pixels, weighed, limits, spots[count]
            ):  # fmt: skip
                count += 1
    if found == 1 and count > before and chi2 < 4.0 * allowed:
        n = p.shape[0]
        noise[0], noise[1] = light_noise(
            pixels, weighed, dark, per_level, light, model, slopes[:, :n], covariance
        )  # fmt: skip
    return count
