"""Reasons of refused pairs in a line of text: what, how much, and what to do."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from hil.vmu.identify import (
    AMBIGUOUS,
    GEOMETRY,
    GEOMETRY_FILE,
    NO_MATCH,
    NOT_TOGETHER,
    TOO_FEW,
    LedIdentification,
)
from hil.vmu.kernels.fit import FULL_SCALE
from hil.vmu.kernels.records import SATURATED
from hil.vmu.pose import SolverSettings

BRIGHT_LEVEL: Final = 230
_CLIPPED_PX: Final = 300
_RUN_PX, _SLENDER, _LIGHTS_PX = 12, 1.5, 48  # of columns at full scale; relative to all lights of a row; of these
DARK_LEVELS: Final = 60
"""An image whose brightest pixel is less above its background is dark."""


def contrast(images: Sequence[np.ndarray | None]) -> tuple[int, float]:
    """Return the brightest level of the images, and by how much it is above the background of its image."""
    peaks = [(int(image.max()), float(image.max()) - float(np.median(image[::8, ::8]))) for image in images
             if image is not None]  # fmt: skip
    return max(peaks, key=lambda peak: peak[1], default=(0, 0.0))


def overexposed(image: np.ndarray) -> float:
    """Return the fraction of an image at or near full scale."""
    return float((image[::4, ::4] >= BRIGHT_LEVEL).mean())


def blooming(images: Sequence[np.ndarray | None]) -> str:
    """Return that the light of LEDs runs along columns of the sensor, "" unless it does."""
    longest = max((_run_of_columns(image) for image in images if image is not None), default=0)
    return f"{longest} pixels of a column at full scale, blooming: shorten the exposure" if longest else ""


def _run_of_columns(image: np.ndarray) -> int:
    """Return the longest run of pixels at full scale in a column, 0 if it is no longer than lights are wide."""
    full = image == FULL_SCALE
    width = int(full.sum(axis=1).max())
    columns = full[:, full.sum(axis=0) >= _RUN_PX]
    if not columns.shape[1] or width > _LIGHTS_PX:
        return 0
    count = np.cumsum(columns, axis=0)
    run = int((count - np.maximum.accumulate(np.where(columns, 0, count), axis=0)).max())
    return run if run >= max(_RUN_PX, _SLENDER * width) else 0


def reason_of_time(images: Sequence[np.ndarray | None], spots: Sequence[np.ndarray]) -> str:
    """Return why a pair took too long."""
    clipped = max(int((image >= BRIGHT_LEVEL).sum()) for image in images if image is not None)
    if clipped > _CLIPPED_PX:
        return f"{clipped} pixels at full scale take too long to measure: shorten the exposure"
    return f"{len(spots[0])} and {len(spots[1])} lights are too many for the time of a pair: darken them"


def reason(
    verdict: LedIdentification, spots: Sequence[np.ndarray], n_leds: int, settings: SolverSettings,
    swapped: Callable[[], bool],
) -> str:  # fmt: skip
    """Return why a pair has no pose, "" if its status is all. swapped: whether it fits the opposite baseline."""
    left, right = map(len, spots)
    lights = f"{left} and {right} lights, {n_leds} LEDs"
    match verdict.status:
        case status if status == TOO_FEW and max(left, right) < 3:
            return f"{lights}: longer exposure, or are LEDs hidden?"
        case status if status == TOO_FEW:
            return f"{lights}: maybe by chance; a start pose or a track decides"
        case status if status == NO_MATCH:
            clipped = sum(int((side["flags"] & SATURATED > 0).sum()) for side in spots)
            if clipped > max(left, right):
                return f"{lights}, most at full scale: shorten the exposure"
            return f"{lights}, none as the ring: are leds_m and focal lengths right?"
        case status if status == GEOMETRY:
            return (
                f"fits only beyond {settings.near_m:g} to {settings.far_m:g} m or {settings.steepest_deg:g} deg of tilt"
            )
        case status if status == GEOMETRY_FILE:
            if swapped():
                return "would fit with the opposite baseline: images exchanged, or sign of baseline_m"
            return "each image alone fits, not both: baseline_m, leds_m or focal lengths are wrong"
        case status if status == NOT_TOGETHER:
            return "each image alone fits, not both: a moving target (sync_s), or a turned camera"
        case status if status == AMBIGUOUS and verdict.open:
            return "a second pattern of LEDs in the images: a reflection, another ring? Cover it"
        case status if status == AMBIGUOUS and verdict.jump:
            return "one pose fits, but it does not continue the track"
        case status if status == AMBIGUOUS:
            return f"{len(verdict.candidates)} poses fit {lights}: a raised or a marked LED decides"
    return ""
