"""Edge measurement: fit of the blurred profile to the pixels of each edge sample, to a fraction of a pixel."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky
from hil.monitor.kernels.edge_samples import BAR

_ROOT_2PI = math.sqrt(2.0 * math.pi)
_FLAT = 4.5  # blur widths from an edge beyond which the image is taken as uniform
MOST_PIXELS = 400


@kernel
def _normal_cdf(z):
    """Return the normal distribution function and its density, to 1e-7 (Abramowitz and Stegun 7.1.26): one exp."""
    bell = math.exp(-0.5 * z * z)
    t = 1.0 / (1.0 + 0.3275911 * 0.7071067811865476 * abs(z))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    tail *= 0.5 * bell
    return 1.0 - tail if z > 0.0 else tail, bell / _ROOT_2PI


@kernel
def gather(image, first_line, line_step, sample, s, grey):
    """Write the signed distances from the edge, px, and grey values of the strip's pixels; return how many.

    image: (h, w), uint8; its row r is line ``first_line + line_step r`` of the full image.
    """
    nu, nv = sample.nu, sample.nv
    tu, tv = -nv, nu
    half = 0.5 * sample.length
    across = max(sample.inside, sample.outside)
    bow = 0.5 * sample.curvature * half * half
    reach_u = abs(nu) * (across + bow) + abs(tu) * (half + 1.0)
    reach_v = abs(nv) * (across + bow) + abs(tv) * (half + 1.0)
    top = int(max(math.ceil((sample.v - reach_v - first_line) / line_step), 0.0))
    bottom = int(min(math.floor((sample.v + reach_v - first_line) / line_step), image.shape[0] - 1.0))
    left = int(max(math.ceil(sample.u - reach_u), 0.0))
    right = int(min(math.floor(sample.u + reach_u), image.shape[1] - 1.0))
    count = 0
    for row in range(top, bottom + 1):
        dv = first_line + line_step * row - sample.v
        for column in range(left, right + 1):
            du = column - sample.u
            t = du * tu + dv * tv
            n = du * nu + dv * nv
            if sample.curvature > 0.0:
                radius = 1.0 / sample.curvature
                distance = math.hypot(t, n + radius)
                t *= radius / distance
                n = distance - radius
            if -half <= t < half and -sample.inside <= n <= sample.outside and count < s.shape[0]:
                s[count] = n
                grey[count] = image[row, column]
                count += 1
    return count


@kernel
def _plateaus(s, grey, count, inner, outer):
    """Return the mean grey values for s < inner and s > outer (nan without pixels)."""
    low, high, n_low, n_high = 0.0, 0.0, 0, 0
    for i in range(count):
        if s[i] < inner:
            low += grey[i]
            n_low += 1
        elif s[i] > outer:
            high += grey[i]
            n_high += 1
    return low / n_low if n_low else np.nan, high / n_high if n_high else np.nan


@kernel
def _middle(s, grey, count, reach):
    """Return the mean grey value for |s| < reach (nan without pixels)."""
    total, n = 0.0, 0
    for i in range(count):
        if abs(s[i]) < reach:
            total += grey[i]
            n += 1
    return total / n if n else np.nan


@kernel
def _step_row(s, blur, x, row):
    """Write the derivatives of an edge's model to (inside, outside, shift, blur); return its value."""
    z = (x[2] - s) / blur
    if abs(z) > _FLAT:
        row[0], row[1], row[2], row[3] = (1.0, 0.0, 0.0, 0.0) if z > 0.0 else (0.0, 1.0, 0.0, 0.0)
        return x[0] if z > 0.0 else x[1]
    share, bell = _normal_cdf(z)
    bell *= (x[0] - x[1]) / blur
    row[0], row[1], row[2], row[3] = share, 1.0 - share, bell, -bell * z
    return x[1] + (x[0] - x[1]) * share


@kernel
def _bar_row(s, half, blur, x, row):
    """Write the derivatives of a bar's model to (bar, outside, shift, other side); return its value."""
    z1, z2 = (s + half - x[2]) / blur, (s - half - x[2]) / blur
    g1, bell_1 = _normal_cdf(z1)
    g2, bell_2 = _normal_cdf(z2)
    row[0], row[1], row[3] = g1 - g2, g2, 1.0 - g1
    row[2] = -((x[0] - x[3]) * bell_1 + (x[1] - x[0]) * bell_2) / blur
    return x[0] * row[0] + x[1] * row[1] + x[3] * row[3]


@kernel
def fit_edge_samples(image, first_line, line_step, samples, count, blur, noise, turns, sums):
    """Fit the blurred edge (bar) to each sample's pixels: its shift, variance, grey values and misfit.

    blur: px, 1 sigma of an edge, the pixel's own width included. noise: (2,), variance of a pixel
    ``noise[0] + noise[1] * grey``. turns: number of Gauss-Newton steps. sums: (2,), gradient and weight of one more
    Gauss-Newton step in the blur.
    """
    s, grey = np.empty(MOST_PIXELS), np.empty(MOST_PIXELS)
    normal, right, step, x, row = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4), np.empty(4)
    sums[0] = sums[1] = 0.0
    for c in range(count):
        sample = samples[c]
        sample.good = 0
        bar = sample.kind == BAR
        n = gather(image, first_line, line_step, sample, s, grey)
        if n < 8:
            continue
        half = 0.5 * sample.width
        shrink = 0.5 * sample.curvature * blur * blur  # inward displacement of a blurred round edge
        x[2] = 0.0
        if bar:
            x[3], x[1] = _plateaus(s, grey, n, -half - blur, half + blur)
            middle = _middle(s, grey, n, max(0.3 * half, 0.75))
            beside = 0.5 * (x[1] + x[3])
            x[0] = beside + (middle - beside) / max(2.0 * _normal_cdf(0.7 * half / blur)[0] - 1.0, 0.2)
        else:
            for i in range(n):
                s[i] += shrink
            x[0], x[1] = _plateaus(s, grey, n, -1.2 * blur, 1.2 * blur)
            x[3] = 0.0
        if not (math.isfinite(x[0]) and math.isfinite(x[1]) and math.isfinite(x[3])):
            continue
        known = 4 if bar else 3
        solved = True
        for _ in range(turns):
            misfit = _accumulate(s, grey, n, half, blur, bar, noise, x, row, normal, right)
            factor = normal.copy()
            if not cholesky.factor(factor, known, factor, cholesky.LEAST_RESIDUE):
                solved = False
                break
            for i in range(4):
                step[i] = right[i]
            cholesky.solve(factor, known, step, step)
            step[2] = min(max(step[2], -1.5 * blur), 1.5 * blur)
            for i in range(known):
                x[i] += step[i]
                misfit -= step[i] * right[i]
        if not solved or not abs(x[2]) < 4.0 * blur + 1.0:
            continue
        _keep(sample, x, factor, known, misfit, n, bar)
        if not bar:
            _add_blur_sums(normal, right, factor, step, sums, sample)


@kernel
def _accumulate(s, grey, n, half, blur, bar, noise, x, row, normal, right):
    """Set up the normal equations of one Gauss-Newton step; return the weighted square sum of the residuals."""
    for i in range(4):
        right[i] = 0.0
        for j in range(4):
            normal[i, j] = 0.0
    total = 0.0
    for k in range(n):
        if bar:
            model = _bar_row(s[k], half, blur, x, row)
        else:
            model = _step_row(s[k], blur, x, row)
        weight = 1.0 / (noise[0] + noise[1] * max(model, 0.0))
        left = grey[k] - model
        total += weight * left * left
        for i in range(4):
            scaled = weight * row[i]
            right[i] += scaled * left
            for j in range(i + 1):
                normal[i, j] += scaled * row[j]
    return total


@kernel
def _keep(sample, x, factor, known, misfit, n, bar):
    """Write a sample's result; the shift's variance from the factor of the normal equations."""
    unit = np.zeros(4)
    unit[2] = 1.0
    cholesky.solve(factor, known, unit, unit)
    sample.shift, sample.variance = x[2], unit[2]
    sample.low, sample.high = x[0], 0.5 * (x[1] + x[3]) if bar else x[1]
    sample.misfit, sample.pixels = misfit, n
    sample.good = 1


@kernel
def _add_blur_sums(normal, right, factor, step, sums, sample):
    """Add to ``sums`` the gradient and weight of the blur after elimination of the sample's own three parameters."""
    for i in range(3):
        step[i] = normal[3, i]
    cholesky.solve(factor, 3, step, step)
    gradient, weight = right[3], normal[3, 3]
    for i in range(3):
        gradient -= step[i] * right[i]
        weight -= step[i] * normal[3, i]
    if weight > 0.0 and sample.misfit < 3.0 * sample.pixels:
        sums[0] += gradient
        sums[1] += weight
