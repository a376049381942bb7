"""Records of the backends of navigation and of control: input and output of ``int step(input, output, instance)``.

A backend is called once per cycle while the run's time advances. The same bytes are the arguments of a kernel, the
structs of a shared library (``hil_backends.h``) and the objects that a Python class receives: little-endian, aligned as
a C compiler for x86-64 or ARM64 aligns them, SI. H is Hill's (LVLH) frame of the target, c the chaser's body frame;
quaternions have the scalar last and ``q_CH`` takes components in H to components in c.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.fields import Field, record_class, record_dtype
from hil.core.gnc_records import GNC_SETUP_FIELDS
from hil.core.messages import MAX_POSES, MAX_THRUSTERS, NAVIGATION_FIELDS, POSE_STATUS, REFERENCE_FIELDS
from hil.core.sensor_records import SAMPLES_PER_CYCLE, SENSOR_SAMPLE_FIELDS

BACKEND_PROTOCOL: Final = 2
"""Version of the records; incremented when a field is appended. 2: measurements of further sensors."""
MAX_IMU_SAMPLES: Final = 64
"""Samples of the IMU that a backend can receive in one cycle."""
MAX_SETTINGS: Final = 32
"""Settings that a backend can declare."""
TEXT_BYTES: Final = 64

BACKEND_SAMPLE_FIELDS: Final = (
    Field("rate_radps", "f8", 3, "rad/s", "c", "gyro, mean over the sample, against inertial space"),
    Field("force_mps2", "f8", 3, "m/s^2", "c", "accelerometer, mean over the sample"),
)
BACKEND_POSE_FIELDS: Final = (
    Field("t_s", "f8", (), "s", "", "moment of exposure, time of the run"),
    Field("r_TC_C_m", "f8", 3, "m", "c", "target's reference point seen from the chaser's"),
    Field("q_CH", "f8", 4, "1", "H to c", "measured attitude"),
    Field("covariance_position_m2", "f8", (3, 3), "m^2", "c", "covariance of r_TC_C_m"),
    Field("covariance_attitude_rad2", "f8", (3, 3), "rad^2", "c", "covariance of the small-angle rotation of c"),
    Field("covariance_cross_m_rad", "f8", (3, 3), "m rad", "c", "of r_TC_C_m (rows) and the small-angle rotation"),
    POSE_STATUS,
)
_HEAD: Final = (
    Field("cycle", "i8", (), "1", "", "number of the cycle, from 0"),
    Field("t_s", "f8", (), "s", "", "time of the run"),
    Field("mode", "i4", (), "1", "", "hil_gnc_mode; a backend is called in RUNNING only"),
)
_THRUSTERS: Final = (
    Field("fault", "i8", (), "1", "", "of a thruster, by the thruster monitor: 0 none, 1 stuck open, 2 dead"),
    Field("fault_thruster", "i8", (), "1", "", "that has it, from 0"),
)

NAVIGATION_INPUT_FIELDS: Final = (
    *_HEAD,
    Field("orders", "i4", (), "1", "", "hil_gnc_order, as of the cycle before"),
    Field("imu_suspect", "i8", (), "1", "", "1: the IMU's readings repeat, or no thruster explains them"),
    Field("n_samples", "i8", (), "1", "", "samples of the IMU since the cycle before; none in cycle 0"),
    Field("n_poses", "i8", (), "1", "", "poses since the cycle before"),
    Field("second_bound_m", "f8", (), "m", "", "bound on the position error by the docking monitor; 0: none"),
    Field("second_bound_s", "f8", (), "s", "", "time of its measurement, time of the run"),
    *_THRUSTERS,
    Field("commanded", "u1", MAX_THRUSTERS, "1", "", "thrusters commanded in the cycle before, 0 or 1"),
    Field("isolated", "u1", MAX_THRUSTERS, "1", "", "thrusters whose supply is being or has been closed, 0 or 1"),
    Field("samples", BACKEND_SAMPLE_FIELDS, MAX_IMU_SAMPLES, "", "", "the first n_samples are valid"),
    Field("poses", BACKEND_POSE_FIELDS, MAX_POSES, "", "", "the first n_poses are valid, in order of arrival"),
    Field("setup", GNC_SETUP_FIELDS, (), "", "", "nominal vehicle and plan: hil_gnc_setup"),
    Field("n_measurements", "i8", (), "1", "", "measurements of further sensors since the cycle before"),
    Field("measurements", SENSOR_SAMPLE_FIELDS, SAMPLES_PER_CYCLE, "", "", "the first n_measurements are valid"),
)
NAVIGATION_OUTPUT_FIELDS: Final = (
    Field("state", "i4", (), "1", "", "hil_gnc_state"),
    *NAVIGATION_FIELDS,
    Field("bias_mps2", "f8", 3, "m/s^2", "c", "estimated bias of the accelerometer; nan: not reported", math.nan),
    Field("bias_sigma_mps2", "f8", 3, "m/s^2", "c", "its standard deviation; nan: not reported", math.nan),
    Field("text", f"S{TEXT_BYTES}", (), "", "", "message for the operator; empty for none"),
)
CONTROL_INPUT_FIELDS: Final = (
    *_HEAD,
    Field("orders", "i4", (), "1", "", "hil_gnc_order, as of this cycle"),
    Field("phase", "i8", (), "1", "", "number of the phase; after the list: brake, retreat, hold of an abort"),
    Field("reaction", "i8", (), "1", "", "to the health: 0 continue, 1 coast, 2 hold, 3 retreat, 4 abort"),
    Field("aborted", "i8", (), "1", "", "cause of the abort, 0 for none"),
    *_THRUSTERS,
    Field("isolated", "u1", MAX_THRUSTERS, "1", "", "thrusters whose supply is being or has been closed, 0 or 1"),
    Field("withheld", "u1", MAX_THRUSTERS, "1", "", "thrusters that the bench keeps closed in this cycle, 0 or 1"),
    Field("navigation", NAVIGATION_FIELDS, (), "", "", "estimate of this cycle; it is valid"),
    Field("reference", REFERENCE_FIELDS, (), "", "", "reference of this cycle"),
    Field("feed_force_mps2", "f8", 3, "m/s^2", "H", "to be fed forward beyond the reference's acceleration"),
    Field("feed_torque_radps2", "f8", 3, "rad/s^2", "c", "angular acceleration to be fed forward"),
    Field("reference_rate_radps", "f8", 3, "rad/s", "c", "rate of the reference against H"),
    Field("setup", GNC_SETUP_FIELDS, (), "", "", "nominal vehicle and plan: hil_gnc_setup"),
)
CONTROL_OUTPUT_FIELDS: Final = (
    Field("state", "i4", (), "1", "", "hil_gnc_state"),
    Field("direct", "i4", (), "1", "", "1: on opens thrusters; 0: the bench allocates force and torque"),
    Field("force", "i4", 3, "1", "c", "demand along each axis: -1, 0 or 1"),
    Field("torque", "i4", 3, "1", "c", "demand about each axis: -1, 0 or 1"),
    Field("on", "u1", MAX_THRUSTERS, "1", "", "thrusters, 0 or 1"),
    Field("text", f"S{TEXT_BYTES}", (), "", "", "message for the operator; empty for none"),
)
NAVIGATION_INPUT: Final = record_dtype(NAVIGATION_INPUT_FIELDS, text="u1")
NAVIGATION_OUTPUT: Final = record_dtype(NAVIGATION_OUTPUT_FIELDS, text="u1")
CONTROL_INPUT: Final = record_dtype(CONTROL_INPUT_FIELDS, text="u1")
CONTROL_OUTPUT: Final = record_dtype(CONTROL_OUTPUT_FIELDS, text="u1")
"""Layouts in kernels, which can compare texts as bytes only."""

NavigationInput: Final = record_class("NavigationInput", NAVIGATION_INPUT_FIELDS, "Input of a backend of navigation.")
ControlInput: Final = record_class("ControlInput", CONTROL_INPUT_FIELDS, "Input of a backend of control.")
"""Records with their fields as documented attributes, for notebooks."""

INPUTS: Final = {"navigation": NAVIGATION_INPUT, "control": CONTROL_INPUT}
OUTPUTS: Final = {"navigation": NAVIGATION_OUTPUT, "control": CONTROL_OUTPUT}
OUTPUT_FIELDS: Final = {"navigation": NAVIGATION_OUTPUT_FIELDS, "control": CONTROL_OUTPUT_FIELDS}
OBJECTS: Final[dict[str, np.dtype]] = {"navigation": NavigationInput, "control": ControlInput}
"""By the part of the GNC."""
