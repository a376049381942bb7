"""Kernels of the LED renderer: position, size and brightness of the LEDs' images, sensor noise."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat
from hil.vmu.kernels.lens import project, project_slopes


@kernel
def to_camera(rotation, translation, p, out):
    """Write the point ``p`` (3,), m in v, in the axes of the camera at ``rotation`` (3, 3), ``translation`` (3,)."""
    for i in range(3):
        out[i] = rotation[i, 0] * p[0] + rotation[i, 1] * p[1] + rotation[i, 2] * p[2] + translation[i]


@kernel
def project_points(lens, rotation, translation, points, t_v, q_vt, out):
    """Write the pixels (n, 2) of ``points`` (n, 3), m in t, in a camera, for the pose t -> v.

    ``p_v = A(q_vt) p_t + t_v``. NaN for a point that is not in front of the camera.
    """
    p = np.empty(3)
    for j in range(points.shape[0]):
        to_camera(rotation, translation, quat.transform(q_vt, points[j]) + t_v, p)
        out[j, 0], out[j, 1] = project(lens, p[0], p[1], p[2])


@kernel
def disc_images(lens, rotation, translation, leds, t_v, q_vt, radius, lobe, out):
    """Write the image of each LED, a disc of ``radius`` m that faces -z_t, to out (n, 6).

    Columns: u, v, width, shear, height (px, as in ``disc``) and the brightness relative to that at 1 m straight
    in front: 1/r^2 and cos^lobe of the angle off its axis (a uniform disc has a lobe of 1). All zero for an LED
    behind the camera; no brightness for one that faces away, unless the lobe is 0 (isotropic).
    (u, v) is the centroid of the image. Perspective and distortion shift it from the image of the LED's centre
    by a quarter of the radius squared times half the projection's Laplacian over the disc.
    """
    p, shifted = np.empty(3), np.empty(3)
    slopes = np.empty((2, 3))
    axes = np.empty((3, 3))  # of the disc in the camera: two in its plane, one along its emission axis
    for i in range(3):
        unit = np.zeros(3)
        unit[i] = 1.0
        direction = quat.transform(q_vt, unit)
        for j in range(3):
            axes[i, j] = rotation[j, 0] * direction[0] + rotation[j, 1] * direction[1] + rotation[j, 2] * direction[2]
    for n in range(leds.shape[0]):
        to_camera(rotation, translation, quat.transform(q_vt, leds[n]) + t_v, p)
        u, v = project(lens, p[0], p[1], p[2])
        for i in range(6):
            out[n, i] = 0.0
        if not (math.isfinite(u) and math.isfinite(v)):
            continue
        rim_u = rim_v = 0.0
        for i in range(2):
            for sign in (-1.0, 1.0):
                for j in range(3):
                    shifted[j] = p[j] + sign * radius * axes[i, j]
                at_u, at_v = project(lens, shifted[0], shifted[1], shifted[2])
                rim_u += 0.25 * (at_u - u)
                rim_v += 0.25 * (at_v - v)
        out[n, 0], out[n, 1] = u + 0.5 * rim_u, v + 0.5 * rim_v
        project_slopes(lens, p[0], p[1], p[2], slopes)
        uu = uv = vv = 0.0
        for i in range(2):
            du = radius * (slopes[0, 0] * axes[i, 0] + slopes[0, 1] * axes[i, 1] + slopes[0, 2] * axes[i, 2])
            dv = radius * (slopes[1, 0] * axes[i, 0] + slopes[1, 1] * axes[i, 1] + slopes[1, 2] * axes[i, 2])
            uu += du * du
            uv += du * dv
            vv += dv * dv
        height = math.sqrt(vv)
        shear = uv / height if height > 0.0 else 0.0
        out[n, 2], out[n, 3], out[n, 4] = math.sqrt(max(uu - shear * shear, 0.0)), shear, height
        r2 = p[0] * p[0] + p[1] * p[1] + p[2] * p[2]
        cosine = (axes[2, 0] * p[0] + axes[2, 1] * p[1] + axes[2, 2] * p[2]) / math.sqrt(r2)
        out[n, 5] = (1.0 if lobe == 0.0 else max(cosine, 0.0) ** lobe) / r2


@kernel
def fill_background(image, level, across, down, electrons, read_noise, pool, offsets):
    """Write a dark image (h, w) of uint8 with noise from ``pool``, standard normals of float32.

    level: at the image's centre, with slopes ``across`` and ``down``, levels per pixel. electrons: per level.
    Row i uses the pool from offsets[i] on; the Poisson noise of few electrons is approximated by a Gaussian.
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
