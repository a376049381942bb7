"""What the monitor says: of each frame, of each portion. Plain data, for tables, pictures and the console alike."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.monitor.preprocess import Region

Floats = NDArray[np.float64]

NEAR: Final = "near"
FAR: Final = "far"
NO_TARGET: Final = "no_target"

VALUES: Final = (
    "d1_m", "d2_m", "d3_m", "phi1_rad", "phi2_rad", "phi3_rad", "range_m", "range_rate_mps",
    "pitch_passive_rad", "yaw_passive_rad", "los_right_rad", "los_up_rad",
)  # fmt: skip
"""The quantities of a portion, in the order of the table's columns."""

FAR_VALUES: Final = ("phi3_rad", "range_m", "range_rate_mps", "los_right_rad", "los_up_rad")
"""What the ship's outline and boxes can tell; the rest needs the cross."""


@dataclass(frozen=True)
class Points:
    """Measured points of edges, px: where they are (n, 2), of which feature (n,), whether they were used (n,)."""

    place_px: Floats
    sigma_px: Floats
    feature: NDArray[np.int64]
    used: NDArray[np.bool_]


def no_points() -> Points:
    """Return no points."""
    return Points(np.empty((0, 2)), np.empty(0), np.empty(0, np.int64), np.empty(0, np.bool_))


@dataclass(frozen=True)
class FrameResult:
    """One frame: its status ("near", "far", "no_target", "rejected_<why>"), why in words, and what was measured.

    pose: (7,), d, m, phi, rad, growth, px (nan where nothing was). normal: (7, 7), of the edges alone, and prior
    (7,), the diagonal that held the pose beside it. sums: (4,) of ``measure.square_sums``. region: where it was
    looked for. centre_px, radius_px: the disc's circle (the ship's in far mode); cross_px: the cross' centre.
    """

    number: int
    t_s: float
    status: str
    reason: str
    region: Region
    pose: Floats
    normal: Floats
    prior: Floats
    sums: Floats
    points: Points = field(default_factory=no_points)
    tracked: bool = False
    blur_px: float = float("nan")
    noise_grey: float = float("nan")
    centre_px: tuple[float, float] = (float("nan"), float("nan"))
    radius_px: float = float("nan")
    cross_px: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def used(self) -> bool:
        """Whether the frame takes part in its portion."""
        return self.status in (NEAR, FAR)


@dataclass(frozen=True)
class Portion:
    """A portion's row: time of its last frame, frames used, status, values and sigmas by the names of VALUES.

    sigma2_edges, sigma2_common, sigma2_motion: square sums of residuals against what noise explains: of single
    points, of what the points of one edge share, of the frames about the motion; about 1 each if all is well.
    consistent: whether they are. covariance: (12, 12) of (d1, d1', d2, ..., phi3'), SI.
    """

    t_s: float
    frames: int
    status: str
    values: dict[str, float]
    sigmas: dict[str, float]
    sigma2_edges: float = float("nan")
    sigma2_common: float = float("nan")
    sigma2_motion: float = float("nan")
    consistent: bool = False
    covariance: Floats = field(default_factory=lambda: np.full((12, 12), np.nan))
    reasons: tuple[tuple[str, int], ...] = ()
