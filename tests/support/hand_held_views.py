"""Views of a board that is held by hand before two cameras, by OpenCV's projection and a renderer of its own."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.vmu.calibration.board import CORNER_SIGMA_PX, Board
from hil.vmu.calibration.model import Observations, Setup
from tests.support.calibration_images import board_image, camera_pair_of

_MARGIN_PX = 25.0
_NEAREST_M, _FARTHEST_M = 0.6, 1.3


def poses(setup: Setup, board: Board, count: int, rng: np.random.Generator) -> Iterator[tuple[Array, Array, Array]]:
    """Yield R, t and the corners, (2, m, 2), px, of views that both cameras of ``setup`` see whole."""
    pair = camera_pair_of(setup)
    while count > 0:
        z = np.exp(rng.uniform(np.log(_NEAREST_M), np.log(_FARTHEST_M)))
        place = z * np.array([*rng.uniform(-0.3, 0.3, 2), 1.0])
        turn = Rotation.from_euler("zyx", rng.uniform(-1.0, 1.0, 3) * np.radians([25.0, 30.0, 30.0])).as_matrix()
        pixels = np.empty((2, board.columns * board.rows, 2))
        for side in range(2):
            numbers = setup.theta[9 * side : 9 * side + 9]
            points = board.points() @ (pair.rotation[side] @ turn).T + pair.rotation[side] @ place
            points += pair.translation[side]
            matrix = np.array([[numbers[0], 0.0, numbers[2]], [0.0, numbers[1], numbers[3]], [0.0, 0.0, 1.0]])
            pixels[side] = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, numbers[4:])[0][:, 0]
        if ((pixels > _MARGIN_PX) & (pixels < setup.sizes[:, None] - _MARGIN_PX)).all():
            count -= 1
            yield turn, place, pixels


def observed(pixels: Array, sigma_px: float, rng: np.random.Generator) -> Observations:
    """Return corners, (n, 2, m, 2), px, with noise, as found in n views."""
    noisy = pixels + sigma_px * rng.standard_normal(pixels.shape)
    covariance = np.broadcast_to(CORNER_SIGMA_PX**2 * np.eye(2), (*pixels.shape, 2)).copy()
    return Observations(
        tuple(f"{k:04d}.png" for k in range(len(pixels))), np.zeros((len(pixels), 6)), noisy, covariance
    )


def images(setup: Setup, board: Board, turn: Array, place: Array, rng: np.random.Generator) -> list[np.ndarray]:
    """Return both images of the board, 8 bit, with noise of two levels."""
    pair, found = camera_pair_of(setup), []
    for side in range(2):
        turned, at = pair.rotation[side] @ turn, pair.rotation[side] @ place + pair.translation[side]
        image = board_image(setup.theta[9 * side : 9 * side + 9], setup.sizes[side], turned, at, board)
        image = cv2.GaussianBlur(image, (0, 0), 0.7) + 2.0 * rng.standard_normal(image.shape)
        found.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return found
