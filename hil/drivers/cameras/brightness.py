"""Control of a camera's exposure time by the brightness of its images."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

_PERCENTILE: Final = 99.0
_DARKEST: Final = 1.0  # level: the factor of one step is bounded by it
_SATURATED: Final = 250.0
_FACTORS: Final = (0.5, 2.0)  # bounds of one step; a saturated image does not show by how much it exceeds full scale
_DEAD_BAND: Final = 0.1  # relative; steps within it would change the image for nothing
_SETTLING: Final = 4  # images from a command until one shows it: those in flight and in the camera's buffers
_SHORTEST_S: Final = 2e-5


def brightest_hundredth(image: np.ndarray) -> float:
    """Return the grey level above which a hundredth of ``image`` (h, w), uint8, is."""
    return float(np.percentile(image[::4, ::4], _PERCENTILE))


class BrightnessControl:
    """Exposure time, s, with which the ``level`` of an image is ``target``, up to ``longest_s``."""

    def __init__(
        self,
        target: float,
        exposure_s: float,
        longest_s: float,
        level: Callable[[np.ndarray], float] = brightest_hundredth,
    ) -> None:
        self.exposure_s = min(exposure_s, longest_s)
        self._target, self._level = target, level
        self._longest_s = longest_s
        self._images = 0

    def update(self, image: np.ndarray) -> bool:
        """Take an image, (height, width), uint8; return whether ``exposure_s`` has changed."""
        self._images += 1
        if self._images < _SETTLING:
            return False
        level = self._level(image)
        ratio = _FACTORS[0] if level >= _SATURATED else self._target / max(level, _DARKEST)
        if abs(ratio - 1.0) < _DEAD_BAND:
            return False
        before_s = self.exposure_s
        changed_s = before_s * min(max(ratio, _FACTORS[0]), _FACTORS[1])
        self.exposure_s = min(max(changed_s, _SHORTEST_S), self._longest_s)
        self._images = 0
        return self.exposure_s != before_s
