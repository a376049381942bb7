"""Results of the docking monitor: per frame what was detected, per portion (batch of frames) pose and motion.

Table, screen and console use only these.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hil.core.fields import Field, record_dtype

Floats = NDArray[np.float64]

NEAR: Final = "near"
FAR: Final = "far"
AMBIGUOUS: Final = "ambiguous"
NO_TARGET: Final = "no_target"

FAR_QUANTITIES: Final = frozenset(("phi3_rad", "range_m", "range_rate_mps", "los_right_rad", "los_up_rad"))
"""Observable from the ship's outline and boxes; the rest requires the cross."""
ANY_ROLL_QUANTITIES: Final = FAR_QUANTITIES - {"phi3_rad"}
"""The same at each roll of the ship that its image allows."""

QUANTITY_FIELDS: Final = (
    Field(
        "d1_m", "f8", (), "m", "", "camera in the target's frame C, along y1; nan if not observable, as all that follow"
    ),
    Field("d2_m", "f8", (), "m", "", "the same along y2"),
    Field("d3_m", "f8", (), "m", "", "the same along y3"),
    Field("phi1_rad", "f8", (), "rad", "", "active pitch"),
    Field("phi2_rad", "f8", (), "rad", "", "active yaw"),
    Field("phi3_rad", "f8", (), "rad", "", "active roll"),
    Field("range_m", "f8", (), "m", "", "range"),
    Field("range_rate_mps", "f8", (), "m/s", "", "range rate"),
    Field("pitch_passive_rad", "f8", (), "rad", "", "passive pitch"),
    Field("yaw_passive_rad", "f8", (), "rad", "", "passive yaw"),
    Field("los_right_rad", "f8", (), "rad", "", "target's disc to the right of the optical axis"),
    Field("los_up_rad", "f8", (), "rad", "", "target's disc above the optical axis"),
)
QUANTITIES: Final = tuple(field.name for field in QUANTITY_FIELDS)

PORTION_FIELDS: Final = (
    Field("t_s", "f8", (), "s", "", "time of the portion's last frame"),
    Field("frames", "i8", (), "1", "", "number of frames that were used"),
    Field("status", "S24", (), "1", "", "near, far, ambiguous, no_target or rejected_<reason>"),
    *QUANTITY_FIELDS,
    *(
        Field(f"sigma_{field.name}", "f8", (), field.unit, "", f"standard deviation of {field.name}")
        for field in QUANTITY_FIELDS
    ),
)
PORTION: Final = record_dtype(PORTION_FIELDS)
"""A portion as a record."""


@dataclass(frozen=True)
class FrameDetection:
    """Features detected in one frame, in px (u, v) and lines of the full image; None and empty: not detected.

    status: "near", "far", "no_target" or "rejected_<why>". region: (u, v, width, height) of the region of interest.
    edges: (n, 2), the measured points. cross: (u, v, angle): its centre, and the slope of the bar across, rad,
    anticlockwise. disc, outline: (u, v, radius) of the circles. corners: (n, 2), of an outline with corners.
    """

    number: int
    t_s: float
    status: str
    region: tuple[float, float, float, float] | None = None
    edges: Floats = field(default_factory=lambda: np.empty((0, 2)))
    cross: tuple[float, float, float] | None = None
    disc: tuple[float, float, float] | None = None
    outline: tuple[float, float, float] | None = None
    corners: Floats = field(default_factory=lambda: np.empty((0, 2)))


@dataclass(frozen=True)
class Portion:
    """Pose and motion after one portion; t_s and all values refer to its last frame.

    frames: number of frames used. values, sigmas: (12,), by QUANTITIES, SI; nan if not observable.
    """

    t_s: float
    frames: int
    status: str
    values: Floats
    sigmas: Floats

    def value(self, quantity: str) -> float:
        """Return the value of ``quantity``, SI; nan if not observable."""
        return float(self.values[QUANTITIES.index(quantity)])

    def sigma(self, quantity: str) -> float:
        """Return the standard deviation of ``quantity``, SI; nan if not observable."""
        return float(self.sigmas[QUANTITIES.index(quantity)])

    def observes(self, quantity: str) -> bool:
        """Return whether ``quantity`` has a value."""
        return math.isfinite(self.value(quantity))


def portion_row(portion: Portion) -> NDArray[np.void]:
    """Return ``portion`` as a row, shape (1,) of PORTION."""
    row = np.zeros(1, PORTION)
    head = (portion.t_s, portion.frames, portion.status.encode())
    row[0] = (*head, *portion.values.tolist(), *portion.sigmas.tolist())
    return row


def portion_of(row: np.void) -> Portion:
    """Return the Portion of ``row``, one of PORTION."""
    values = np.array([row[name] for name in QUANTITIES])
    sigmas = np.array([row[f"sigma_{name}"] for name in QUANTITIES])
    return Portion(float(row["t_s"]), int(row["frames"]), row["status"].decode(), values, sigmas)


@dataclass(frozen=True)
class FrameResult:
    """Measurement of one frame. detection: for the screen; its status is near, far, no_target or rejected_<why>.

    reason: why it was not used, as text. pose: (15,), d, m, phi, rad, and the unknowns of the camera
    (``kernels/pose.py``). normal: (15, 15), of the edges alone; prior: (15,), the diagonal of the prior on the pose.
    sums: (4,) of ``measure.square_sums``. noise: grey values, 1 sigma of a pixel at grey value 100.
    roll_open: whether another roll of the ship fits as well.
    """

    detection: FrameDetection
    reason: str
    pose: Floats
    normal: Floats
    prior: Floats
    sums: Floats
    tracked: bool
    blur_px: float = float("nan")
    noise: float = float("nan")
    roll_open: bool = False

    @property
    def status(self) -> str:
        """Status of the frame."""
        return self.detection.status

    @property
    def used(self) -> bool:
        """Whether the frame is used in its portion."""
        return self.detection.status in (NEAR, FAR)


@dataclass(frozen=True)
class Result(Portion):
    """A portion with its consistency statistics.

    sigma2_edges, sigma2_common, sigma2_motion: square sums of residuals relative to the pixels' noise, about
    1 each if consistent: of single points; of the common part per edge; of the frames about the motion.
    consistent: whether they are within statistical limits. covariance: (12, 12) of (d1, d1', d2, ..., phi3'), SI.
    reasons: number of frames not used, by reason. jitter_px: 1 sigma of a vibration of the image that the frames show.
    timing: in what the times of the frames differ from those stated: "fields exchanged", "2 images lost", or "".
    """

    sigma2_edges: float = float("nan")
    sigma2_common: float = float("nan")
    sigma2_motion: float = float("nan")
    consistent: bool = False
    covariance: Floats = field(default_factory=lambda: np.full((12, 12), np.nan))
    reasons: tuple[tuple[str, int], ...] = ()
    jitter_px: float = 0.0
    timing: str = ""
