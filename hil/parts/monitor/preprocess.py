"""Preprocessing (the paper's second task): histogram of a region, its thresholds, brightness and contrast stretch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

_TAIL: Final = 0.002  # fraction of the pixels outside of the stretched range
_DEPTH: Final = 3  # each side of a threshold is divided again: 1 + 2 + 4 thresholds
_SMOOTHING: Final = 1.2  # px
LEAST_CONTRAST: Final = 8.0


@dataclass(frozen=True)
class Prepared:
    """A preprocessed region: smoothed and stretched image, thresholds on it, contrast before."""

    image: Image
    thresholds: tuple[int, ...]
    contrast: float


def histogram(image: Image) -> NDArray[np.float64]:
    """Return the number of pixels of each of the 256 grey values."""
    counts: Any = cv2.calcHist([image], [0], None, [256], [0, 256])
    return np.asarray(counts, float).ravel()


def grey_range(counts: NDArray[np.float64]) -> tuple[int, int]:
    """Return the grey values between the tails of the histogram."""
    total = np.cumsum(counts)
    low = int(np.searchsorted(total, _TAIL * total[-1]))
    high = int(np.searchsorted(total, (1.0 - _TAIL) * total[-1]))
    return low, high


def bimodal_threshold(counts: NDArray[np.float64], low: int, high: int) -> int | None:
    """Return the grey value that divides the histogram between low and high best (Otsu); None if there is only one."""
    part = counts[low : high + 1]
    if part.sum() <= 0.0 or np.count_nonzero(part) < 2:
        return None
    levels = np.arange(low, high + 1, dtype=float)
    weight = np.cumsum(part)
    mean = np.cumsum(part * levels)
    rest = weight[-1] - weight
    with np.errstate(invalid="ignore", divide="ignore"):
        between = weight * rest * (mean / weight - (mean[-1] - mean) / rest) ** 2
    between[~np.isfinite(between)] = -1.0
    best = np.flatnonzero(between >= between.max() * (1.0 - 1e-9))
    return low + int(best[len(best) // 2])


def thresholds(counts: NDArray[np.float64], low: int, high: int, depth: int = _DEPTH) -> list[int]:
    """Return the thresholds between all modes found by ``depth`` recursive divisions."""
    if depth == 0 or high - low < 4:
        return []
    middle = bimodal_threshold(counts, low, high)
    if middle is None:
        return []
    below = thresholds(counts, low, middle, depth - 1)
    return [*below, middle, *thresholds(counts, middle + 1, high, depth - 1)]


def prepare(image: Image) -> Prepared:
    """Return ``image`` smoothed, with brightness and contrast stretched to the full range, and its thresholds."""
    smooth: Any = cv2.GaussianBlur(image, (0, 0), _SMOOTHING)
    counts = histogram(smooth)
    low, high = grey_range(counts)
    contrast = float(high - low)
    if contrast < 1.0:
        return Prepared(smooth, (), contrast)
    table = np.clip((np.arange(256) - low) * (255.0 / (high - low)) + 0.5, 0.0, 255.0).astype(np.uint8)
    stretched: Any = cv2.LUT(smooth, table)
    return Prepared(stretched, tuple(sorted(set(thresholds(histogram(stretched), 0, 255)))), contrast)
