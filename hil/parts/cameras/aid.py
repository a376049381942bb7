"""Aid at the set-up of two cameras: numbers of their spots and of each pair, and marked images."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Final

import cv2
import numpy as np

from hil.drivers.cameras.base import SIDES, CameraFrame
from hil.vmu.detect import SpotDetector
from hil.vmu.kernels.records import SATURATED
from hil.vmu.unit import VisionUnit

WANTED_PEAK: Final = 180.0
"""Grey level of the median spot's peak at the right exposure: room for near LEDs, noise far below it."""
_FULL_SCALE: Final = 255.0
_BEST_WIDTH_PX: Final = (0.8, 2.5)
_RING_PX: Final = 4.0  # radius of a mark: times the spot's width
_SPOTS_SHOWN: Final = 64


@dataclass(frozen=True, slots=True)
class SideNumbers:
    """One image. spots: their number. width_px: median 1-sigma width. peak: median grey level of the spots' peaks.

    saturated: number of spots with pixels at full scale. background: median grey level. shutter: of the camera.
    """

    spots: int
    width_px: float
    peak: float
    saturated: int
    background: float
    shutter: str

    @property
    def advice(self) -> str:
        """Return what to change, or ``ok``."""
        if not self.spots:
            return "no spots: open the aperture, expose longer, or switch other lights off"
        if 2 * self.saturated > self.spots:
            return "too bright: expose shorter"
        if self.peak < 0.4 * WANTED_PEAK:
            return f"dim: expose {min(self.factor, 10.0):.1f} times as long"
        low, high = _BEST_WIDTH_PX
        if not low <= self.width_px <= high:
            return f"spots {self.width_px:.2f} px wide: turn the focus until they are {low:g} to {high:g} px wide"
        return "ok"

    @property
    def factor(self) -> float:
        """Return by how much longer an exposure has the wanted peak."""
        return WANTED_PEAK / max(self.peak, 1.0)


@dataclass(frozen=True, slots=True)
class PairNumbers:
    """One pair of images. left, right: None for an image with lost packets. status: of the vision unit, "" without one.

    epipolar_px: NaN without a pose. range_m, reprojection_px: of a pose, else NaN. skew_s: time between the stamps of
    both cameras, less its usual value: their clocks need not agree; NaN without stamps. packet_bytes: of each camera's
    network packets, the MTU that they need; 0 without a network.
    """

    number: int
    left: SideNumbers | None
    right: SideNumbers | None
    status: str
    epipolar_px: float
    range_m: float
    skew_s: float
    lost: tuple[int, int]
    packet_bytes: tuple[int, int] = (0, 0)

    def as_json(self) -> dict[str, Any]:
        """Return the numbers for a page: null for what is not known."""
        fields = {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
        }
        for name, side in zip(SIDES, (self.left, self.right), strict=True):
            if side is not None:
                numbers = asdict(side) | {"advice": side.advice}
                fields[name] = {
                    k: v if not isinstance(v, float) or math.isfinite(v) else None for k, v in numbers.items()
                }
        return fields


class SetUpAid:
    """Measures pairs of two cameras. sizes: (width, height) of each. unit: solves the pairs, None: none does.

    packet_bytes: of each camera's network packets, once they are open.
    """

    def __init__(self, sizes: tuple[tuple[int, int], tuple[int, int]], unit: VisionUnit | None) -> None:
        self.packet_bytes = (0, 0)
        self._detectors = [SpotDetector((height, width)) for width, height in sizes]
        self._unit = unit
        self._apart_s: list[float] = []
        self._lost = [0, 0]
        self._number = 0

    def add(
        self, frames: tuple[CameraFrame, CameraFrame], shutters: tuple[str, str], t_s: float
    ) -> tuple[PairNumbers, list[np.ndarray]]:
        """Return the numbers of a pair taken at ``t_s``, and its images (h, w, 3), BGR, with marks at the spots."""
        self._number += 1
        sides: list[SideNumbers | None] = []
        pictures: list[np.ndarray] = []
        for k, (frame, shutter) in enumerate(zip(frames, shutters, strict=True)):
            if frame.image is None:
                self._lost[k] += 1
                sides.append(None)
                continue
            spots = self._detectors[k].spots(frame.image)
            sides.append(side_numbers(frame.image, spots, shutter))
            pictures.append(marked(frame.image, spots))
        status, epipolar_px, range_m = "", math.nan, math.nan
        if self._unit is not None:
            solution = self._unit.solve(frames[0].image, frames[1].image, t_s)
            status, epipolar_px = solution.status, solution.epipolar_px
            range_m = float(np.linalg.norm(solution.t))
        numbers = PairNumbers(
            self._number,
            sides[0],
            sides[1],
            status,
            epipolar_px,
            range_m,
            self._skew(frames),
            (self._lost[0], self._lost[1]),
            self.packet_bytes,
        )
        return numbers, pictures

    def _skew(self, frames: tuple[CameraFrame, CameraFrame]) -> float:
        apart_s = frames[0].stamp_s - frames[1].stamp_s
        if not math.isfinite(apart_s):
            return math.nan
        self._apart_s = [*self._apart_s[-63:], apart_s]
        return apart_s - median(self._apart_s)


def led_level(image: np.ndarray, spots: np.ndarray) -> float:
    """Return the grey level of the median spot's peak, 0 without spots: what an exposure for LEDs goes by.

    The brightest hundredth of the pixels, which ``BrightnessControl`` uses, is background: LEDs cover less.
    """
    if not len(spots):
        return 0.0
    peaks = np.where(spots["flags"] & SATURATED != 0, _FULL_SCALE, np.median(image) + spots["peak"])
    return float(np.median(peaks))


def side_numbers(image: np.ndarray, spots: np.ndarray, shutter: str = "") -> SideNumbers:
    """Return the numbers of one image."""
    width_px = float(np.median(spots["size"])) if len(spots) else math.nan
    saturated = int((spots["flags"] & SATURATED != 0).sum())
    return SideNumbers(len(spots), width_px, led_level(image, spots), saturated, float(np.median(image)), shutter)


def marked(image: np.ndarray, spots: np.ndarray) -> np.ndarray:
    """Return ``image`` as (h, w, 3), BGR, with a ring around each spot: red where it is saturated, else green."""
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for spot in spots[:_SPOTS_SHOWN]:
        colour = (60, 60, 255) if spot["flags"] & SATURATED else (80, 220, 80)
        radius = round(6.0 + _RING_PX * float(spot["size"]))
        cv2.circle(picture, (round(float(spot["u"])), round(float(spot["v"]))), radius, colour, 1, cv2.LINE_AA)
    return picture
