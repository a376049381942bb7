"""Records exchanged with models of the plant: thrusters, motion of the chaser, IMU. All fields are 8-byte floats.

H is Hill's frame of the target, c the chaser's body frame; see ``docs/explanation/frames.md``. Each model receives its
setup once and an input per step, and returns an output.
"""

from __future__ import annotations

from typing import Final

from hil.core.fields import Field, Fields, number
from hil.core.messages import MAX_THRUSTERS

_TIME: Final = number("t_s", "s", "start of the step, time of the run")
_STEP: Final = number("step_s", "s", "step")

THRUSTERS_SETUP_FIELDS: Final[Fields] = (
    _STEP,
    number("n_thrusters", "1", "number of thrusters"),
    number("minimum_on_s", "s", "shortest time for which a valve opens"),
)
THRUSTERS_INPUT_FIELDS: Final[Fields] = (
    _TIME,
    Field("on", "f8", MAX_THRUSTERS, "1", "", "command of each thruster, 0 or 1"),
)
THRUSTERS_OUTPUT_FIELDS: Final[Fields] = (
    Field("thrust_fraction", "f8", MAX_THRUSTERS, "1", "", "mean thrust over the step, of that of the open valve"),
)

TRUTH_SETUP_FIELDS: Final[Fields] = (
    _STEP,
    number("orbit_rate_radps", "rad/s", "mean motion of the target"),
    Field("initial_r_CT_H_m", "f8", 3, "m", "H", "initial position of the chaser relative to the target"),
    Field("initial_v_CT_H_mps", "f8", 3, "m/s", "H", "initial velocity"),
    Field("initial_q_CH", "f8", 4, "1", "H to c", "initial attitude, scalar last"),
    Field("initial_w_CI_C_radps", "f8", 3, "rad/s", "c", "initial rate against inertial space"),
    number("initial_mass_kg", "kg", "initial mass"),
    Field("inertia_kgm2", "f8", (3, 3), "kg m^2", "c", "inertia about the centre of mass"),
)
TRUTH_INPUT_FIELDS: Final[Fields] = (
    _TIME,
    Field("thrust_fraction", "f8", MAX_THRUSTERS, "1", "", "mean thrust of each thruster over the step"),
    Field("force_N", "f8", 3, "N", "c", "force of all thrusters"),
    Field("torque_Nm", "f8", 3, "N m", "c", "their torque about the centre of mass"),
)
TRUTH_OUTPUT_FIELDS: Final[Fields] = (
    Field("r_CT_H_m", "f8", 3, "m", "H", "position at the end of the step"),
    Field("v_CT_H_mps", "f8", 3, "m/s", "H", "velocity"),
    Field("q_CH", "f8", 4, "1", "H to c", "attitude, scalar last"),
    Field("w_CI_C_radps", "f8", 3, "rad/s", "c", "rate against inertial space"),
    number("mass_kg", "kg", "mass"),
    Field("mean_rate_C_radps", "f8", 3, "rad/s", "c", "mean rate over the step, for the gyros"),
    Field("mean_force_C_mps2", "f8", 3, "m/s^2", "c", "mean specific force at the reference point over the step"),
)

IMU_SETUP_FIELDS: Final[Fields] = (_STEP,)
IMU_INPUT_FIELDS: Final[Fields] = (
    _TIME,
    Field("mean_rate_C_radps", "f8", 3, "rad/s", "c", "true mean rate over the step"),
    Field("mean_force_C_mps2", "f8", 3, "m/s^2", "c", "true mean specific force over the step"),
    Field("w_CI_C_radps", "f8", 3, "rad/s", "c", "true rate at the end of the step"),
)
IMU_OUTPUT_FIELDS: Final[Fields] = (
    Field("rate_radps", "f8", 3, "rad/s", "c", "measured rate"),
    Field("force_mps2", "f8", 3, "m/s^2", "c", "measured specific force"),
    Field("drift_C_radps", "f8", 3, "rad/s", "c", "true drift of the gyros in this sample"),
    Field("bias_C_mps2", "f8", 3, "m/s^2", "c", "true bias of the accelerometers in this sample"),
)
