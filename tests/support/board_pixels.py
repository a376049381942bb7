"""Pixel renderer of a printed target, by rays: for each pixel the mean of 3 x 3 rays that meet the target's plane.

It shares no mathematics with ``hil.vmu``: its own pinhole, its own rotations.
"""

from __future__ import annotations

import cv2
import numpy as np
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
    back = Rotation.from_rotvec(turn).inv()
    origin, axes = back.apply(-t_m), back.as_matrix()
    first = 0.5 / FINE - 0.5 - 0.5 * np.array([columns - 1, rows - 1])
    ray = axes @ np.array([[1.0 / FINE, 0.0, first[0]], [0.0, 1.0 / FINE, first[1]], [0.0, 0.0, focal_px]])
    on_plane = (origin[:2, None] * ray[2] - origin[2] * ray[:2]) / np.array(size_m)[:, None] + 0.5 * ray[2]
    to_picture = np.vstack([on_plane * np.array(picture.shape[::-1])[:, None] - 0.5 * ray[2], ray[2]])
    fine = cv2.warpPerspective(
        25.0 + 165.0 / 255.0 * picture.astype(np.float32), to_picture, (FINE * columns, FINE * rows),
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP, borderValue=60.0,
    )  # fmt: skip
    light = cv2.GaussianBlur(cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    noise = 1.2 * rng.standard_normal(shape, dtype=np.float32)
    return np.asarray(np.clip(np.rint(light + noise), 0, 255).astype(np.uint8))
