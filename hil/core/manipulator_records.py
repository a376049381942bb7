"""Records of axes that a cycle's record lacks: of a rig whose target is rotated, and of axes held at their place.

In a cycle's record the axes of a rig whose target is rotated are relative to the target.
"""

from __future__ import annotations

from typing import Final

from hil.core.fields import Field, number, record_dtype, whole
from hil.core.messages import AXES_FIELDS, AXES_MAX

GIMBALS_FIELDS: Final = (
    Field("angle_rad", "f8", 3, "rad", "", "roll, pitch, yaw of the rotary manipulator"),
    Field("rate_radps", "f8", 3, "rad/s", "", "their rates"),
)

MANIPULATOR_SAMPLE_FIELDS: Final = (
    number("t_s", "s", "time of the run, that of the cycle's row"),
    Field("setpoint", GIMBALS_FIELDS),
    Field("feedback", GIMBALS_FIELDS),
    number("sampled_s", "s", "when the encoders had these values, time of the run"),
    Field("chaser_setpoint", AXES_FIELDS),
    Field("chaser_feedback", AXES_FIELDS),
)
MANIPULATOR_SAMPLE: Final = record_dtype(MANIPULATOR_SAMPLE_FIELDS)
"""Last setpoints and newest encoder values of all nine axes in a cycle; chaser: rails and turntable, in the lab."""


HELD_SAMPLE_FIELDS: Final = (
    number("t_s", "s", "time of the run, that of the cycle's row"),
    whole("group", "number of the group in `held_axes.json`, from 0"),
    Field("setpoint", "f8", AXES_MAX, "SI", "", "of its axes, m or rad; of axes that it lacks zero"),
    Field("position", "f8", AXES_MAX, "SI", "", "by the encoders, m or rad"),
    Field("rate", "f8", AXES_MAX, "SI", "", "by the encoders, m/s or rad/s"),
    number("sampled_s", "s", "when the encoders had these values, time of the run"),
)
HELD_SAMPLE: Final = record_dtype(HELD_SAMPLE_FIELDS)
"""Places and newest encoder values of one group in a cycle."""
