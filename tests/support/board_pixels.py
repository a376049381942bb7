"""Pixel renderer of a printed target, by rays: for each pixel the mean of 3 x 3 rays that meet the target's plane.

It shares no mathematics with ``hil.vmu``: its own pinhole, its own rotations.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from tests.support.vmu_pixels import Array, Image

FINE = 3


def board_image(
    picture: Image, size_m: tuple[float, float], focal_px: float, shape: tuple[int, int], turn: Array, t_m: Array,
    rng: np.random.Generator,
) -> Image:  # fmt: skip
    """Return the image (h, w) of a target whose points p of its plane are at ``exp([turn]x) p + t_m`` of the camera.

    The principal point is the image's middle; white is 190, black 25 and the surroundings 60 grey levels; blur 0.8 px.
    """
    rows, columns = shape
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    u = (np.arange(columns)[:, None] + offset).ravel() - 0.5 * (columns - 1)
    v = (np.arange(rows)[:, None] + offset).ravel() - 0.5 * (rows - 1)
    back = Rotation.from_rotvec(turn).inv()
    origin, axes = back.apply(-t_m), back.as_matrix()
    x, y, z = (axis[0] * u[None, :] + (axis[1] * v[:, None] + axis[2] * focal_px) for axis in axes)  # of each ray
    factor = -origin[2] / z
    high, wide = picture.shape
    column, row = (origin[0] + factor * x) / size_m[0] + 0.5, (origin[1] + factor * y) / size_m[1] + 0.5
    inside = (column >= 0.0) & (column < 1.0) & (row >= 0.0) & (row < 1.0)
    at = (row[inside] * high).astype(int), (column[inside] * wide).astype(int)
    levels = np.full(inside.shape, 60.0)
    levels[inside] = 25.0 + 165.0 * picture[at] / 255.0
    light = gaussian_filter(levels.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3)), 0.8)
    return np.asarray(np.clip(np.rint(light + 1.2 * rng.standard_normal(shape)), 0, 255).astype(np.uint8))
