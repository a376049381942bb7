"""Measurement of one component, a connected set of bright pixels: spots with the covariance of their centres."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.vmu.kernels.components import CLIPPED, END, FIRST, U0, U1, V0, V1
from hil.vmu.kernels.fit import DISC, HEIGHT, PLANE, POINT, SHEAR, SIGMA, WIDTH, U, V, fit
from hil.vmu.kernels.peaks import find_peaks, mark_hot, start_points, sum_patch
from hil.vmu.kernels.records import AT_BORDER, MERGED, SATURATED
from hil.vmu.kernels.residuals import SHAPE_TERMS, drop_outliers, light_noise, misfit, shape_chi_square, signal_to_noise

LIMITS = np.dtype(
    [
        ("sigmas", "f8"),  # threshold of the sums of 3 x 3, in sigma
        ("least_snr", "f8"),  # of a spot's flux
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
_APART_PX = 1.5  # of a second light from the first
_BLURS = 3.6  # sigmas of the blur beyond the edge of a disc, from which on there is no light
_LEFT_OVER = 6.0  # sigmas of the light that the first one leaves, in 3 x 3 pixels


@kernel
def window_box(shape, p, reach, component, box):
    """Write the window of a fit: ``reach`` sigmas about each point, at least the component's box, within the image."""
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
    """Write a window's levels, and weights: 0 for pixels of other lights or defects, else 1; return their sum."""
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
def clean(is_disc, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes, total):
    """Exclude the few outlier pixels, and fit again; return as ``misfit``, or NaN.

    total: result of the previous fit.
    """
    for _ in range(3):
        if not math.isfinite(total) or drop_outliers(pixels, weighed, dark, per_level, model, light) <= 0:
            break
        total = fit(is_disc, box, pixels, weighed, dark, per_level, _MOST_STEPS, p, covariance, model, light, slopes)
    return misfit(total, weighed.sum(), p.shape[0])


@kernel
def fit_and_clean(is_disc, box, pixels, weighed, dark, per_level, most, p, covariance, model, light, slopes):
    """Fit ``p`` to the pixels, and again without the few outliers; return as ``misfit``, or NaN."""
    total = fit(is_disc, box, pixels, weighed, dark, per_level, most, p, covariance, model, light, slopes)
    return clean(is_disc, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes, total)


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
def pair_start(box, p, pixels, weighed, dark, per_level, model, light, pair):
    """Write initial parameters of two lights: the point or disc ``p``, and one where it leaves most light.

    Return False if no light is left over.
    """
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
                    excess += pixels[at] - model[at]
                    variance += dark + per_level * max(light[at], 0.0)
            if excess > best * math.sqrt(variance):
                best, u, v, flux = excess / math.sqrt(variance), box[0] + j, box[1] + i, excess
    if flux == 0.0:
        return False
    for i in range(PLANE + SIGMA):
        pair[i] = p[i]
    blur = size_of(p, PLANE, p.shape[0] == PLANE + DISC)
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
def size_of(p, a, is_disc):
    """Return the RMS extent along one axis, px, of the light whose parameters start at ``a``."""
    square = p[a + SIGMA] * p[a + SIGMA]
    if is_disc:
        square += 0.125 * (p[a + WIDTH] ** 2 + p[a + SHEAR] ** 2 + p[a + HEIGHT] ** 2)
    return math.sqrt(square)


@kernel
def size_variance(p, covariance, a, is_disc):
    """Return the variance, px^4, of the square of ``size_of``."""
    slope = np.zeros(DISC)
    slope[SIGMA] = 2.0 * p[a + SIGMA]
    if is_disc:
        for i in (WIDTH, SHEAR, HEIGHT):
            slope[i] = 0.25 * p[a + i]
    return _variance(slope, covariance, a, DISC if is_disc else POINT)


@kernel
def disc_elongation(disc, covariance, elongation):
    """Write the elongation of a disc (10,), as ``shape_chi_square`` does."""
    width, shear, height = disc[PLANE + WIDTH], disc[PLANE + SHEAR], disc[PLANE + HEIGHT]
    elongation[0] = 0.125 * (width * width + shear * shear - height * height)
    elongation[1] = 0.25 * shear * height
    slope = np.zeros(DISC)
    slope[WIDTH], slope[SHEAR], slope[HEIGHT] = 0.25 * width, 0.25 * shear, -0.25 * height
    elongation[2] = math.sqrt(_variance(slope, covariance, PLANE, DISC))


@kernel
def _variance(slope, covariance, a, n):
    total = 0.0
    for i in range(n):
        for j in range(n):
            total += slope[i] * covariance[a + i, a + j] * slope[j]
    return max(total, 0.0)


@kernel
def write_spot(
    image, box, p, a, is_disc, covariance, elongation, stretch, snr, component, split, pixels, weighed, limits, spot
):
    """Write a light as SPOT; return False if it is too weak, too narrow, too large or outside the image.

    The centroid of a large disc is not the image of its centre: in perspective the nearer half is larger. The shift
    depends on the tilt, which is not observable from one spot; its typical size is included in the covariance.
    """
    flux, u, v = p[a], p[a + U], p[a + V]
    rows, columns = image.shape
    if not (-0.5 <= u <= columns - 0.5 and -0.5 <= v <= rows - 0.5):
        return False
    if not (box[0] - 1.0 <= u <= box[2] and box[1] - 1.0 <= v <= box[3]):
        return False
    if not (flux > 0.0 and snr > limits.least_snr):
        return False
    size = size_of(p, a, is_disc)
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
            if weighed[at] != 0.0 and abs(box[0] + j - u) < 2.0 * size + 1.5 and abs(box[1] + i - v) < 2.0 * size + 1.5:
                excess = pixels[at] - p[0] - p[1] * (j - 0.5 * (across - 1)) - p[2] * (i - 0.5 * (down - 1))
                above += excess
                peak = max(peak, excess)
    spot.flux = above if component[CLIPPED] > 0 else flux
    spot.peak, spot.size, spot.pixels = peak, size, component[END] - component[FIRST]
    spot.blur = p[a + SIGMA] if is_disc else 0.0
    spot.elongation[0], spot.elongation[1] = elongation[0], elongation[1]
    spot.shape_sigma[0] = math.sqrt(stretch) * elongation[2]
    spot.shape_sigma[1] = math.sqrt(stretch * size_variance(p, covariance, a, is_disc))
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
def measure(image, label, name, queue, component, level, dark, per_level, limits, last, spots, count, noise):
    """Append the lights of a component to ``spots`` and return the new count.

    level: of the background, of a sum of 3 x 3. dark: variance of a pixel without light. per_level: variance
    per level of light. last: SPOT of the image before, or none. noise: (2,), numerator and denominator as from
    ``light_noise``, written here.
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
    found = find_peaks(patch, image, background, label, name, component, dark, per_level, peaks)
    if found == 0:
        return count
    p = np.empty(PLANE + POINT * found)
    if not start_points(image, label, queue, component, background, peaks, found, p):
        return count
    if found == 1 and last.shape[0] > 0:
        disc = np.empty(PLANE + DISC)
        if disc_of_last(last, p, disc) and _follow_disc(
            image, label, name, component, dark, per_level, limits, disc, spots, count, noise
        ):  # fmt: skip
            return count + 1
    return _fit_and_write(image, label, name, component, dark, per_level, limits, p, spots, count, noise)


@kernel
def _follow_disc(image, label, name, component, dark, per_level, limits, disc, spots, count, noise):
    """Write a single strong light as the disc that fits from the start ``disc`` (10,); return False if none does."""
    if count >= spots.shape[0]:
        return False
    around = disc[: PLANE + POINT].copy()  # a point of light whose window holds the disc and its blur
    around[PLANE + SIGMA] += max(disc[PLANE + WIDTH] + abs(disc[PLANE + SHEAR]), disc[PLANE + HEIGHT]) / _BLURS
    box, covariance = np.empty(4, dtype=np.int64), np.empty((PLANE + DISC, PLANE + DISC))
    window_box(image.shape, around, _BLURS, component, box)
    size = (box[2] - box[0]) * (box[3] - box[1])
    pixels, weighed, model, light = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
    slopes = np.empty((PLANE + DISC, size))
    if size > 4.0 * limits.largest**2 or read_window(image, label, name, box, pixels, weighed) <= PLANE + DISC + 2:
        return False
    chi2, allowed = fit_and_clean(
        True, box, pixels, weighed, dark, per_level, _MOST_STEPS, disc, covariance, model, light, slopes
    )  # fmt: skip
    snr = signal_to_noise(pixels, weighed, dark, per_level, light)
    if not chi2 <= allowed or not snr > _STRONG:
        return False
    elongation = np.empty(3)
    disc_elongation(disc, covariance, elongation)
    if not write_spot(
        image, box, disc, PLANE, True, covariance, elongation, 1.0, snr, component, False, pixels, weighed, limits,
        spots[count],
    ):  # fmt: skip
        return False
    noise[0], noise[1] = light_noise(pixels, weighed, dark, per_level, light, model, slopes, covariance)
    return True


@kernel
def _fit_and_write(image, label, name, component, dark, per_level, limits, p, spots, count, noise):
    n = p.shape[0]
    found = (n - PLANE) // POINT
    box = np.empty(4, dtype=np.int64)
    covariance = np.empty((n, n))
    total = np.nan
    for _ in range(2):
        window_box(image.shape, p, 4.3 if p[PLANE + SIGMA] < 2.0 else 3.6, component, box)
        size = (box[2] - box[0]) * (box[3] - box[1])
        if size > 4.0 * limits.largest**2:
            return count
        pixels, weighed, model, light = np.empty(size), np.empty(size), np.empty(size), np.empty(size)
        slopes = np.empty((n, size))
        if read_window(image, label, name, box, pixels, weighed) <= n + 2:
            return count
        sigma = p[PLANE + SIGMA]
        total = fit(False, box, pixels, weighed, dark, per_level, _MOST_STEPS, p, covariance, model, light, slopes)
        if not math.isfinite(total) or p[PLANE + SIGMA] < 1.25 * sigma or p[PLANE + SIGMA] > limits.largest:
            break
    if not math.isfinite(total):
        return count
    snr = signal_to_noise(pixels, weighed, dark, per_level, light)
    strong = found == 1 and snr > _STRONG
    wide_model, wide, wide_inverse = (
        np.empty(size),
        np.empty((n + SHAPE_TERMS, size)),
        np.zeros((n + SHAPE_TERMS, n + SHAPE_TERMS)),
    )
    shape_chi2, elongation = 0.0, np.full(3, np.nan)
    if strong:
        shape_chi2 = shape_chi_square(
            box,
            p,
            pixels,
            weighed,
            dark,
            per_level,
            model,
            light,
            slopes,
            wide_model,
            wide,
            wide_inverse,
            elongation,
        )
    chi2, allowed = misfit(total, weighed.sum(), n)
    if shape_chi2 <= _NOT_GAUSSIAN:
        kept = weighed.sum()
        chi2, allowed = clean(
            False, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes, total
        )  # fmt: skip
        if strong and weighed.sum() < kept:
            shape_chi_square(
                box,
                p,
                pixels,
                weighed,
                dark,
                per_level,
                model,
                light,
                slopes,
                wide_model,
                wide,
                wide_inverse,
                elongation,
            )
    is_disc = False
    if found == 1 and (chi2 > allowed or shape_chi2 > _NOT_GAUSSIAN):
        disc, disc_covariance = np.empty(PLANE + DISC), np.empty((PLANE + DISC, PLANE + DISC))
        disc_model, disc_light, disc_slopes = np.empty(size), np.empty(size), np.empty((PLANE + DISC, size))
        disc_weighed = np.empty(size)
        disc_start(p, disc)
        read_window(image, label, name, box, pixels, disc_weighed)
        disc_chi2, disc_allowed = fit_and_clean(
            True, box, pixels, disc_weighed, dark, per_level, _MOST_STEPS, disc, disc_covariance, disc_model,
            disc_light, disc_slopes,
        )  # fmt: skip
        if shape_chi2 > _NOT_GAUSSIAN and not disc_chi2 <= disc_allowed:  # then not the shape, but single pixels
            chi2, allowed = clean(
                False, box, pixels, weighed, dark, per_level, p, covariance, model, light, slopes, total
            )  # fmt: skip
            shape_chi_square(
                box,
                p,
                pixels,
                weighed,
                dark,
                per_level,
                model,
                light,
                slopes,
                wide_model,
                wide,
                wide_inverse,
                elongation,
            )
        if disc_chi2 < chi2:
            disc_elongation(disc, disc_covariance, elongation)
            is_disc, p, covariance, chi2, allowed = True, disc, disc_covariance, disc_chi2, disc_allowed
            model, light, slopes, weighed = disc_model, disc_light, disc_slopes, disc_weighed
    if strong and chi2 > allowed:
        pair, pair_covariance = np.empty(PLANE + 2 * POINT), np.empty((PLANE + 2 * POINT, PLANE + 2 * POINT))
        if pair_start(box, p, pixels, weighed, dark, per_level, model, light, pair):
            pair_model, pair_light, pair_slopes = np.empty(size), np.empty(size), np.empty((PLANE + 2 * POINT, size))
            pair_weighed = np.empty(size)
            read_window(image, label, name, box, pixels, pair_weighed)
            pair_chi2, pair_allowed = fit_and_clean(
                False, box, pixels, pair_weighed, dark, per_level, 2 * _MOST_STEPS, pair, pair_covariance, pair_model,
                pair_light, pair_slopes,
            )  # fmt: skip
            if pair_chi2 <= pair_allowed and are_two_lights(pair):
                is_disc, p, covariance, chi2, allowed, found = False, pair, pair_covariance, pair_chi2, pair_allowed, 2
                model, light, slopes, weighed = pair_model, pair_light, pair_slopes, pair_weighed
                elongation[0] = elongation[1] = np.nan
    if not math.isfinite(chi2):
        return count
    stretch = chi2 if chi2 > allowed else 1.0
    split = found > 1 or chi2 > 2.0 * allowed
    snr /= math.sqrt(stretch * found)
    before = count
    for k in range(found):
        if count < spots.shape[0] and write_spot(
            image, box, p, PLANE + POINT * k, is_disc, covariance, elongation, stretch, snr, component, split, pixels,
            weighed, limits, spots[count],
        ):  # fmt: skip
            count += 1
    if count > before and chi2 < 4.0 * allowed:
        if is_disc:
            noise[0], noise[1] = light_noise(pixels, weighed, dark, per_level, light, model, slopes, covariance)
        elif strong and found == 1:
            noise[0], noise[1] = light_noise(pixels, weighed, dark, per_level, light, wide_model, wide, wide_inverse)
    return count
