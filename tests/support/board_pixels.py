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
    origin = back.apply(-t_m)
    directions = back.apply(np.stack(np.broadcast_arrays(u[None, :], v[:, None], focal_px), axis=-1).reshape(-1, 3))
    met = origin - directions * (origin[2] / directions[:, 2])[:, None]
    at = np.floor((met[:, :2] / size_m + 0.5) * picture.shape[::-1]).astype(int)
    inside = (at >= 0).all(axis=1) & (at < picture.shape[::-1]).all(axis=1)
    levels = np.full(len(at), 60.0)
    levels[inside] = 25.0 + 165.0 * picture[at[inside, 1], at[inside, 0]] / 255.0
    light = gaussian_filter(levels.reshape(rows, FINE, columns, FINE).mean(axis=(1, 3)), 0.8)
    return np.asarray(np.clip(np.rint(light + 1.2 * rng.standard_normal(shape)), 0, 255).astype(np.uint8))
