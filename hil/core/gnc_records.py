"""Records exchanged with an external GNC: setup, input and output.

The same bytes travel as mailboxes of the reflective memory and as the structs of a shared library (``hil_gnc.h``):
little-endian, aligned as a C compiler for x86-64 or ARM64 aligns them. H is Hill's (LVLH) frame of the target, c the
chaser's body frame; quaternions have the scalar last and ``q_CH`` takes components in H to components in c
(``docs/explanation/frames.md``). The bench sends ``GNC_SETUP`` once and ``GNC_INPUT`` each cycle, and receives
``GNC_OUTPUT``.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Final, TypeVar

from hil.core.fields import Field, record_dtype
from hil.core.messages import MAX_POSES, MAX_THRUSTERS

PROTOCOL: Final = 3
"""Version of the records; incremented when fields are appended. 2: protection levels and health in the output. 3: orbit
and motion of the target in the setup."""
REASON_BYTES: Final = 128
"""Size of the text with which a library rejects a scenario, including its terminating zero."""

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


GNC_ORBIT_FIELDS: Final = (
    Field("eccentricity", "f8", (), "1", "", "of the target's orbit, 0 for a circle"),
    Field("mean_anomaly_rad", "f8", (), "rad", "", "of the target at t_s = 0"),
    Field("tumbles", "i8", (), "1", "", "1: H is fixed in the body of a target that rotates freely; 0: Hill's frame"),
    Field("target_rate_radps", "f8", 3, "rad/s", "H", "of that body against inertial space at t_s = 0; else zero"),
    Field("target_inertia_kgm2", "f8", (3, 3), "kg m^2", "H", "inertia of that body; else zero"),
)
GNC_ORBIT: Final = record_dtype(GNC_ORBIT_FIELDS)
"""Orbit and motion of the target as the GNC has them, with the errors of its ephemeris; last fields of the setup."""

GNC_SETUP_FIELDS: Final = (
    Field("scenario", "S32", (), "", "", "name of the scenario"),
    Field("step_s", "f8", (), "s", "", "length of a cycle"),
    Field("duration_s", "f8", (), "s", "", "length of the run"),
    Field("mean_motion_radps", "f8", (), "rad/s", "", "of the target's orbit: Hill's equations"),
    Field("mass_kg", "f8", (), "kg", "", "nominal mass of the chaser"),
    Field("inertia_kgm2", "f8", (3, 3), "kg m^2", "c", "nominal inertia of the chaser"),
    Field("n_thrusters", "i8", (), "1", "", "number of thrusters; the other places are zero"),
    Field("thruster_position_m", "f8", (MAX_THRUSTERS, 3), "m", "c", "position of each thruster"),
    Field("thruster_force_N", "f8", (MAX_THRUSTERS, 3), "N", "c", "force on the chaser while open"),
    Field("minimum_on_s", "f8", (), "s", "", "shortest burn"),
    Field("acceleration_mps2", "f8", 3, "m/s^2", "c", "of a force demand along each axis, without boost"),
    Field("angular_acceleration_radps2", "f8", 3, "rad/s^2", "c", "of a torque demand about each axis"),
    Field("start_r_CT_H_m", "f8", 3, "m", "H", "position at the start"),
    Field("start_q_CH", "f8", 4, "1", "H to c", "attitude at the start"),
    Field("ready_point_m", "f8", 3, "m", "H", "where the chaser waits for docking"),
    Field("closing_rate_max_mps", "f8", (), "m/s", "", "largest closing rate"),
    *GNC_ORBIT_FIELDS,
)
GNC_SETUP: Final = record_dtype(GNC_SETUP_FIELDS)
"""Nominal vehicle and plan, known to a GNC before the run; the dispersed vehicle is not."""
GNC_SETUP_2: Final = record_dtype(GNC_SETUP_FIELDS[: -len(GNC_ORBIT_FIELDS)])
"""The mailbox gnc.setup: one with the orbit would not fit into an Ethernet frame."""

GNC_POSE_FIELDS: Final = (
    Field("t_s", "f8", (), "s", "", "moment of exposure, time of the run"),
    Field("r_TC_C_m", "f8", 3, "m", "c", "target's reference point seen from the chaser's"),
    Field("q_CH", "f8", 4, "1", "H to c", "measured attitude"),
    Field("covariance_position_m2", "f8", (3, 3), "m^2", "c", "covariance of r_TC_C_m"),
    Field("covariance_attitude_rad2", "f8", (3, 3), "rad^2", "c", "covariance of the small-angle rotation of c"),
)
GNC_POSE: Final = record_dtype(GNC_POSE_FIELDS)

GNC_INPUT_FIELDS: Final = (
    Field(
        "cycle",
        "i8",
        (),
        "1",
        "",
        "RUNNING: counts from 0, the output has the same number; else the last one, initially -1",
    ),
    Field("t_s", "f8", (), "s", "", "time of the run"),
    Field("mode", "i4", (), "1", "", "hil_gnc_mode"),
    Field("orders", "i4", (), "1", "", "hil_gnc_order"),
    Field("rate_radps", "f8", 3, "rad/s", "c", "gyro, mean over the last step, against inertial space"),
    Field("force_mps2", "f8", 3, "m/s^2", "c", "accelerometer, mean over the last step"),
    Field("reference_r_CT_H_m", "f8", 3, "m", "H", "the scenario's plan at t_s; its use is optional"),
    Field("reference_v_CT_H_mps", "f8", 3, "m/s", "H", "velocity of the plan"),
    Field("reference_a_CT_H_mps2", "f8", 3, "m/s^2", "H", "acceleration of the plan"),
    Field("reference_q_CH", "f8", 4, "1", "H to c", "attitude of the plan"),
    Field("boost", "i8", (), "1", "", "1: force demands open the high-thrust sets, as the brake of an abort needs"),
    Field("n_poses", "i8", (), "1", "", "number of poses since the last input"),
    Field("poses", GNC_POSE_FIELDS, MAX_POSES, "", "", "the first n_poses are valid"),
)
GNC_INPUT: Final = record_dtype(GNC_INPUT_FIELDS)

GNC_OUTPUT_FIELDS: Final = (
    Field("cycle", "i8", (), "1", "", "of the input that this answers"),
    Field("state", "i4", (), "1", "", "hil_gnc_state"),
    Field("direct", "i4", (), "1", "", "1: on opens thrusters; 0: the bench allocates force and torque"),
    Field("force", "i4", 3, "1", "c", "demand along each axis: -1, 0 or 1"),
    Field("torque", "i4", 3, "1", "c", "demand about each axis: -1, 0 or 1"),
    Field("on", "u1", MAX_THRUSTERS, "1", "", "thrusters, 0 or 1"),
    Field("estimate", "i8", (), "1", "", "1: the next four fields hold an estimate, which is recorded and monitored"),
    Field("r_CT_H_m", "f8", 3, "m", "H", "estimated position"),
    Field("v_CT_H_mps", "f8", 3, "m/s", "H", "estimated velocity"),
    Field("q_CH", "f8", 4, "1", "H to c", "estimated attitude"),
    Field("w_CH_C_radps", "f8", 3, "rad/s", "c", "estimated rate against H"),
    Field("text", "S64", (), "", "", "message for the operator; empty for none"),
    Field("protection_level_m", "f8", 3, "m", "H", "bound on the error of r_CT_H_m, per axis; 0 or nan: not reported"),
    Field("protection_level_rad", "f8", (), "rad", "", "bound on the attitude error; 0 or nan: not reported"),
    Field("health", "i8", (), "1", "", "0 healthy; sum of hil_gnc_health"),
)
GNC_OUTPUT: Final = record_dtype(GNC_OUTPUT_FIELDS)
