"""Records of sensors: what a module measures from, what the filters expect of it, and the samples between both.

The same bytes are the arguments of the two kernels of a sensor module, ``measure`` and ``innovate``
(``hil.sensors.module``). SI; H is Hill's frame of the target, c the chaser's body frame, quaternions have the scalar
last and ``q_CH`` takes components in H to components in c.
"""

from __future__ import annotations

import math
from typing import Final

from hil.core.fields import Field, number, record_dtype, whole

ADDED_SENSORS_MAX: Final = 8
"""Sensors that a scenario can add."""
MAX_SENSORS: Final = ADDED_SENSORS_MAX + 1
"""Sensors of a loop: those, and the docking monitor."""
COMPONENTS_MAX: Final = 6
"""Components of a measurement."""
SENSOR_ERRORS_MAX: Final = 6
"""Error states of one sensor."""
ERROR_STATES_MAX: Final = 12
"""Error states of all of them."""
NORMALS: Final = 16
MEMORY: Final = 16
SAMPLES_PER_CYCLE: Final = 16
"""Samples of all sensors that the navigation takes in one cycle."""

SENSOR_SAMPLE_FIELDS: Final = (
    whole("sensor", "number of the sensor in the scenario, from 0"),
    whole("number", "number of the measurement of that sensor, from 0"),
    number("t_s", "s", "moment of the measurement, time of the run"),
    number("received_s", "s", "when the loop received it, time of the run"),
    Field("value", "f8", COMPONENTS_MAX, "SI", "", "components as the module declares them; the others are zero"),
    Field(
        "covariance", "f8", (COMPONENTS_MAX, COMPONENTS_MAX), "SI", "",
        "of the noise, as the sensor reports it; zero if it does not",
    ),
    whole("status", "status that the sensor reported, 0 good"),
)  # fmt: skip
SENSOR_SAMPLE = record_dtype(SENSOR_SAMPLE_FIELDS)

NOT_USED, REJECTED, ACCEPTED, EXCLUDED, LATE = range(5)
"""What became of a sample. EXCLUDED: its sensor is suspect; LATE: older than the memory of the filters, or too many.

A sample of a witness is ACCEPTED if it agrees with the navigation, REJECTED if not, LATE if too old to be compared."""

SENSOR_ARRIVAL_FIELDS: Final = (
    whole("cycle", "number of the cycle in which the loop received it"),
    Field("sample", SENSOR_SAMPLE_FIELDS),
    whole("result", "0 not used, 1 rejected, 2 accepted, 3 sensor excluded, 4 too late"),
    Field("innovation", "f8", COMPONENTS_MAX, "1", "", "each component over its standard deviation", math.nan),
    number("nis", "1", "normalised innovation squared", math.nan),
)
SENSOR_ARRIVAL = record_dtype(SENSOR_ARRIVAL_FIELDS)
"""A sample as the loop received it, and what the navigation made of it: the row that is recorded."""

_RELATIVE_MOTION: Final = (
    number("t_s", "s", "moment of the measurement, time of the run"),
    Field("r_CT_H", "f8", 3, "m", "H", "chaser's reference point from the target's"),
    Field("v_CT_H", "f8", 3, "m/s", "H", "its velocity, as seen in H"),
    Field("q_CH", "f8", 4, "1", "", "attitude of the chaser"),
    Field("w_CH_C", "f8", 3, "rad/s", "c", "rate of the chaser against H"),
)
_SUN: Final = Field("sun_I", "f8", 3, "1", "I", "unit vector to the Sun")

SENSOR_TRUTH_FIELDS: Final = (
    *_RELATIVE_MOTION,
    Field("r_T_I", "f8", 3, "m", "I", "target from the centre of the central body"),
    Field("v_T_I", "f8", 3, "m/s", "I", "its velocity"),
    Field("q_HI", "f8", 4, "1", "", "attitude of H"),
    _SUN,
    number("sunlight", "1", "visible fraction of the Sun's disc; 1 without eclipses"),
    number("dt_s", "s", "since the measurement before, 0 for the first"),
    Field("normal", "f8", NORMALS, "1", "", "independent standard normals: the only random numbers of a measurement"),
    Field("memory", "f8", MEMORY, "", "", "of the module's own: zero before the run, kept between measurements"),
)
SENSOR_TRUTH = record_dtype(SENSOR_TRUTH_FIELDS)
"""What ``measure`` reads: the truth, or the bench in its place, with random numbers; ``memory`` is the module's."""

SENSOR_ESTIMATE_FIELDS: Final = (
    *_RELATIVE_MOTION,
    Field("q_HI", "f8", 4, "1", "", "attitude of H by the orbit as the GNC has it; nan for a target that tumbles"),
    _SUN,
)
SENSOR_ESTIMATE = record_dtype(SENSOR_ESTIMATE_FIELDS)
"""What ``innovate`` reads: the estimate at the moment of the measurement."""

STATES: Final = 9
"""Errors to which an innovation may be sensitive: of r_CT_H, of v_CT_H, and the rotation theta of c, in c, with which
``u_true = u_estimated - theta x u`` for the components in c of a vector."""

SENSOR_OUTPUT_FIELDS: Final = (
    whole("valid", "1; a module sets 0 if there is no measurement"),
    Field("sample", SENSOR_SAMPLE_FIELDS),
)
SENSOR_OUTPUT = record_dtype(SENSOR_OUTPUT_FIELDS)
"""What ``measure`` writes."""

SENSOR_INNOVATION_FIELDS: Final = (
    Field("sample", SENSOR_SAMPLE_FIELDS),
    Field("value", "f8", COMPONENTS_MAX, "SI", "", "measured minus expected"),
    Field("h", "f8", (COMPONENTS_MAX, STATES), "SI", "", "its sensitivity to position, velocity and theta"),
    Field(
        "h_errors", "f8", (COMPONENTS_MAX, SENSOR_ERRORS_MAX), "SI", "",
        "its sensitivity to the errors of the sensor; preset: 1 on the component of each",
    ),
    Field("noise", "f8", (COMPONENTS_MAX, COMPONENTS_MAX), "SI", "", "covariance of the noise; preset: the sample's"),
    Field(
        "tolerance", "f8", COMPONENTS_MAX, "SI", "",
        "largest constant error of a sound witness; preset: 3 sigma of its errors",
    ),
)  # fmt: skip
SENSOR_INNOVATION = record_dtype(SENSOR_INNOVATION_FIELDS)
"""What ``innovate`` writes."""
