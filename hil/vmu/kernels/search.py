"""Spot detection in one pass: background, threshold, components and spots of an image or of windows in it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import Array
from hil.vmu.kernels.components import (
    COMPONENT_WIDTH,
    END,
    FIRST,
    Frame,
    LightComponent,
    collect_hits,
    fill_background_grid,
    fill_threshold,
    flood,
    interpolate,
    level_and_variance,
    row_scan,
    sum_of_nine,
)
from hil.vmu.kernels.measure import measure
from hil.vmu.kernels.split import is_fringe, lights_of_steps, split_large
from hil.vmu.kernels.structure import flatten

TOO_MANY = -1  # more lights than the capacity
STEPS = -2  # the background has a step: a component far larger than any light
_TILE = 64  # px
_SAMPLES = 36  # samples of a tile
_WINDOW_SAMPLES = 100
_ROWS = 4  # rows per threshold
_SMALL = 300  # pixels of a component that is soon fitted
_MANY = 16  # components
_SHARES, _LEAST_WORK = 8, 1e6  # a light may cost a part of the work that is left, and at least so much
_WHOLE = 30  # of ``flood``: one block, the image
_LIGHTS = 4  # squares of the largest light: pixels of the largest component


class Background(NamedTuple):
    """Background of an image: (1, 1), or as from ``fill_background_grid``."""

    level: Array
    dark: Array
    spread: Array


@kernel
def _flood_row(frame, hits, background, components, lights, count):
    """Flood from each of ``hits`` without a component; return the number of components, TOO_MANY or STEPS."""
    rows, columns = frame.image.shape
    end = components[count - 1, END] if count > 0 else 0
    threshold, most = np.empty((1, 1)), int(_LIGHTS * frame.limits.largest**2)
    for hit in hits:
        v, u = hit // columns, hit % columns
        if frame.label[v, u] != 0:
            continue
        if count == components.shape[0]:
            return TOO_MANY
        here = interpolate(background.level, u, v, columns, rows)
        variance = max(interpolate(background.dark, u, v, columns, rows), 1.0 / 12.0)
        lights[count, 0], lights[count, 1], lights[count, 2] = here, variance, 0.0
        wide = max(interpolate(background.spread, u, v, columns, rows), 9.0 * variance)
        threshold[0, 0] = here + frame.limits.sigmas * math.sqrt(wide)
        end = flood(
            frame.image, frame.label, count + 1, hit, threshold, _WHOLE, most, frame.queue, end, components[count]
        )  # fmt: skip
        if end < 0:
            return STEPS
        count += 1
    return count


@kernel
def components_of_image(frame, components, lights):
    """Flood every light of an image: boxes and queue of ``components``, level and variance of ``lights`` (n, 3).

    Return the number of components, TOO_MANY, or STEPS.
    """
    rows, columns = frame.image.shape
    shape = (max(1, round(rows / _TILE)), max(1, round(columns / _TILE)))
    background = Background(np.empty(shape), np.empty(shape), np.empty(shape))
    fill_background_grid(frame.image, background.level, background.dark, background.spread, np.empty(_SAMPLES))
    deviation = np.empty(shape)
    for i in range(shape[0]):
        for j in range(shape[1]):
            deviation[i, j] = math.sqrt(background.spread[i, j])
    scan = row_scan(columns)
    n_components = 0
    for v in range(1, rows - 1):
        if (v - 1) % _ROWS == 0:
            fill_threshold(background.level, deviation, frame.limits.sigmas, v, rows, scan.threshold)
        count = collect_hits(frame.image, v, 0, columns, scan)
        if count > 0:
            n_components = _flood_row(frame, scan.hits[:count], background, components, lights, n_components)
            if n_components < 0:
                return n_components
    return n_components


@kernel
def components_of_windows(frame, windows, components, lights):
    """Flood the lights that extend into ``windows`` (k, 4): u and v of the first pixel and after the last."""
    rows, columns = frame.image.shape
    scan, samples = row_scan(columns), np.empty(_WINDOW_SAMPLES)
    box = np.empty((windows.shape[0], 4), dtype=np.int64)
    level, dark, wide = np.zeros(windows.shape[0]), np.zeros(windows.shape[0]), np.zeros(windows.shape[0])
    for k in range(windows.shape[0]):
        box[k, 0], box[k, 1] = max(windows[k, 0], 0), max(windows[k, 1], 0)
        box[k, 2], box[k, 3] = min(windows[k, 2], columns), min(windows[k, 3], rows)
        level[k], dark[k], wide[k] = level_and_variance(
            frame.image, box[k, 0], box[k, 1], box[k, 2], box[k, 3], samples
        )
    n_components = 0
    here, noise, spread = np.empty((1, 1)), np.empty((1, 1)), np.empty((1, 1))
    background = Background(here, noise, spread)
    for k in range(windows.shape[0]):
        if box[k, 2] - box[k, 0] < 3 or box[k, 3] - box[k, 1] < 3:
            continue
        here[0, 0], noise[0, 0] = level[k], _typical(level, dark, k)
        spread[0, 0] = max(_typical(level, wide, k), 9.0 * noise[0, 0])
        limit = here[0, 0] + frame.limits.sigmas * math.sqrt(spread[0, 0])
        scan.threshold[:] = np.uint16(min(limit, 65535.0))
        for v in range(max(box[k, 1], 1), min(box[k, 3], rows - 1)):
            count = collect_hits(frame.image, v, box[k, 0], box[k, 2], scan)
            if count > 0:
                n_components = _flood_row(frame, scan.hits[:count], background, components, lights, n_components)
                if n_components < 0:
                    return n_components
    return n_components


@kernel
def _typical(level, dark, k):
    """Return the median of ``dark``, variances, over the windows with about the same background as window ``k``."""
    near = np.empty(level.shape[0])
    n = 0
    for m in range(level.shape[0]):
        if abs(level[m] - level[k]) <= 18.0 + 0.15 * level[k]:
            near[n] = dark[m]
            n += 1
    return np.median(near[:n])


@kernel
def by_priority(frame, components, lights, count):
    """Return the order in which components are measured, as work is limited: small ones first, of many the highest."""
    rank = np.empty(count)
    for k in range(count):
        rank[k] = 1e-3 * k + (1e6 if components[k, END] - components[k, FIRST] > _SMALL else 0.0)
        if count <= _MANY:
            continue
        peak = 0
        for at in range(components[k, FIRST], components[k, END]):
            v, u = frame.queue[at] // frame.image.shape[1], frame.queue[at] % frame.image.shape[1]
            peak = max(peak, sum_of_nine(frame.image, u, v))
        rank[k] += lights[k, 0] - peak
    return np.argsort(rank)


@kernel
def detect(frame, windows, steps, spots, noise):
    """Write the spots of an image to ``spots``; return how many, or TOO_MANY.

    windows: (k, 4) of int64, u and v of the first pixel and after the last; (0, 4) for the whole image. steps: whether
    its background has steps everywhere.
    noise: (most components, 2), per component as from ``light_noise``; zero without an estimate.
    """
    columns = frame.image.shape[1]
    most = noise.shape[0]
    components = np.zeros((most, COMPONENT_WIDTH), dtype=np.int64)
    lights = np.empty((most, 3))
    n_components = STEPS
    if not steps and windows.shape[0] == 0:
        n_components = components_of_image(frame, components, lights)
    elif not steps:
        n_components = components_of_windows(frame, windows, components, lights)
    if n_components == STEPS:
        n_components = lights_of_steps(frame, windows, components, lights)
    elif n_components > 0:
        n_components = split_large(frame, components, lights, n_components)
    count = 0
    for k in by_priority(frame, components, lights, max(n_components, 0)):
        if is_fringe(frame.label, components, k):
            continue
        frame.work[1] = frame.work[0] * (1.0 - 1.0 / min(max(n_components, 4), _SHARES)) - _LEAST_WORK
        component = LightComponent(k + 1, components[k], lights[k, 0] / 9.0, lights[k, 1])
        if lights[k, 2] > 0.0 and frame.work[0] > 0.0:
            flat = np.empty_like(frame.image)
            flatten(frame.image, components[k], component.background, flat)
            other = Frame(flat, frame.label, frame.queue, frame.limits, frame.per_level, frame.last, frame.work)
            count = measure(other, component, spots, count, noise[k])
        else:
            count = measure(frame, component, spots, count, noise[k])
    for k in range(most):
        for at in range(components[k, FIRST], components[k, END]):
            frame.label[frame.queue[at] // columns, frame.queue[at] % columns] = 0
    return count if n_components != TOO_MANY else TOO_MANY
