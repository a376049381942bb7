"""From the light on a sensor to grey levels: shot noise, read noise, rounding and clipping."""

from __future__ import annotations

import numpy as np

from hil.core.jit import kernel


@kernel
def fill_background(image, level, across, down, electrons, read_noise, pool, offsets):
    """Write a dark image (h, w) of uint8 whose noise comes from ``pool``, standard normals of float32.

    level: at the image's centre, with slopes ``across`` and ``down``, levels per pixel. electrons: per level.
    Row i takes the pool from offsets[i] on; a level of few electrons gets a Gaussian for its Poisson law.
    """
    rows, columns = image.shape
    gain = np.float32(1.0 / electrons)
    slope = np.float32(across)
    read_variance = np.float32(read_noise * read_noise)
    zero, half, top = np.float32(0.0), np.float32(0.5), np.float32(255.0)
    for i in range(rows):
        start = np.float32(level + down * (i - 0.5 * (rows - 1)) - across * 0.5 * (columns - 1))
        noise = pool[offsets[i] : offsets[i] + columns]
        line = image[i]
        for j in range(columns):
            mean = max(start + slope * np.float32(j), zero)
            value = mean + np.sqrt(read_variance + gain * mean) * noise[j] + half
            line[j] = np.uint8(np.int32(min(max(value, zero), top)))


@kernel
def clear_box(canvas, box):
    """Set the pixels of ``canvas`` from (box[0], box[1]) up to (box[2], box[3]) to zero."""
    for i in range(box[1], box[3]):
        for j in range(box[0], box[2]):
            canvas[i, j] = 0.0
