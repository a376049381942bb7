"""Coarse search for edges along their normals, for a pose with an error of several pixels."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.parts.monitor.kernels.edge_samples import BAR

_MOST = 129


@kernel
def interpolate(image, first_line, line_step, u, v):
    """Return the grey value at (u, v), px, by bilinear interpolation; nan outside of the image."""
    r = (v - first_line) / line_step
    i, j = math.floor(r), math.floor(u)
    if i < 0 or j < 0 or i + 1 >= image.shape[0] or j + 1 >= image.shape[1]:
        return np.nan
    fr, fu = r - i, u - j
    upper = image[i, j] + fu * (float(image[i, j + 1]) - image[i, j])
    lower = image[i + 1, j] + fu * (float(image[i + 1, j + 1]) - image[i + 1, j])
    return upper + fr * (lower - upper)


@kernel
def _profile(image, first_line, line_step, sample, steps, out):
    """Write the mean grey values of three paths across the edge at s = -steps .. steps px; False at the border."""
    tu, tv = -sample.nv, sample.nu
    spread = min(0.35 * sample.length, 2.0)
    for k in range(2 * steps + 1):
        s = float(k - steps)
        total = 0.0
        for path in range(-1, 2):
            u = sample.u + s * sample.nu + path * spread * tu
            v = sample.v + s * sample.nv + path * spread * tv
            total += interpolate(image, first_line, line_step, u, v)
        out[k] = total / 3.0
        if not math.isfinite(out[k]):
            return False
    return True


@kernel
def search_edge_samples(image, first_line, line_step, samples, count, reach, least):
    """Set each sample's shift to the steepest point of the profile across it (darkest or brightest, for a bar).

    reach: px to each side. least: grey values, smaller steps are noise. ``low``, ``high``: grey values on both sides.
    """
    profile, response = np.empty(_MOST), np.empty(_MOST)
    steps = int(min(reach + 4.0, (_MOST - 1) // 2))
    for c in range(count):
        sample = samples[c]
        sample.good = 0
        if not _profile(image, first_line, line_step, sample, steps, profile):
            continue
        half = 0.5 * sample.width
        best, peak = 0.0, -1
        for k in range(2 * steps + 1):
            response[k] = 0.0
        for k in range(3, 2 * steps - 2):
            if sample.kind == BAR:
                far = int(half + 2.0)
                if k - far < 0 or k + far > 2 * steps:
                    continue
                value = 0.5 * (profile[k - far] + profile[k + far]) - profile[k]
            else:
                value = profile[k + 2] + profile[k + 1] - profile[k - 1] - profile[k - 2]
                value *= 0.5
            response[k] = value
            if abs(value) > abs(best):
                best, peak = value, k
        if peak < 4 or peak > 2 * steps - 4 or abs(best) < least:
            continue
        before, here, after = abs(response[peak - 1]), abs(best), abs(response[peak + 1])
        bend = before - 2.0 * here + after
        offset = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
        sample.shift = peak - steps + min(max(offset, -0.5), 0.5)
        sample.variance = 0.25
        sample.low, sample.high = profile[peak], profile[peak] + best
        sample.good = 1
