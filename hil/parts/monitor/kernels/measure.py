"""Measurement of one frame: from an approximate pose to the measured one, by edges first searched for, then fitted."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.models import docking_view
from hil.parts.monitor.kernels.edge_samples import ARCS, BAR, SIDES, place_edge_samples
from hil.parts.monitor.kernels.edges import WHITE, allowed_pixels, fit_edge_samples
from hil.parts.monitor.kernels.pose import PRIORS, UNKNOWNS, displace_samples, fit_pose, residuals
from hil.parts.monitor.kernels.search import search_edge_samples

MEASURED, TOO_FEW, UNSOLVED = range(3)

TUNING = np.dtype(
    [
        ("length", "f8"),  # px, length of a sample along its edge
        ("most", "i8"),  # largest number of samples per edge
        ("wide_bar", "f8"),  # blur widths beyond which each side of a bar is measured as a separate edge
        ("wanted", "f8"),  # px, half width of a strip
        ("reject", "f8"),  # sigmas beyond which a sample's shift is an outlier
        ("prior", "f8", (PRIORS,)),  # prior 1 sigma of the passive angles, rad, and of the camera's unknowns
        ("near_bar", "f8"),  # px, narrower bars are not used
        ("rounds", "i8"),
    ],
    align=True,
)

CAMERA_STATE = np.dtype([("blur", "f8"), ("noise_0", "f8"), ("noise_1", "f8")], align=True)
"""Camera as estimated from the frames so far: 1 sigma of an edge, px; variance of a pixel, noise_0 + noise_1 grey."""

_SMALLEST_NOISE = 1.0 / 12.0  # rounding to whole grey values
_FEWEST = 12


@kernel
def align_pose(image, first_line, line_step, lens, circles, lines, borders, x, camera, tuning, reach, least, samples):
    """Refine ``x`` (15,), a pose with an error of several pixels, to within a fraction of a pixel.

    Return the number of samples that agree, and their fraction of all samples.
    """
    prior = np.zeros(PRIORS)
    prior[0], prior[1] = tuning.prior[0], 0.01
    normal = np.empty((UNKNOWNS, UNKNOWNS))
    agree, count = 0, 0
    for turn in range(2 if reach <= 4.0 else 3):
        width = max(reach / (1.0 + 1.5 * turn), 2.0)
        wide_bar = 2.0 * width + 4.0  # px, of which a search across the bar does not see both sides
        a = docking_view.attitude(x[3:6])
        count = place_edge_samples(lens, a, x[:3], circles, lines, borders, camera.blur, 8.0, 16,
                          wide_bar, 3.0, samples)  # fmt: skip
        displace_samples(lens, samples, count, x)
        search_edge_samples(image, first_line, line_step, samples, count, width, least)
        for robust in (width, max(0.5 * width, 1.5), max(0.25 * width, 1.0)):
            if not fit_pose(lens, samples, count, x, robust, prior, 2, normal):
                return 0, 0.0
        misfits = np.empty(count)
        residuals(lens, samples, count, x, misfits)
        agree = 0
        for c in range(count):
            if abs(misfits[c]) < 1.0:
                agree += 1
    return agree, agree / max(count, 1)


@kernel
def _update_noise(samples, count, camera):
    """Fit the pixels' variance as a function of the grey value to the residuals of the samples."""
    ratios = np.empty(count)
    n = 0
    for c in range(count):
        if samples[c].good == 1 and samples[c].pixels > 12.0:
            ratios[n] = samples[c].misfit / (samples[c].pixels - 4.0)
            n += 1
    if n < 6:
        return
    middle = np.median(ratios[:n])
    s0, s1, s2, t0, t1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for c in range(count):
        sample = samples[c]
        if sample.good != 1 or not sample.pixels > 12.0:
            continue
        ratio = sample.misfit / (sample.pixels - 4.0)
        if ratio > 2.5 * middle:
            continue
        level = min(max(0.5 * (sample.low + sample.high), 0.0), WHITE)
        variance = ratio * (camera.noise_0 + camera.noise_1 * level)
        weight = sample.pixels / (variance * variance)
        s0 += weight
        s1 += weight * level
        s2 += weight * level * level
        t0 += weight * variance
        t1 += weight * level * variance
    if not s0 > 0.0:
        return
    mean_level, mean = s1 / s0, t0 / s0
    spread = s2 - s1 * mean_level
    # a slope that the few levels of an image hardly determine is held at zero
    doubt = 1.0 / max(mean / max(mean_level, 1.0), 1e-6) ** 2
    slope = (t1 - t0 * mean_level) / (spread + doubt)
    slope = min(max(slope, 0.0), 0.9 * mean / max(mean_level, 1.0))
    camera.noise_1 = slope
    camera.noise_0 = max(mean - slope * mean_level, _SMALLEST_NOISE)


@kernel
def drop_outliers(samples, count, misfits, reject):
    """Set good = 2 if a shift is more than ``reject`` sigmas off, sigma inflated by the scatter of most shifts."""
    ratios = np.empty(count)
    n = 0
    for c in range(count):
        if samples[c].good == 1:
            ratios[n] = abs(misfits[c]) / math.sqrt(samples[c].variance)
            n += 1
    if n == 0:
        return 0
    scale = max(1.4826 * np.median(ratios[:n]), 1.0)
    kept = 0
    for c in range(count):
        if samples[c].good == 1:
            if abs(misfits[c]) > reject * scale * math.sqrt(samples[c].variance):
                samples[c].good = 2
            else:
                kept += 1
    return kept


@kernel
def square_sums(samples, count, misfits, clusters, sums):
    """Write the square sums of the residuals ``misfits`` relative to their sigmas; sums (4,).

    Square sum over the samples, number of samples; the same of the means of the straight edges and arcs, which show
    errors common to the samples of one edge.
    """
    total, n = 0.0, 0
    weights, means = np.zeros(clusters), np.zeros(clusters)
    for c in range(count):
        sample = samples[c]
        if sample.good == 1:
            total += misfits[c] * misfits[c] / sample.variance
            n += 1
            weights[sample.cluster] += 1.0 / sample.variance
            means[sample.cluster] += misfits[c] / sample.variance
    sums[0], sums[1], sums[2], sums[3] = total, n, 0.0, 0.0
    for k in range(clusters):
        if weights[k] > 0.0:
            sums[2] += means[k] * means[k] / weights[k]
            sums[3] += 1.0


@kernel
def _leave_out(samples, count, used, camera, near_bar):
    """Exclude samples of features that are not used, bars too narrow to measure, and shifts too uncertain."""
    for c in range(count):
        sample = samples[c]
        if sample.good != 1:
            continue
        if (
            used[sample.feature] == 0
            or (sample.kind == BAR and sample.width < near_bar)
            or not 0.0 < sample.variance < 0.09
        ):
            sample.good = 0
        elif sample.misfit > 6.0 * allowed_pixels(sample):
            sample.good = 3


@kernel
def measure(
    image, first_line, line_step, lens, circles, lines, borders, x, camera, tuning, used, samples, misfits, normal, sums
):
    """Measure the pose ``x`` (15,), accurate to about a pixel; return (status, number of samples).

    camera: CAMERA_STATE, updated. used: (features,), 1 if a feature is used. misfits: residuals, px.
    normal: (15, 15), of the edges alone. sums: (4,) of ``square_sums``.
    """
    prior, noise, blur_sums = tuning.prior, np.empty(2), np.empty(2)
    clusters = ARCS * circles.shape[0] + SIDES * lines.shape[0]
    count = 0
    for _ in range(tuning.rounds):
        a = docking_view.attitude(x[3:6])
        count = place_edge_samples(lens, a, x[:3], circles, lines, borders, camera.blur, tuning.length, tuning.most,
                          tuning.wide_bar * camera.blur, tuning.wanted, samples)  # fmt: skip
        displace_samples(lens, samples, count, x)
        noise[0], noise[1] = camera.noise_0, camera.noise_1
        fit_edge_samples(image, first_line, line_step, samples, count, camera.blur, noise, 1, blur_sums)
        _leave_out(samples, count, used, camera, tuning.near_bar)
        _update_noise(samples, count, camera)
        if blur_sums[1] > 0.0:
            step = min(max(blur_sums[0] / blur_sums[1], -0.3), 0.3)
            camera.blur = min(max(camera.blur + step, 0.3), 4.0)
        for _ in range(3):
            if not fit_pose(lens, samples, count, x, 0.0, prior, 1, normal):
                return UNSOLVED, count
            residuals(lens, samples, count, x, misfits)
            if drop_outliers(samples, count, misfits, tuning.reject) < _FEWEST:
                return TOO_FEW, count
    if not fit_pose(lens, samples, count, x, 0.0, prior, 1, normal):
        return UNSOLVED, count
    residuals(lens, samples, count, x, misfits)
    square_sums(samples, count, misfits, clusters, sums)
    return MEASURED, count


@kernel
def label_contrasts(image, first_line, line_step, lens, x, circles, out):
    """Write the contrast of each small circle (group < 0): mean grey inside minus that around it (nan if not visible).

    out: (circles,).
    """
    a = docking_view.attitude(x[3:6])
    p = np.empty(3)
    for i in range(circles.shape[0]):
        out[i] = np.nan
        c = circles[i]
        if c.group >= 0:
            continue
        p[0], p[1], p[2] = c.y1, c.y2, c.y3
        seen = docking_view.to_camera(a, x[:3], p)
        if seen[2] < 1e-3:
            continue
        u, v = docking_view.project_point(lens[0], lens[1], lens[2], seen)
        radius = lens[0] * c.radius / seen[2]
        out[i] = _spot(image, first_line, line_step, u, v, radius)


@kernel
def _spot(image, first_line, line_step, u, v, radius):
    """Return the mean grey value within half the radius minus that of a ring at 1.5 to 2 radii plus a pixel; or nan."""
    outer = 2.0 * radius + 1.0
    inner = max(0.5 * radius, 0.7)
    ring = 1.5 * radius + 1.0
    top, bottom = (math.ceil((v - outer - first_line) / line_step), math.floor((v + outer - first_line) / line_step))
    left, right = math.ceil(u - outer), math.floor(u + outer)
    if top < 0 or left < 0 or bottom >= image.shape[0] or right >= image.shape[1]:
        return np.nan
    low, n_low, high, n_high = 0.0, 0, 0.0, 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            distance = math.hypot(column - u, first_line + line_step * row - v)
            if distance <= inner:
                low += image[row, column]
                n_low += 1
            elif ring <= distance <= outer:
                high += image[row, column]
                n_high += 1
    if n_low == 0 or n_high == 0:
        return np.nan
    return low / n_low - high / n_high
