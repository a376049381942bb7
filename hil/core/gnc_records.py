"""Records of the boundary to a GNC outside the bench: setup, and inputs and outputs of navigation, control and both.

A backend of navigation or of control is ``int step(input, output, instance)``, called once per cycle while the run's
time advances. A whole GNC is both parts answered by one call: ``GNC_INPUT`` and ``GNC_OUTPUT``, which
``hil.gnc.whole_step`` takes apart into those of navigation and control.

The same bytes are the arguments of kernels, the structs of shared libraries (``hil_gnc.h``, ``hil_backends.h``), the
objects that a Python class receives and, but for what is measured, mailboxes of the reflective memory: little-endian,
aligned as a C compiler for x86-64 or ARM64 aligns them, SI. H is Hill's (LVLH) frame of the target, c the chaser's body
frame; quaternions have the scalar last and ``q_CH`` takes components in H to components in c
(``docs/explanation/frames.md``).
"""

from __future__ import annotations

import math
from enum import IntEnum, IntFlag
from typing import Final, TypeVar

import numpy as np

from hil.core.fields import Field, number, record_class, record_dtype, whole
from hil.core.messages import MAX_POSES, MAX_THRUSTERS, NAVIGATION_FIELDS, POSE_STATUS, REFERENCE_FIELDS
from hil.core.sensor_records import SAMPLES_PER_CYCLE, SENSOR_SAMPLE_FIELDS

PROTOCOL: Final = 4
"""Version of setup, input and output of a whole GNC; incremented when fields are appended. 2: protection levels and
health in the output. 3: orbit and motion of the target in the setup. 4: everything measured in the input."""
OLDEST_PROTOCOL: Final = 3
"""Of a shared library that the bench accepts: it has the first fields of the records."""
MEASURED_PROTOCOL: Final = 4
"""First one that has everything measured."""
BACKEND_PROTOCOL: Final = 2
"""The same of the records of navigation and control. 2: measurements of further sensors."""
REASON_BYTES: Final = 128
"""Size of the text with which a library rejects a scenario, including its terminating zero."""
TEXT_BYTES: Final = 64
"""Size of a text of an output."""
MAX_IMU_SAMPLES: Final = 64
"""Samples of the IMU that a GNC can receive in one cycle."""
MAX_SETTINGS: Final = 32
"""Settings that a backend can declare."""

_Int = TypeVar("_Int", bound=int)


def _documented(cls: type[_Int], value: int, meaning: str) -> _Int:
    """Return a new member of an integer enumeration whose values are pairs: number and meaning."""
    member = int.__new__(cls, value)
    member._value_ = value  # type: ignore[attr-defined]
    member.meaning = meaning  # type: ignore[attr-defined]
    return member


class GncMode(IntEnum):
    """Mode of the bench as sent to a GNC; thrusters open in RUNNING only."""

    meaning: str
    __new__ = _documented  # type: ignore[assignment]

    STANDBY = 0, "the setup is complete, nothing is measured yet"
    ARMED = 1, "the bench is at the start pose; the run's time has not started"
    RUNNING = 2, "the run's time advances; each input requires an output"
    HOLD = 3, "the axes are braked and the run's time is held; the GNC keeps its state"
    STOPPED = 4, "the run is over"


class GncOrder(IntFlag):
    """Commands to a GNC, bits of ``orders``; each is sent in one input only."""

    meaning: str
    __new__ = _documented  # type: ignore[assignment]

    NONE = 0, ""
    GO = 1, "the operator releases the approach from its wait"
    ABORT = 2, "an abort has started, by command or by the approach monitor: the reference brakes and retreats"


class GncState(IntEnum):
    """State that a GNC reports of itself."""

    meaning: str
    __new__ = _documented  # type: ignore[assignment]

    STARTING = 0, "no RUNNING input has been answered yet; demands are ignored"
    WORKING = 1, ""
    ASKS_FOR_HOLD = 2, "requests a hold; the run can be resumed"
    FAULT = 3, "requests a stop of the bench; text gives the reason"


class GncHealth(IntFlag):
    """Health of the navigation, bits of ``health``; 0 is healthy."""

    meaning: str
    __new__ = _documented  # type: ignore[assignment]

    HEALTHY = 0, ""
    VISION_LOST = 1, "no pose of the vision unit is usable"
    VISION_SUSPECT = 2, "poses are rejected, or their innovations are not those of their covariance"
    IMU_SUSPECT = 4, ""
    THRUSTER_FAULT = 8, "a thruster does not do what is commanded"
    MONITOR_DISAGREES = 16, "the docking monitor measures another pose"
    COVARIANCE_INVALID = 32, "a covariance of the filters is not finite or not positive definite"
    BENCH_DISAGREES = 64, "the bench's encoders contradict the estimate"
    SENSOR_SUSPECT = 128, "a further sensor contradicts the others and is excluded"
    CAUSE_UNKNOWN = 256, "innovations or the IMU are inconsistent, and no device stands out as the cause"


GNC_ORBIT_FIELDS: Final = (
    number("eccentricity", "1", "of the target's orbit, 0 for a circle"),
    number("mean_anomaly_rad", "rad", "of the target at t_s = 0"),
    whole("tumbles", "1: H is fixed in the body of a target that rotates freely; 0: Hill's frame"),
    Field("target_rate_radps", "f8", 3, "rad/s", "H", "of that body against inertial space at t_s = 0; else zero"),
    Field("target_inertia_kgm2", "f8", (3, 3), "kg m^2", "H", "inertia of that body; else zero"),
)
GNC_ORBIT: Final = record_dtype(GNC_ORBIT_FIELDS)
"""Orbit and motion of the target as the GNC has them, with the errors of its ephemeris; last fields of the setup."""

GNC_SETUP_FIELDS: Final = (
    Field("scenario", "S32", (), "", "", "name of the scenario"),
    number("step_s", "s", "length of a cycle"),
    number("duration_s", "s", "length of the run"),
    number("mean_motion_radps", "rad/s", "of the target's orbit: Hill's equations"),
    number("mass_kg", "kg", "nominal mass of the chaser"),
    Field("inertia_kgm2", "f8", (3, 3), "kg m^2", "c", "nominal inertia of the chaser"),
    whole("n_thrusters", "number of thrusters; the other places are zero"),
    Field("thruster_position_m", "f8", (MAX_THRUSTERS, 3), "m", "c", "position of each thruster"),
    Field("thruster_force_N", "f8", (MAX_THRUSTERS, 3), "N", "c", "force on the chaser while open"),
    number("minimum_on_s", "s", "shortest burn"),
    Field("acceleration_mps2", "f8", 3, "m/s^2", "c", "of a force demand along each axis, without boost"),
    Field("angular_acceleration_radps2", "f8", 3, "rad/s^2", "c", "of a torque demand about each axis"),
    Field("start_r_CT_H_m", "f8", 3, "m", "H", "position at the start"),
    Field("start_q_CH", "f8", 4, "1", "H to c", "attitude at the start"),
    Field("ready_point_m", "f8", 3, "m", "H", "where the chaser waits for docking"),
    number("closing_rate_max_mps", "m/s", "largest closing rate"),
    *GNC_ORBIT_FIELDS,
)
GNC_SETUP: Final = record_dtype(GNC_SETUP_FIELDS)
"""Nominal vehicle and plan, known to a GNC before the run; the dispersed vehicle is not."""
GNC_SETUP_2: Final = record_dtype(GNC_SETUP_FIELDS[: -len(GNC_ORBIT_FIELDS)])
"""The mailbox gnc.setup: one with the orbit would not fit into an Ethernet frame."""

GNC_POSE_FIELDS: Final = (
    number("t_s", "s", "moment of exposure, time of the run"),
    Field("r_TC_C_m", "f8", 3, "m", "c", "target's reference point seen from the chaser's"),
    Field("q_CH", "f8", 4, "1", "H to c", "measured attitude"),
    Field("covariance_position_m2", "f8", (3, 3), "m^2", "c", "covariance of r_TC_C_m"),
    Field("covariance_attitude_rad2", "f8", (3, 3), "rad^2", "c", "covariance of the small-angle rotation of c"),
)
GNC_POSE: Final = record_dtype(GNC_POSE_FIELDS)

BACKEND_POSE_FIELDS: Final = (
    *GNC_POSE_FIELDS,
    Field("covariance_cross_m_rad", "f8", (3, 3), "m rad", "c", "of r_TC_C_m (rows) and the small-angle rotation"),
    POSE_STATUS,
)
BACKEND_SAMPLE_FIELDS: Final = (
    Field("rate_radps", "f8", 3, "rad/s", "c", "gyro, mean over the sample, against inertial space"),
    Field("force_mps2", "f8", 3, "m/s^2", "c", "accelerometer, mean over the sample"),
)
_N_SAMPLES: Final = whole("n_samples", "samples of the IMU since the cycle before; none in cycle 0")
_N_POSES: Final = whole("n_poses", "poses since the cycle before")
_SAMPLES: Final = Field("samples", BACKEND_SAMPLE_FIELDS, MAX_IMU_SAMPLES, "", "", "the first n_samples are valid")
_POSES: Final = Field(
    "poses", BACKEND_POSE_FIELDS, MAX_POSES, "", "", "the first n_poses are valid, in order of arrival"
)
_MEASUREMENTS: Final = (
    whole("n_measurements", "measurements of further sensors since the cycle before"),
    Field("measurements", SENSOR_SAMPLE_FIELDS, SAMPLES_PER_CYCLE, "", "", "the first n_measurements are valid"),
)
MEASURED_FIELDS: Final = (_N_SAMPLES, _N_POSES, _MEASUREMENTS[0], _SAMPLES, _POSES, _MEASUREMENTS[1])
"""Everything measured since the cycle before."""

GNC_INPUT_FIELDS: Final = (
    whole("cycle", "RUNNING: counts from 0, the output has the same number; else the last one, initially -1"),
    number("t_s", "s", "time of the run"),
    Field("mode", "i4", (), "1", "", "hil_gnc_mode"),
    Field("orders", "i4", (), "1", "", "hil_gnc_order"),
    Field("rate_radps", "f8", 3, "rad/s", "c", "gyro, mean over the last step, against inertial space"),
    Field("force_mps2", "f8", 3, "m/s^2", "c", "accelerometer, mean over the last step"),
    Field("reference_r_CT_H_m", "f8", 3, "m", "H", "the scenario's plan at t_s; its use is optional"),
    Field("reference_v_CT_H_mps", "f8", 3, "m/s", "H", "velocity of the plan"),
    Field("reference_a_CT_H_mps2", "f8", 3, "m/s^2", "H", "acceleration of the plan"),
    Field("reference_q_CH", "f8", 4, "1", "H to c", "attitude of the plan"),
    whole("boost", "1: force demands open the high-thrust sets, as the brake of an abort needs"),
    whole("n_poses", "number of poses since the last input"),
    Field("poses", GNC_POSE_FIELDS, MAX_POSES, "", "", "the first n_poses are valid; whole poses alone"),
    Field(
        "measured", MEASURED_FIELDS, (), "", "", "all samples, poses and measurements, as a navigation receives them"
    ),
)
GNC_INPUT: Final = record_dtype(GNC_INPUT_FIELDS)
GNC_INPUT_3: Final = record_dtype(GNC_INPUT_FIELDS[:-1])
"""The mailbox gnc.input, the input of protocol 3: what is measured has mailboxes of its own."""

GNC_OUTPUT_FIELDS: Final = (
    whole("cycle", "of the input that this answers"),
    Field("state", "i4", (), "1", "", "hil_gnc_state"),
    Field("direct", "i4", (), "1", "", "1: on opens thrusters; 0: the bench allocates force and torque"),
    Field("force", "i4", 3, "1", "c", "demand along each axis: -1, 0 or 1"),
    Field("torque", "i4", 3, "1", "c", "demand about each axis: -1, 0 or 1"),
    Field("on", "u1", MAX_THRUSTERS, "1", "", "thrusters, 0 or 1"),
    whole("estimate", "1: the next four fields hold an estimate, which is recorded and monitored"),
    Field("r_CT_H_m", "f8", 3, "m", "H", "estimated position"),
    Field("v_CT_H_mps", "f8", 3, "m/s", "H", "estimated velocity"),
    Field("q_CH", "f8", 4, "1", "H to c", "estimated attitude"),
    Field("w_CH_C_radps", "f8", 3, "rad/s", "c", "estimated rate against H"),
    Field("text", f"S{TEXT_BYTES}", (), "", "", "message for the operator; empty for none"),
    Field("protection_level_m", "f8", 3, "m", "H", "bound on the error of r_CT_H_m, per axis; 0 or nan: not reported"),
    number("protection_level_rad", "rad", "bound on the attitude error; 0 or nan: not reported"),
    whole("health", "0 healthy; sum of hil_gnc_health"),
)
GNC_OUTPUT: Final = record_dtype(GNC_OUTPUT_FIELDS)

_HEAD: Final = (
    whole("cycle", "number of the cycle, from 0"),
    number("t_s", "s", "time of the run"),
    Field("mode", "i4", (), "1", "", "hil_gnc_mode; a backend is called in RUNNING only"),
)
_THRUSTERS: Final = (
    whole("fault", "of a thruster, by the thruster monitor: 0 none, 1 stuck open, 2 dead"),
    whole("fault_thruster", "that has it, from 0"),
)

NAVIGATION_INPUT_FIELDS: Final = (
    *_HEAD,
    Field("orders", "i4", (), "1", "", "hil_gnc_order, as of the cycle before"),
    whole("imu_suspect", "1: the IMU's readings repeat, or no thruster explains them"),
    _N_SAMPLES,
    _N_POSES,
    number("second_bound_m", "m", "bound on the position error by the docking monitor; 0: none"),
    number("second_bound_s", "s", "time of its measurement, time of the run"),
    *_THRUSTERS,
    Field("commanded", "u1", MAX_THRUSTERS, "1", "", "thrusters commanded in the cycle before, 0 or 1"),
    Field("isolated", "u1", MAX_THRUSTERS, "1", "", "thrusters whose supply is being or has been closed, 0 or 1"),
    _SAMPLES,
    _POSES,
    Field("setup", GNC_SETUP_FIELDS, (), "", "", "nominal vehicle and plan: hil_gnc_setup"),
    *_MEASUREMENTS,
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
    whole("phase", "number of the phase; after the list: brake, retreat, hold of an abort"),
    whole("reaction", "to the health: 0 continue, 1 coast, 2 hold, 3 retreat, 4 abort"),
    whole("aborted", "cause of the abort, 0 for none"),
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
CONTROL_INPUT: Final = record_dtype(CONTROL_INPUT_FIELDS, text="u1")

NavigationInput: Final = record_class("NavigationInput", NAVIGATION_INPUT_FIELDS, "Input of a backend of navigation.")
ControlInput: Final = record_class("ControlInput", CONTROL_INPUT_FIELDS, "Input of a backend of control.")
GncInput: Final = record_class("GncInput", GNC_INPUT_FIELDS, "Input of a whole GNC.")
"""Records with their fields as documented attributes, for notebooks."""

INPUTS: Final = {"navigation": NAVIGATION_INPUT, "control": CONTROL_INPUT, "gnc": GNC_INPUT}
OUTPUT_FIELDS: Final = {
    "navigation": NAVIGATION_OUTPUT_FIELDS,
    "control": CONTROL_OUTPUT_FIELDS,
    "gnc": GNC_OUTPUT_FIELDS,
}
OUTPUTS: Final = {part: record_dtype(fields, text="u1") for part, fields in OUTPUT_FIELDS.items()}
OBJECTS: Final[dict[str, np.dtype]] = {"navigation": NavigationInput, "control": ControlInput, "gnc": GncInput}
"""By the part of the GNC, "gnc" for the whole; texts of outputs as arrays of bytes, which kernels can compare."""
