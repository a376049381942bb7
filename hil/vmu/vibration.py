"""Vibration of the cameras: their images are displaced against each other, in each pair otherwise.

The pose cannot explain a shift of the right image across the baseline. Its changes from pair to pair, beyond the noise
of the spots, are those of the cameras' pointing; from a track to the next one, beyond the tolerances too, whose errors
differ with the place in the images. Cameras that vibrate alike, and a single pair, show none: ``vibration_px``.
"""

from __future__ import annotations

from collections import deque
from typing import Final

import numpy as np

from hil.core.messages import Array

_PAIRS: Final = 32
_SIGNIFICANT: Final = 4.0  # sigmas of the variance of noise alone
_FEW: Final = 2.0  # by their fraction of the pairs the estimate is enlarged


class Vibration:
    """Vibration of a camera, px, 1 sigma along each axis: as stated, or as the pairs show if it is more."""

    def __init__(self, stated_px: float) -> None:
        self._stated_px = stated_px
        self._shifts: deque[tuple[float, float]] = deque(maxlen=_PAIRS)

    def add(self, fit: np.void, *, is_first: bool) -> None:
        """Add a pair by its pose (FIT). is_first: of a track."""
        shift_px, variance, sigmas = (float(each) for each in (fit["shift_px"], fit["shift_noise"], fit["shift"][1]))
        if is_first and sigmas != 0.0:
            learnt = self.sigma_px**2 - self._stated_px**2
            variance = max(variance, (shift_px / sigmas) ** 2 - learnt)
        if variance > 0.0:
            self._shifts.append((shift_px, variance))

    @property
    def sigma_px(self) -> float:
        """Return the vibration: each of the cameras may be the one that moves, so it counts for both."""
        steps = len(self._shifts) - 1
        if steps < 1:
            return self._stated_px
        shifts, noise = np.array(self._shifts).T
        square, usual = 0.5 * float(np.mean(np.diff(shifts) ** 2)), float(noise[1:].mean())
        if square < usual * (1.0 + _SIGNIFICANT * np.sqrt(2.0 / steps)):
            return self._stated_px
        return max(self._stated_px, float(np.sqrt(square * (1.0 + _FEW / steps))))


def with_pointing(fit: np.void, variance: float) -> np.void:
    """Return ``fit`` with a random rotation of the left camera about its u and v axes, of ``variance``, rad^2."""
    if variance == 0.0:
        return fit
    x, y, z = fit["t"]
    turned: Array = np.array([[0.0, -z, y, 1.0, 0.0, 0.0], [z, 0.0, -x, 0.0, 1.0, 0.0]])  # of the pose by each
    out = fit.copy()
    out["covariance"] += variance * turned.T @ turned
    out["noise"] += variance * turned.T @ turned
    return out
