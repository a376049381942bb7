"""Renderer of a printed target in the two cameras of a vision unit, with blur and noise of the sensor."""

from __future__ import annotations

import math
from typing import Final

import cv2
import numpy as np

from hil.core.messages import Array
from hil.vmu.estimators import FlatTarget
from hil.vmu.kernels.lens import CameraPair
from hil.vmu.pose import matrix_of
from hil.vmu.render import RingAppearance

_FINE: Final = 2  # samples along each side of a pixel
_PAPER: Final = 0.75  # of full scale: white paper
_INK: Final = 0.08
_TAIL: Final = 4.0  # sigmas of the blur
_ROUNDS: Final = 20  # of the inversion of the distortion


class BoardRenderer:
    """Renders a flat target. pair: cameras. appearance: its blur, background and noise."""

    def __init__(self, pair: CameraPair, board: FlatTarget, appearance: RingAppearance) -> None:
        self._pair, self._board, self._appearance = pair, board, appearance
        self._maps: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        grey = board.image.astype(np.float32) / 255.0
        self._levels = 255.0 * (_INK + (_PAPER - _INK) * grey)

    def image(self, camera: int, t_v: Array, q_vt: Array, rng: np.random.Generator) -> np.ndarray:
        """Return the image (h, w), uint8, of the target at ``p_v = A(q_vt) p_t + t_v``."""
        lens, chosen = self._pair.lens[camera], self._appearance
        width, height = int(lens["width"]), int(lens["height"])
        light: np.ndarray = np.full((height, width), chosen.background_levels, np.float32)
        half = 0.5 * np.array([self._board.width_m, self._board.height_m])
        corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * [*half, 0.0]
        in_v = corners @ matrix_of(q_vt).T + t_v
        own = in_v @ self._pair.rotation[camera].T + self._pair.translation[camera]
        if (own[:, 2] > 0.05).all():
            ideal = own[:, :2] / own[:, 2:] * [lens["fx"], lens["fy"]] + [lens["cx"], lens["cy"]]
            self._draw(light, ideal)
            if any(lens[name] for name in ("k1", "k2", "p1", "p2", "k3")):
                light = cv2.remap(light, *self._distortion(camera), cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        sigma = np.sqrt(np.maximum(light, 0.0) / chosen.electrons_per_level + chosen.read_noise_levels**2)
        noisy = light + sigma * rng.standard_normal(light.shape, dtype=np.float32)
        return np.asarray(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))

    def _draw(self, light: np.ndarray, corners: Array) -> None:
        """Draw the target with its corners (4, 2) at these pixels, blurred and then averaged over finer ones.

        A blur of whole pixels would displace edges by 0.02 px, according to their place in a pixel.
        """
        shape, margin = np.array(light.shape), 2 + math.ceil(_TAIL * self._appearance.psf_sigma_px)
        low = np.maximum(np.floor(corners.min(axis=0)).astype(int) - margin, 0)
        high = np.minimum(np.ceil(corners.max(axis=0)).astype(int) + margin + 1, shape[::-1])
        if (high <= low).any():
            return
        across = float(np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1).max())
        scale = min(1.0, _FINE * across / max(self._levels.shape))
        size = [max(2, round(scale * n)) for n in self._levels.shape[::-1]]
        texture = cv2.resize(self._levels, size, interpolation=cv2.INTER_AREA)
        ends = np.array([[-0.5, -0.5], [size[0] - 0.5, -0.5], [size[0] - 0.5, size[1] - 0.5], [-0.5, size[1] - 0.5]])
        fine = _FINE * (corners - low + 0.5) - 0.5
        to_fine = cv2.getPerspectiveTransform(ends.astype(np.float32), fine.astype(np.float32))
        extent = (_FINE * (high - low)).tolist()
        drawn = cv2.warpPerspective(texture, to_fine, extent, flags=cv2.INTER_LINEAR)
        part = cv2.warpPerspective(np.ones_like(texture), to_fine, extent, flags=cv2.INTER_LINEAR)
        behind = light[low[1] : high[1], low[0] : high[0]]
        both = drawn + (1.0 - part) * float(behind.mean())
        both = cv2.GaussianBlur(both, (0, 0), _FINE * self._appearance.psf_sigma_px, borderType=cv2.BORDER_REPLICATE)
        behind[:] = both.reshape(high[1] - low[1], _FINE, high[0] - low[0], _FINE).mean(axis=(1, 3))

    def _distortion(self, camera: int) -> tuple[np.ndarray, np.ndarray]:
        """Return where each pixel of the real image is in the one without distortion."""
        if camera not in self._maps:
            lens = self._pair.lens[camera]
            k1, k2, p1, p2, k3 = (float(lens[name]) for name in ("k1", "k2", "p1", "p2", "k3"))
            u, v = np.meshgrid(np.arange(int(lens["width"]), dtype=float), np.arange(int(lens["height"]), dtype=float))
            bent_x, bent_y = (u - lens["cx"]) / lens["fx"], (v - lens["cy"]) / lens["fy"]
            x, y = bent_x.copy(), bent_y.copy()
            for _ in range(_ROUNDS):
                square = x * x + y * y
                swell = 1.0 + square * (k1 + square * (k2 + square * k3))
                x, y = (
                    (bent_x - 2.0 * p1 * x * y - p2 * (square + 2.0 * x * x)) / swell,
                    (bent_y - p1 * (square + 2.0 * y * y) - 2.0 * p2 * x * y) / swell,
                )
            self._maps[camera] = (
                (x * lens["fx"] + lens["cx"]).astype(np.float32), (y * lens["fy"] + lens["cy"]).astype(np.float32)
            )  # fmt: skip
        return self._maps[camera]
