"""Spot detector: centres of the light spots in an image, with covariances.

The threshold is a number of sigmas above the background, which is measured in tiles together with its noise. Each
light above it is fitted by maximum likelihood (``kernels/fit``): a point of light blurred by a Gaussian or, if that
does not fit, a disc. A spot's covariance is that of the fit.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median
from typing import Final

import numpy as np

from hil.config.vmu_geometry import Sensor
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.kernels.components import Frame
from hil.vmu.kernels.measure import LIMITS
from hil.vmu.kernels.records import SPOT
from hil.vmu.kernels.search import TOO_MANY, detect

_MOST_COMPONENTS: Final = 512
_MOST_TRIES: Final = 4
_STEPS_TRIES: Final = 2
_MOST_WORK: Final = 2.2e7  # products of the fits in one image: about 20 ms
_NO_WINDOWS: Final = np.empty((0, 4), dtype=np.int64)
_PRIOR_PER_LEVEL: Final = 0.01  # levels^2 of variance per level: 100 electrons per level
_PRIOR_WEIGHT: Final = 2000.0
_UNUSUAL: Final = 8.0  # in median absolute deviations
_FORGETTING: Final = 0.95  # weight of the previous noise estimate in the next image


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """Criteria of a spot."""

    threshold_sigmas: float = 5.0
    """above the background, of a sum of 3 x 3 pixels"""
    least_snr: float = 6.0
    """flux over its sigma, for a known shape"""
    narrowest_sigma_px: float = 0.5
    """a narrower light is a defective pixel"""
    weak_sigmas: float = 4.0
    weak_snr: float = 4.0
    """the same two of weak lights: in a whole image noise alone would exceed them"""
    faint_snr: float = 5.0
    """of weak lights in a whole image"""
    largest_px: float = 96.0
    """diameter of the largest spot"""
    most_spots: int = 64
    """of more, the brightest are kept"""


class SpotDetector:
    """Detector of one camera. Not thread-safe: it keeps its scratch memory.

    Without ``sensor`` it estimates the shot noise from the spots so far.
    """

    def __init__(
        self, shape: tuple[int, int], settings: DetectorSettings | None = None, sensor: Sensor | None = None
    ) -> None:
        self._settings = settings or DetectorSettings()
        self._shape = shape
        self._label = np.zeros(shape, dtype=np.int16)
        self._queue = np.empty(shape[0] * shape[1], dtype=np.int32)
        self._spots = np.zeros(2 * _MOST_COMPONENTS, SPOT)
        self._noise = np.zeros((_MOST_COMPONENTS, 2))
        self._last = self._spots[:0].copy()
        self._given_per_level = 1.0 / sensor.electrons_per_level if sensor else None
        self._noise_sums, self._work = np.zeros(2), np.zeros(3)
        self.overfull = False
        """Whether the last image had more lights than can be measured, and therefore no spots."""

    @property
    def is_exhausted(self) -> bool:
        """Return whether lights of the last image took too long to measure, and are left out."""
        return bool(self._work[0] < 0.0 or self._work[2] > 0.0)

    @property
    def variance_per_level(self) -> float:
        """Return the variance, levels^2, per level of light: the reciprocal of the electrons per level."""
        if self._given_per_level is not None:
            return self._given_per_level
        above, below = self._noise_sums
        return max(float((above + _PRIOR_WEIGHT * _PRIOR_PER_LEVEL) / (below + _PRIOR_WEIGHT)), 0.0)

    def spots(
        self, image: np.ndarray, windows: Array | None = None, weak: bool = False, steps: bool = False,
        retry: bool = False,
    ) -> np.ndarray:  # fmt: skip
        """Return the spots of ``image`` (h, w), uint8, as an array of SPOT.

        windows: (k, 4), px: u and v of the first pixel and of the one after the last of each region to be searched; a
        light that extends into one is measured completely, once. None: the whole image. weak: weak lights too. steps:
        the background of the whole image has steps everywhere (``kernels/split``). retry: of the image that
        was searched last, within what that left of its work.
        Raise BadInput for an image of another shape or type.
        """
        if image.shape != self._shape or image.dtype != np.uint8:
            text = f"{image.dtype} {image.shape}, must be uint8 {self._shape} (height, width)"
            raise BadInput.single("image", "shape", text)
        if windows is not None and len(windows) == 0:
            return self._spots[:0].copy()
        regions = _NO_WINDOWS if windows is None else np.ascontiguousarray(windows, dtype=np.int64)
        first_light = not self._noise_sums[1] and self._given_per_level is None
        if not retry:
            self._work[0], self._work[2] = _MOST_WORK, 0.0
        spots = self._search(np.ascontiguousarray(image), regions, weak, steps)
        if self._update_noise() and first_light and self._work[0] > 0.5 * _MOST_WORK:
            spots = self._search(np.ascontiguousarray(image), regions, weak, steps)
        return spots

    def _search(self, image: np.ndarray, windows: np.ndarray, weak: bool, steps: bool) -> np.ndarray:
        chosen = self._settings
        limits = np.zeros(1, LIMITS)[0]
        limits["least_snr"] = (chosen.weak_snr if len(windows) else chosen.faint_snr) if weak else chosen.least_snr
        limits["narrowest"] = chosen.narrowest_sigma_px
        limits["largest"] = chosen.largest_px
        for attempt in range(_STEPS_TRIES if steps else _MOST_TRIES):
            limits["sigmas"] = (chosen.weak_sigmas if weak else chosen.threshold_sigmas) * 2.0**attempt
            self._noise[:] = 0.0
            frame = Frame(
                image, self._label, self._queue, limits, self.variance_per_level,
                self._last if len(windows) else self._last[:0], self._work,
            )  # fmt: skip
            count = detect(frame, windows, steps, self._spots, self._noise)
            if count == TOO_MANY and not (
                attempt or steps or weak or len(windows)
            ):  # as of a wall that is brighter in parts
                self._noise[:] = 0.0
                count = detect(frame, windows, True, self._spots, self._noise)
            if count != TOO_MANY:
                break
        self.overfull = count == TOO_MANY
        spots = self._spots[: max(count, 0)].copy()
        if len(spots) > chosen.most_spots:
            brightest = np.argsort(spots["flux"])[-chosen.most_spots :]
            spots = spots[np.sort(brightest)]
        self._last = spots.copy()
        return spots

    def _update_noise(self) -> bool:
        """Update the shot noise by the last image: the mean of its typical spots' estimates."""
        sums = self._noise[self._noise[:, 1] > 0.0]
        if self._given_per_level is not None or not len(sums):
            return False
        each = sums[:, 0] / sums[:, 1]
        apart = np.abs(each - median(each.tolist()))
        usual = apart <= _UNUSUAL * median(apart.tolist())  # excludes irregular shapes, which would appear as noise
        self._noise_sums = _FORGETTING * self._noise_sums + sums[usual].sum(axis=0)
        return True
