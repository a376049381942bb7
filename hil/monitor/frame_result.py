"""What the parts of the monitor hand to each other: of a frame what it measured, of a portion how sure it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.monitor.results import Portion, Seen

Floats = NDArray[np.float64]

NEAR: Final = "near"
FAR: Final = "far"
NO_TARGET: Final = "no_target"

FAR_QUANTITIES: Final = frozenset(("phi3_rad", "range_m", "range_rate_mps", "los_right_rad", "los_up_rad"))
"""What the ship's outline and boxes can tell; the rest needs the cross."""


@dataclass(frozen=True)
class PaperFrame:
    """The frame in the paper's six quantities X_C, Y_C, a, X_O, Y_O, R (px, image axes of 3.1) and their covariance."""

    values: Floats
    covariance: Floats


@dataclass(frozen=True)
class FrameResult:
    """One frame. seen: for the screen; its status is "near", "far", "no_target" or "rejected_<why>".

    reason: why not used, in words. pose: (7,), d, m, phi, rad, growth, px. normal: (7, 7), of the edges alone;
    prior: (7,), the diagonal that held the pose beside it. sums: (4,) of ``measure.square_sums``. features: of each
    edge point its feature, used: whether it took part. noise: grey values, 1 sigma of a pixel halfway up.
    """

    seen: Seen
    reason: str
    pose: Floats
    normal: Floats
    prior: Floats
    sums: Floats
    tracked: bool
    blur_px: float = float("nan")
    noise: float = float("nan")
    features: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    used_points: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, np.bool_))
    paper: PaperFrame | None = None

    @property
    def status(self) -> str:
        """The frame's status."""
        return self.seen.status

    @property
    def used(self) -> bool:
        """Whether the frame takes part in its portion."""
        return self.seen.status in (NEAR, FAR)


@dataclass(frozen=True)
class Result(Portion):
    """A portion and how far it can be trusted.

    sigma2_edges, sigma2_common, sigma2_motion: square sums of residuals over what the pixels' noise explains, about
    1 each if all is well: of single points; of what the points of one edge share; of the frames about the motion.
    consistent: whether they are as small as chance allows. covariance: (12, 12) of (d1, d1', d2, ..., phi3'), SI.
    reasons: how many frames were not used, by reason.
    """

    sigma2_edges: float = float("nan")
    sigma2_common: float = float("nan")
    sigma2_motion: float = float("nan")
    consistent: bool = False
    covariance: Floats = field(default_factory=lambda: np.full((12, 12), np.nan))
    reasons: tuple[tuple[str, int], ...] = ()
