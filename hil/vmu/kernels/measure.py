"""Measurement of one component, a connected set of bright pixels: spots with the covariance of their centres."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import CLIPPED, END, FIRST, U0, U1, V0, V1, is_no_light
from hil.vmu.kernels.fit import DISC, HEIGHT, PLANE, POINT, SHEAR, SIGMA, WIDTH, U, V, fit, light_fit
from hil.vmu.kernels.peaks import find_peaks, mark_hot, start_points, sum_patch
from hil.vmu.kernels.records import AT_BORDER, MERGED, SATURATED
from hil.vmu.kernels.residuals import drop_outliers, light_noise, misfit, shape_chi_square, signal_to_noise, widened

LIMITS = np.dtype(
    [
        ("sigmas", "f8"),  # threshold of the sums of 3 x 3, in sigma
        ("least_snr", "f8"),  # least signal-to-noise ratio of a spot's flux
        ("narrowest", "f8"),  # px, sigma below which a light is a defective pixel
        ("largest", "f8"),  # px, diameter of the largest spot
    ],
    align=True,
)

MOST_PEAKS = 16
_MOST_STEPS = 12
_NOT_GAUSSIAN = 20.0  # chi-square (three degrees of freedom) above which a light is no round Gaussian
_STRONG = 30.0  # SNR above which a light's shape and noise are evaluated
_PERSPECTIVE = 2.8e-4  # 1/px
_APART_PX = 1.5  # distance of a second light from the first
_BLURS = 3.6  # sigmas of the blur beyond the edge of a disc, from which on there is no light
_WINDOW, _WINDOW_PX = 3.0, 9.0  # of a fit: largest side, relative to a component with a margin
_MENDED = 0.8  # of chi-square without the outliers, from which on it is worth looking for others
_LEFT_OVER = 6.0  # sigmas of the light that the first one leaves, in 3 x 3 pixels


@kernel
def window_box(frame, component, p, reach):
    """Return the window of a fit: ``reach`` sigmas about each point, at least the component's box, within the image."""
    row = component.row
    u0, v0 = row[U0] - 1.0, row[V0] - 1.0
    u1, v1 = row[U1] + 2.0, row[V1] + 2.0
    for a in range(PLANE, p.shape[0] - POINT + 1, POINT):
        around = reach * p[a + SIGMA] + 1.5
        u0, v0 = min(u0, p[a + U] - around), min(v0, p[a + V] - around)
        u1, v1 = max(u1, p[a + U] + around + 1.0), max(v1, p[a + V] + around + 1.0)
    box, (rows, columns) = np.empty(4, dtype=np.int64), frame.image.shape
    box[0], box[1] = int(max(u0, 0.0)), int(max(v0, 0.0))
    box[2], box[3] = int(min(u1, columns)), int(min(v1, rows))
    return box


@kernel
def start(frame, component, is_disc, p, box):
    """Return a fit of ``p`` in a window; weights are 0 for pixels of other lights or defects, else 1."""
    f = light_fit(is_disc, p, box, component.dark, frame.per_level, frame.work)
    at = 0
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            f.pixels[at] = frame.image[i, j]
            good = frame.label[i, j] == 0 or frame.label[i, j] == component.name
            f.weighed[at] = 1.0 if good else 0.0
            at += 1
    return f


@kernel
def clean(f, total):
    """Exclude the few outlier pixels, and fit again; return as ``misfit``, or NaN.

    total: result of the previous fit.
    """
    for _ in range(3):
        if not math.isfinite(total) or drop_outliers(f) <= 0:
            break
        before, total = total, fit(f, _MOST_STEPS)
        if not total < _MENDED * before:
            break  # not single pixels, but the shape
    return misfit(total, f.weighed.sum(), f.p.shape[0])


@kernel
def disc_start(p, disc):
    """Write initial parameters of a disc of the same width as the point of light ``p``."""
    for i in range(PLANE + SIGMA):
        disc[i] = p[i]
    total = p[PLANE + SIGMA]
    blur = max(0.55 * total, min(total, 0.8))
    radius = 2.0 * math.sqrt(max(total * total - blur * blur, 0.04))
    disc[PLANE + SIGMA] = blur
    disc[PLANE + WIDTH], disc[PLANE + SHEAR], disc[PLANE + HEIGHT] = radius, 0.0, radius


@kernel
def disc_of_last(last, p, disc):
    """Write initial parameters of a disc at the point of light ``p``, with the shape of the nearest spot of ``last``.

    Return False if that is no disc.
    """
    nearest, least = -1, np.inf
    for k in range(last.shape[0]):
        distance = math.hypot(last[k].u - p[PLANE + U], last[k].v - p[PLANE + V])
        if distance < least:
            nearest, least = k, distance
    if nearest < 0 or not last[nearest].blur > 0.0:
        return False
    spot = last[nearest]
    extent, along, diagonal = spot.size**2 - spot.blur**2, spot.elongation[0], spot.elongation[1]
    if not extent > abs(along):
        return False
    height = 2.0 * math.sqrt(extent - along)
    shear = 4.0 * diagonal / height
    for i in range(PLANE + SIGMA):
        disc[i] = p[i]
    disc[PLANE + SIGMA] = spot.blur
    disc[PLANE + WIDTH] = math.sqrt(max(4.0 * (extent + along) - shear * shear, 0.0))
    disc[PLANE + SHEAR], disc[PLANE + HEIGHT] = shear, height
    return True


@kernel
def pair_start(f, pair):
    """Write initial parameters of two lights: the point or disc ``f``, and one where it leaves most light.

    Return False if no light is left over.
    """
    box, p = f.box, f.p
    across, down = box[2] - box[0], box[3] - box[1]
    best, u, v, flux = _LEFT_OVER, 0.0, 0.0, 0.0
    for i in range(1, down - 1):
        for j in range(1, across - 1):
            if math.hypot(box[0] + j - p[PLANE + U], box[1] + i - p[PLANE + V]) < _APART_PX:
                continue
            excess, variance = 0.0, 0.0
            for a in range(i - 1, i + 2):
                for b in range(j - 1, j + 2):
                    at = a * across + b
                    excess += f.pixels[at] - f.model[at]
                    variance += f.dark + f.per_level * max(f.light[at], 0.0)
            if excess > best * math.sqrt(variance):
                best, u, v, flux = excess / math.sqrt(variance), box[0] + j, box[1] + i, excess
    if flux == 0.0:
        return False
    for i in range(PLANE + SIGMA):
        pair[i] = p[i]
    blur = size_of(f, PLANE)
    pair[PLANE + SIGMA] = pair[PLANE + POINT + SIGMA] = max(0.8 * blur, 0.5)
    pair[PLANE + POINT], pair[PLANE + POINT + U], pair[PLANE + POINT + V] = 1.5 * flux, u, v
    return True


@kernel
def are_two_lights(pair):
    """Return whether two points of light (11,) are apart, of one blur, and none is a halo of the other."""
    du, dv = pair[PLANE + POINT + U] - pair[PLANE + U], pair[PLANE + POINT + V] - pair[PLANE + V]
    part, alike = pair[PLANE + POINT] / pair[PLANE], pair[PLANE + POINT + SIGMA] / pair[PLANE + SIGMA]
    return du * du + dv * dv > _APART_PX**2 and 0.03 < part < 30.0 and 0.7 < alike < 1.4


@kernel
def size_of(f, a):
    """Return the RMS extent along one axis, px, of the light whose parameters start at ``a``."""
    p = f.p
    square = p[a + SIGMA] * p[a + SIGMA]
    if f.is_disc:
        square += 0.125 * (p[a + WIDTH] ** 2 + p[a + SHEAR] ** 2 + p[a + HEIGHT] ** 2)
    return math.sqrt(square)


@kernel
def size_variance(f, a):
    """Return the variance, px^4, of the square of ``size_of``."""
    slope = np.zeros(DISC)
    slope[SIGMA] = 2.0 * f.p[a + SIGMA]
    if f.is_disc:
        for i in (WIDTH, SHEAR, HEIGHT):
            slope[i] = 0.25 * f.p[a + i]
    return _variance(slope, f.covariance, a, DISC if f.is_disc else POINT)


@kernel
def write_elongation(disc):
    """Write the elongation of a disc, as ``shape_chi_square`` does for a point of light."""
    width, shear, height = disc.p[PLANE + WIDTH], disc.p[PLANE + SHEAR], disc.p[PLANE + HEIGHT]
    disc.elongation[0] = 0.125 * (width * width + shear * shear - height * height)
    disc.elongation[1] = 0.25 * shear * height
    slope = np.zeros(DISC)
    slope[WIDTH], slope[SHEAR], slope[HEIGHT] = 0.25 * width, 0.25 * shear, -0.25 * height
    disc.elongation[2] = math.sqrt(_variance(slope, disc.covariance, PLANE, DISC))


@kernel
def _variance(slope, covariance, a, n):
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += slope[i] * covariance[a + i, a + j] * slope[j]
    return max(total, 0.0)


@kernel
def write_spot(frame, component, f, a, stretch, snr, split, spot):
    """Write a light as SPOT; return False if it is too weak, too narrow, too large or outside the image.

    The centroid of a large disc is not the image of its centre: in perspective the nearer half is larger. The shift
    depends on the tilt, which is not observable from one spot; its typical size is included in the covariance.
    """
    p, box, covariance, limits = f.p, f.box, f.covariance, frame.limits
    flux, u, v = p[a], p[a + U], p[a + V]
    rows, columns = frame.image.shape
    if not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5):
        return False
    if not (box[0] - 1.0 <= u <= box[2] and box[1] - 1.0 <= v <= box[3]):
        return False
    if not (flux > 0.0 and snr > limits.least_snr):
        return False
    size = size_of(f, a)
    doubt = min(2.0 * math.sqrt(max(covariance[a + SIGMA, a + SIGMA], 0.0)), 0.2)
    if size + doubt < limits.narrowest or 4.0 * size > limits.largest:
        return False
    spot.u, spot.v = u, v
    shift = _PERSPECTIVE * (size * size - p[a + SIGMA] * p[a + SIGMA])
    spot.var_u = stretch * covariance[a + U, a + U] + shift * shift
    spot.var_v = stretch * covariance[a + V, a + V] + shift * shift
    spot.cov_uv = stretch * covariance[a + U, a + V]
    if not (spot.var_u < limits.largest**2 and spot.var_v < limits.largest**2):
        return False
    across, down = box[2] - box[0], box[3] - box[1]
    above, peak = 0.0, 0.0
    for i in range(down):
        for j in range(across):
            at = i * across + j
            if (
                f.weighed[at] != 0.0
                and abs(box[0] + j - u) < 2.0 * size + 1.5
                and abs(box[1] + i - v) < 2.0 * size + 1.5
            ):
                excess = f.pixels[at] - p[0] - p[1] * (j - 0.5 * (across - 1)) - p[2] * (i - 0.5 * (down - 1))
                above += excess
                peak = max(peak, excess)
    spot.flux = above if component.row[CLIPPED] > 0 else flux
    spot.peak, spot.size, spot.pixels = peak, size, component.row[END] - component.row[FIRST]
    spot.blur = p[a + SIGMA] if f.is_disc else 0.0
    spot.elongation[0], spot.elongation[1] = f.elongation[0], f.elongation[1]
    spot.shape_sigma[0] = math.sqrt(stretch) * f.elongation[2]
    spot.shape_sigma[1] = math.sqrt(stretch * size_variance(f, a))
    edge = min(min(u, columns - 1.0 - u), min(v, rows - 1.0 - v))
    spot.flags = 0
    if component.row[CLIPPED] > 0:
        spot.flags |= SATURATED
    if edge < 2.5 * size:
        spot.flags |= AT_BORDER
    if split:
        spot.flags |= MERGED
    return True


@kernel
def measure(frame, component, spots, count, noise):
    """Append the lights of a component to ``spots`` and return the new count.

    noise: (2,), numerator and denominator as from ``light_noise``, written here.
    """
    noise[0] = noise[1] = 0.0
    row, limits = component.row, frame.limits
    if frame.work[0] < 0.0 or is_no_light(row, limits.largest):
        return count
    hot = mark_hot(frame, component)
    patch = np.empty((row[V1] - row[V0] + 1, row[U1] - row[U0] + 1))
    sum_patch(frame, component, patch)
    if hot > 0 and patch.max() < 3.0 * limits.sigmas * math.sqrt(component.dark):
        return count
    peaks = np.empty((MOST_PEAKS, 2), dtype=np.int64)
    n_peaks = find_peaks(patch, frame, component, peaks)
    if n_peaks == 0:
        return count
    p = np.empty(PLANE + POINT * n_peaks)
    if not start_points(frame, component, peaks, n_peaks, p):
        return count
    if n_peaks == 1 and frame.last.shape[0] > 0 and count < spots.shape[0]:
        disc = np.empty(PLANE + DISC)
        if disc_of_last(frame.last, p, disc) and _follow_disc(frame, component, disc, spots[count], noise):
            return count + 1
    return _fit_and_write(frame, component, p, spots, count, noise)


@kernel
def _is_large(frame, component, box):
    """Return whether the window of a fit is larger than that of a light, or of one with so few bright pixels."""
    row, area = component.row, (box[2] - box[0]) * (box[3] - box[1])
    widest = _WINDOW * (max(row[U1] - row[U0], row[V1] - row[V0]) + _WINDOW_PX)
    return area > min(4.0 * frame.limits.largest**2, widest * widest)


@kernel
def _follow_disc(frame, component, p, spot, noise):
    """Write a single strong light as the disc that fits from the start ``p`` (10,); return False if none does."""
    around = p[: PLANE + POINT].copy()  # a point of light whose window holds the disc and its blur
    around[PLANE + SIGMA] += max(p[PLANE + WIDTH] + abs(p[PLANE + SHEAR]), p[PLANE + HEIGHT]) / _BLURS
    box = window_box(frame, component, around, _BLURS)
    if _is_large(frame, component, box):
        return False
    disc = start(frame, component, True, p, box)
    if disc.weighed.sum() <= PLANE + DISC + 2:
        return False
    chi2, allowed = clean(disc, fit(disc, _MOST_STEPS))
    snr = signal_to_noise(disc)
    if not chi2 <= allowed or not snr > _STRONG:
        return False
    write_elongation(disc)
    if not write_spot(frame, component, disc, PLANE, 1.0, snr, False, spot):
        return False
    noise[0], noise[1] = light_noise(disc)
    return True


@kernel
def _fit_and_write(frame, component, p, spots, count, noise):
    n = p.shape[0]
    n_points = (n - PLANE) // POINT
    for _ in range(2):
        box = window_box(frame, component, p, 4.3 if p[PLANE + SIGMA] < 2.0 else 3.6)
        if _is_large(frame, component, box):
            return count
        best = start(frame, component, False, p, box)
        if best.weighed.sum() <= n + 2:
            return count
        sigma = p[PLANE + SIGMA]
        total = fit(best, _MOST_STEPS)
        if not math.isfinite(total) or p[PLANE + SIGMA] < 1.25 * sigma or p[PLANE + SIGMA] > frame.limits.largest:
            break
    if not math.isfinite(total):
        if frame.work[0] < frame.work[1]:
            frame.work[2] += 1.0
        return count
    snr = signal_to_noise(best)
    strong = n_points == 1 and snr > _STRONG
    wide, shape_chi2 = widened(best), 0.0
    if strong:
        shape_chi2 = shape_chi_square(best, wide)
    kept = best.weighed.sum()
    chi2, allowed = misfit(total, kept, n)
    if shape_chi2 <= _NOT_GAUSSIAN:
        chi2, allowed = clean(best, total)
        if strong and best.weighed.sum() < kept:
            shape_chi_square(best, wide)
    if n_points == 1 and (chi2 > allowed or shape_chi2 > _NOT_GAUSSIAN):
        disc_p = np.empty(PLANE + DISC)
        disc_start(p, disc_p)
        disc = start(frame, component, True, disc_p, box)
        disc_chi2, disc_allowed = clean(disc, fit(disc, _MOST_STEPS))
        if shape_chi2 > _NOT_GAUSSIAN and not disc_chi2 <= disc_allowed:  # then not the shape, but single pixels
            chi2, allowed = clean(best, total)
            shape_chi_square(best, wide)
        if disc_chi2 < chi2:
            write_elongation(disc)
            best, chi2, allowed = disc, disc_chi2, disc_allowed
    if strong and chi2 > allowed:
        pair_p = np.empty(PLANE + 2 * POINT)
        if pair_start(best, pair_p):
            pair = start(frame, component, False, pair_p, box)
            pair_chi2, pair_allowed = clean(pair, fit(pair, 2 * _MOST_STEPS))
            if pair_chi2 <= pair_allowed and are_two_lights(pair_p):
                pair.elongation[2] = best.elongation[2]
                best, chi2, allowed, n_points = pair, pair_chi2, pair_allowed, 2
    if not math.isfinite(chi2):
        return count
    stretch = chi2 if chi2 > allowed else 1.0
    split = n_points > 1 or chi2 > 2.0 * allowed
    snr /= math.sqrt(stretch * n_points)
    first = count
    for k in range(n_points):
        a = PLANE + POINT * k
        if count < spots.shape[0] and write_spot(frame, component, best, a, stretch, snr, split, spots[count]):
            count += 1
    if count > first and chi2 < 4.0 * allowed:
        if best.is_disc:
            noise[0], noise[1] = light_noise(best)
        elif strong and n_points == 1:
            noise[0], noise[1] = light_noise(wide)
    return count
