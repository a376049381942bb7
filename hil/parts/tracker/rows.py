"""Rows that a tracker adds to a recording: one per body of each frame that is compared."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.fields import Field, record_dtype
from hil.core.messages import Array

SAMPLE_FIELDS: Final = (
    Field("t_s", "f8", (), "s", "", "moment of the measurement, brought to the time of the run"),
    Field("received_s", "f8", (), "s", "", "time of its receipt"),
    Field("age_s", "f8", (), "s", "", "age at its receipt"),
    Field("body", "i8", (), "1", "", "0 chaser, 1 target, 2 reference"),
    Field("status", "i8", (), "1", "", "0 ok, 1 lost, 2 swapped, 3 outlier, 4 too old, or ahead of its time, 5 frozen"),
    Field("r_W", "f8", 3, "m", "frame of the tracker", "origin of the body; nan if it is lost"),
    Field("q_bW", "f8", 4, "1", "W to b", "attitude of the body; nan if it is lost, or a point"),
    Field("sigma_m", "f8", (), "m", "", "standard deviation of the position, per axis"),
    Field("sigma_rad", "f8", (), "rad", "", "standard deviation of the attitude"),
    Field("off_m", "f8", 3, "m", "H", "chaser: position by the tracker less that by the encoders"),
    Field("off_rad", "f8", 3, "rad", "c", "chaser: the same of its attitude"),
)
SAMPLE: Final = record_dtype(SAMPLE_FIELDS)


def offsets(rows: np.ndarray) -> tuple[np.ndarray, Array]:
    """Return those of ``rows`` (n,) in which the chaser was measured well, and its positions less the encoders', m."""
    measured = rows[(rows["body"] == 0) & (rows["status"] == 0)]
    return measured, measured["off_m"]
