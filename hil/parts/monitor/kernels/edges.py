"""Edge measurement: fit of the blurred profile to the pixels of each edge sample, to a fraction of a pixel.

Pixels at full scale are censored: the light is not below it. The profile exceeds full scale where the image is
overexposed, and its shift follows from the pixels of the slope that are not clipped. Near black the noise is cut off at
zero, which raises the mean of a pixel and would shift the border of a dark background by hundredths of a pixel.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import cholesky
from hil.parts.monitor.kernels.edge_samples import BAR

_DENSITY = 1.0 / math.sqrt(2.0 * math.pi)
_ROOT_HALF = math.sqrt(0.5)
_FLAT = 4.5  # blur widths from an edge beyond which the image is taken as uniform
MOST_PIXELS = 400
WHITE = 255.0  # full scale
MODEL_ERROR_PX = 0.03  # of the profile, which is no noise of the pixels
_CLIPPED_TURNS = 8  # Gauss-Newton steps of a profile that is cut off
_CLIPPED_START = 1.25  # of full scale: first value of a level that is cut off
_CLIPPED_MOST = 8.0  # of full scale
_DAMPING = 1e-4  # of such a level, per grey value squared
_BLACK = 0.4  # sigmas above zero of a level whose noise is partly visible: the mean of a pixel without light
_MISFIT = 3.0  # misfit per pixel of a bar beyond which one of its borders alone may be better
_LESS = 0.5  # of that misfit, which it then must not exceed


@kernel
def _normal_cdf(z):
    """Return the normal distribution function and its density, to 1e-7 (Abramowitz and Stegun 7.1.26): one exp."""
    bell = math.exp(-0.5 * z * z)
    t = 1.0 / (1.0 + 0.3275911 * _ROOT_HALF * abs(z))
    tail = t * (0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429))))
    tail *= 0.5 * bell
    return 1.0 - tail if z > 0.0 else tail, bell * _DENSITY


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
    radius = 1.0 / sample.curvature if sample.curvature > 0.0 else 0.0
    count = 0
    for row in range(top, bottom + 1):
        dv = first_line + line_step * row - sample.v
        for column in range(left, right + 1):
            du = column - sample.u
            t = du * tu + dv * tv
            n = du * nu + dv * nv
            if sample.curvature > 0.0:
                distance = math.sqrt(t * t + (n + radius) * (n + radius))
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
def _step_row(s, sharpness, x):
    """Return the value of an edge's model and its derivatives to (inside, outside, shift, blur)."""
    z = (x[2] - s) * sharpness
    if z > _FLAT:
        return x[0], 1.0, 0.0, 0.0, 0.0
    if z < -_FLAT:
        return x[1], 0.0, 1.0, 0.0, 0.0
    share, bell = _normal_cdf(z)
    bell *= (x[0] - x[1]) * sharpness
    return x[1] + (x[0] - x[1]) * share, share, 1.0 - share, bell, -bell * z


@kernel
def _bar_row(s, half, sharpness, x):
    """Return the value of a bar's model and its derivatives to (bar, outside, shift, other side)."""
    g1, bell_1 = _normal_cdf((s + half - x[2]) * sharpness)
    g2, bell_2 = _normal_cdf((s - half - x[2]) * sharpness)
    shift = -((x[0] - x[3]) * bell_1 + (x[1] - x[0]) * bell_2) * sharpness
    return x[0] * (g1 - g2) + x[1] * g2 + x[3] * (1.0 - g1), g1 - g2, g2, shift, 1.0 - g1


@kernel
def fit_edge_samples(image, first_line, line_step, samples, count, blur, noise, turns, sums):
    """Fit the blurred edge (bar) to each sample's pixels: its shift, variance, grey values and misfit.

    blur: px, 1 sigma of an edge, the pixel's own width included. noise: (2,), variance of a pixel
    ``noise[0] + noise[1] * grey``. turns: number of Gauss-Newton steps. sums: (2,), gradient and weight of one more
    Gauss-Newton step in the blur.
    """
    s, grey = np.empty(MOST_PIXELS), np.empty(MOST_PIXELS)
    normal, right, step, x = np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4)
    factor = np.empty((4, 4))
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
        n_fitted = 4 if bar else 3
        misfit, clear = _fit_profile(
            s, grey, n, half, blur, bar, noise, n_fitted, turns, x, normal, right, factor, step
        )  # fmt: skip
        if clear >= n_fitted and abs(x[2]) < 4.0 * blur + 1.0:
            _keep(sample, x, normal, factor, n_fitted, misfit, clear, 0.0 if bar else 1.0)
            if not bar:
                _add_blur_sums(normal, right, factor, step, sums, sample)
        if bar and not (sample.good == 1 and sample.misfit <= _MISFIT * allowed_pixels(sample)):
            _fit_one_border(s, grey, n, half, blur, noise, x, normal, right, factor, step, sample)


@kernel
def allowed_pixels(sample):
    """Return the square sum that is expected of a sample's pixels, by their noise and an error of the profile."""
    return sample.pixels + MODEL_ERROR_PX * MODEL_ERROR_PX * sample.steepness


@kernel
def _fit_one_border(s, grey, n, half, blur, noise, x, normal, right, factor, step, sample):
    """Measure a bar by one of its borders if that fits much better: a shadow or a glare is next to the other one."""
    least = sample.misfit / allowed_pixels(sample) if sample.good == 1 else math.inf
    own, levels = np.empty(n), np.empty(n)
    for way in (1.0, -1.0):
        count = 0
        for i in range(n):
            if way * s[i] > 0.0:
                own[count], levels[count] = way * s[i], grey[i]
                count += 1
        inner = _middle(own, levels, count, 0.5 * half)
        _, outer = _plateaus(own, levels, count, 0.0, half + blur)
        if not (math.isfinite(inner) and math.isfinite(outer)):
            continue
        x[0], x[1], x[2], x[3] = inner, outer, 0.0, outer
        misfit, clear = _fit_profile(
            own, levels, count, half, blur, True, noise, 3, 4, x, normal, right, factor, step
        )  # fmt: skip
        if clear < 8 or not abs(x[2]) < 4.0 * blur + 1.0:
            continue
        expected = clear + MODEL_ERROR_PX * MODEL_ERROR_PX * normal[2, 2]
        if misfit / expected < min(_LESS * least, _MISFIT):
            least = misfit / expected / _LESS  # the other border has to be better only by itself
            _keep(sample, x, normal, factor, 3, misfit, clear, way)
            sample.shift *= way


@kernel
def _fit_profile(s, grey, n, half, blur, bar, noise, n_fitted, turns, x, normal, right, factor, step):
    """Improve the first ``n_fitted`` parameters ``x`` (4,) of a profile by its pixels.

    Return the weighted square sum of the residuals, and the number of pixels that are not clipped or -1 without a
    solution. normal, right and factor are those of the last step.
    """
    near_white = WHITE - math.sqrt(noise[0] + noise[1] * WHITE)
    cut = False
    for i in (0, 1, 3):
        if x[i] > near_white and (i < 3 or bar):
            x[i], cut = _CLIPPED_START * WHITE, True
    misfit, clear = 0.0, 0
    for _ in range(max(turns, _CLIPPED_TURNS) if cut else turns):
        misfit, clear = _accumulate(s, grey, n, half, blur, bar, noise, x, normal, right)
        for i in range(4):
            for j in range(4):
                factor[i, j] = normal[i, j]
            if cut and i != 2:
                factor[i, i] += _DAMPING
        if not cholesky.factor(factor, n_fitted, factor, cholesky.LEAST_RESIDUE):
            return misfit, -1
        for i in range(4):
            step[i] = right[i]
        cholesky.solve(factor, n_fitted, step, step)
        step[2] = min(max(step[2], -1.5 * blur), 1.5 * blur)
        for i in range(n_fitted):
            x[i] += step[i]
            misfit -= step[i] * right[i]
        if cut:
            for i in (0, 1, 3):
                x[i] = min(x[i], _CLIPPED_MOST * WHITE)
    return misfit, clear


@kernel
def _accumulate(s, grey, n, half, blur, bar, noise, x, normal, right):
    """Set up the normal equations of one Gauss-Newton step.

    Return the weighted square sum of the residuals, and the number of pixels that are not clipped.
    """
    sigma, dark = math.sqrt(noise[0] + noise[1] * WHITE), math.sqrt(noise[0])
    clipped = WHITE - 3.0 * sigma
    nearly_black = 3.0 * dark if min(x[0], x[1]) > _BLACK * dark and not (bar and x[3] < _BLACK * dark) else -math.inf
    clear, sharpness, total = n, 1.0 / blur, 0.0
    r0 = r1 = r2 = r3 = 0.0  # sums in registers
    n00 = n10 = n11 = n20 = n21 = n22 = n30 = n31 = n32 = n33 = 0.0
    for k in range(n):
        if bar:
            model, d0, d1, d2, d3 = _bar_row(s[k], half, sharpness, x)
        else:
            model, d0, d1, d2, d3 = _step_row(s[k], sharpness, x)
        weight = 1.0 / (noise[0] + noise[1] * min(max(model, 0.0), WHITE))
        if model > clipped and grey[k] > clipped:  # mean of a noisy value that is cut off at full scale
            z = (WHITE - model) / sigma
            below, bell = _normal_cdf(z)
            model = WHITE - sigma * (z * below + bell)
            d0, d1, d2, d3 = below * d0, below * d1, below * d2, below * d3
            if below < 0.5:
                clear -= 1
        elif model < nearly_black:  # the same at zero
            above, bell = _normal_cdf(model / dark)
            mean = model * above + dark * bell
            weight = 1.0 / (model * mean + dark * dark * above - mean * mean)
            model = mean
            d0, d1, d2, d3 = above * d0, above * d1, above * d2, above * d3
        residual = grey[k] - model
        total += weight * residual * residual
        w0, w1, w2, w3 = weight * d0, weight * d1, weight * d2, weight * d3
        r0, r1, r2, r3 = r0 + w0 * residual, r1 + w1 * residual, r2 + w2 * residual, r3 + w3 * residual
        n00, n10, n11, n20, n21 = n00 + w0 * d0, n10 + w1 * d0, n11 + w1 * d1, n20 + w2 * d0, n21 + w2 * d1
        n22, n30, n31, n32, n33 = n22 + w2 * d2, n30 + w3 * d0, n31 + w3 * d1, n32 + w3 * d2, n33 + w3 * d3
    right[0], right[1], right[2], right[3] = r0, r1, r2, r3
    normal[:] = 0.0
    normal[0, 0], normal[1, 0], normal[1, 1], normal[2, 0], normal[2, 1] = n00, n10, n11, n20, n21
    normal[2, 2], normal[3, 0], normal[3, 1], normal[3, 2], normal[3, 3] = n22, n30, n31, n32, n33
    return total, clear


@kernel
def _keep(sample, x, normal, factor, n_fitted, misfit, n, grows):
    """Write a sample's result; the shift's variance from the factor of the normal equations.

    grows: as in EDGE_SAMPLE.
    """
    unit = np.zeros(4)
    unit[2] = 1.0
    cholesky.solve(factor, n_fitted, unit, unit)
    sample.shift, sample.variance = x[2], unit[2]
    sample.low, sample.high = x[0], x[1] if grows != 0.0 else 0.5 * (x[1] + x[3])
    sample.grows = grows
    sample.misfit, sample.pixels, sample.steepness = misfit, n, normal[2, 2]
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
