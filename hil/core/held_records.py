"""Record of axes that are held at their places during a run: those of a target manipulator, and further ones."""

from __future__ import annotations

from typing import Final

from hil.core.fields import Field, record_dtype
from hil.core.messages import AXES_MAX

HELD_SAMPLE_FIELDS: Final = (
    Field("t_s", "f8", (), "s", "", "time of the run, that of the cycle's row"),
    Field("group", "i8", (), "1", "", "number of the group in `held_axes.json`, from 0"),
    Field("setpoint", "f8", AXES_MAX, "SI", "", "places of its axes, m or rad; of axes that it lacks zero"),
    Field("position", "f8", AXES_MAX, "SI", "", "by the encoders, m or rad"),
    Field("rate", "f8", AXES_MAX, "SI", "", "by the encoders, m/s or rad/s"),
    Field("sampled_s", "f8", (), "s", "", "when the encoders had these values, time of the run"),
)
HELD_SAMPLE: Final = record_dtype(HELD_SAMPLE_FIELDS)
"""Places and newest encoder values of one group in a cycle."""
