"""What passes between the stages of a cycle, one definition each.

Every message is a flat numpy record, so that the compiled kernels, the recording and a console
read the very same bytes. Units and frames stand beside each field (frames: ``docs/frames.md``);
``_H``, ``_c``, ``_v``, ``_t`` name the frame of a vector. Axis triples are x, y, z; angles by axis
are theta1 (roll), theta2 (pitch), theta3 (yaw). Length of thruster arrays: MAX_THRUSTERS, unused
places stay zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

MAX_THRUSTERS = 24
MAX_PHASES = 16
MAX_POSES = 4  # that may arrive in one cycle

TRUTH = np.dtype(
    [
        ("t_s", "f8"),
        ("r_CT_H", "f8", 3),  # m, chaser's reference point relative to the target's
        ("v_CT_H", "f8", 3),  # m/s, as seen in H
        ("q_CH", "f8", 4),  # H to c, scalar last
        ("w_CI_C", "f8", 3),  # rad/s, chaser against inertial space
        ("r_T_I", "f8", 3),  # m, target from the Moon's centre, inertial
        ("v_T_I", "f8", 3),  # m/s, inertial
        ("q_HI", "f8", 4),  # inertial to H
        ("w_HI_H", "f8", 3),  # rad/s, H against inertial space
        ("eta", "f8"),  # m kg^1/2, bending of the solar array
        ("eta_rate", "f8"),  # m kg^1/2 / s
        ("mass_kg", "f8"),
        ("open_s", "f8", MAX_THRUSTERS),  # time for which each valve has been open, 0 closed
        ("mean_rate_C", "f8", 3),  # rad/s, mean of w_CI_C over the last step: what a gyro integrates
        ("mean_force_C", "f8", 3),  # m/s^2, specific force over the last step
        ("thrust_fraction", "f8", MAX_THRUSTERS),  # open part of the last step, 0..1
    ],
    align=True,
)

IMU = np.dtype(
    [
        ("rate_C", "f8", 3),  # rad/s, U_g
        ("force_C", "f8", 3),  # m/s^2, U_a
        ("drift_C", "f8", 3),  # rad/s, true gyro drift (epsilon)
        ("bias_C", "f8", 3),  # m/s^2, true accelerometer bias (d)
    ],
    align=True,
)

POSE = np.dtype(
    [
        ("z_TC_C", "f8", 3),  # m, target's reference point seen from the chaser's
        ("covariance_position", "f8", (3, 3)),  # m^2, in c
        ("q_CH", "f8", 4),
        ("covariance_attitude", "f8", (3, 3)),  # rad^2, of the small turn of c, in c
        ("t_s", "f8"),  # moment of exposure
        ("fresh", "i8"),  # how many poses arrived in this cycle; this is the newest of them
    ],
    align=True,
)

NAVIGATION = np.dtype(
    [
        ("valid", "i8"),
        ("r_CT_H", "f8", 3),
        ("v_CT_H", "f8", 3),
        ("q_CH", "f8", 4),
        ("w_CH_C", "f8", 3),  # rad/s, chaser against H
        ("sigma_r_m", "f8", 3),
        ("sigma_v_mps", "f8", 3),
        ("sigma_attitude_rad", "f8", 3),
        ("nis_position", "f8"),  # normalised innovation squared, nan without an update
        ("nis_attitude", "f8"),
    ],
    align=True,
)

REFERENCE = np.dtype(
    [
        ("r_CT_H", "f8", 3),
        ("v_CT_H", "f8", 3),
        ("a_CT_H", "f8", 3),
        ("q_CH", "f8", 4),
        ("boost", "i8"),  # 1 where force demands are to open the strong thruster sets
        ("phase", "i8"),  # its number in the list; those after the list are brake, retreat, hold of an abort
        ("from_H", "f8", 3),  # m, begin of the phase's line
        ("to_H", "f8", 3),  # m, its end
    ],
    align=True,
)

SUPERVISION = np.dtype(
    [
        ("corridor_margin_m", "f8"),  # of the estimate; negative outside
        ("closing_margin_mps", "f8"),  # allowed minus actual closing rate
        ("broken_cycles", "i8"),  # for which a limit has been broken on end
        ("ready_since_s", "f8"),  # since then the estimate is within Table III; nan when it is not
        ("aborted", "i8"),  # cause, 0 for none
        ("aborted_at_s", "f8"),
    ],
    align=True,
)

COMMAND = np.dtype(
    [
        ("force", "i8", 3),  # -1, 0, 1: demand along each body axis, before allocation
        ("torque", "i8", 3),
        ("on", "i8", MAX_THRUSTERS),  # 0 or 1 a thruster
        ("cycles_left", "i8", 6),  # of the burn under way, signed; force axes, then torque axes
        ("until_decision", "i8", 6),  # cycles
        ("owed", "f8", 6),  # m/s, rad/s: change of rate that the reference asked for and was not fired yet
        ("boost", "i8"),  # 1: force demands open the strong thruster sets, as the reference had it
    ],
    align=True,
)

AXES = np.dtype(
    [
        ("rail_m", "f8", 3),  # carriage along x_L, y_L, z_L
        ("rail_mps", "f8", 3),
        ("gimbal_rad", "f8", 3),  # by axis: roll, pitch, yaw
        ("gimbal_radps", "f8", 3),
    ],
    align=True,
)

CYCLE = np.dtype(
    [
        ("t_s", "f8"),
        ("truth", TRUTH),
        ("imu", IMU),
        ("pose", POSE),
        ("navigation", NAVIGATION),
        ("reference", REFERENCE),
        ("supervision", SUPERVISION),
        ("command", COMMAND),
        ("setpoint", AXES),
        ("feedback", AXES),
        ("sampled_s", "f8", 2),  # when the encoders of rails and turntable had these values, time of the run
        ("received_s", "f8"),  # last byte of the pose's frame; stays as it is in cycles without one
        ("commanded_s", "f8"),  # when the thrusters' command was there
        ("on_wire_s", "f8"),  # when the thrusters' digital lines last changed at the coupler; NaN without lines
        ("lateness_s", "f8"),
        ("nees_position", "f8"),
        ("nees_attitude", "f8"),
    ],
    align=True,
)


def new(dtype: np.dtype) -> np.record:
    """Return one zeroed record of ``dtype`` that owns its memory."""
    record: np.record = np.zeros(1, dtype).view(np.recarray)[0]
    return record


class Homing(IntEnum):
    """What an axis knows of its place. One with an absolute encoder is always at DONE."""

    NEEDED = 0
    UNDER_WAY = 1
    DONE = 2
    FAILED = 3


HOMED: Final = (Homing.DONE, Homing.DONE, Homing.DONE)
"""Of three axes that all know their places."""
NO_LIMIT: Final = (0, 0, 0)
"""Of three axes of which none stands on a limit switch."""


@dataclass(frozen=True, slots=True)
class AxisFeedback:
    """What three axes of one device report: the newest sample, and when it was taken.

    position: shape (3,), m or rad; rate: shape (3,), m/s or rad/s; t_s: bench time of the sample.
    homing: of each axis; only at DONE its position means a place on the bench. limit: limit switch that
    each axis stands on, -1 the low one, 1 the high one, 0 none.
    """

    t_s: float
    position: Array
    rate: Array
    homing: tuple[Homing, Homing, Homing] = HOMED
    limit: tuple[int, int, int] = NO_LIMIT


class IoInputs(NamedTuple):
    """What the digital inputs say: the newest sample, and when it was taken, s of bench time.

    estop_closed: the emergency stop is released. chain_closed: the safety relay lets the drives have
    torque. open_interlocks: names of the interlocks whose contacts are open. thrusters_s: when the coupler
    was given the thrusters' lines as they are, s of bench time; NaN before the first change.
    """

    t_s: float
    estop_closed: bool
    chain_closed: bool
    open_interlocks: tuple[str, ...] = ()
    thrusters_s: float = math.nan


class IoOutputs(NamedTuple):
    """What the digital outputs are to be. enable: asks the safety relay to close. thrusters: a byte a line, 0 or 1."""

    enable: bool
    thrusters: bytes


@dataclass(frozen=True, slots=True)
class PoseFrame:
    """One pose of the vision unit, t to v: ``p_v = A(q_vt) p_t + t_v``.

    counter: frame number of the unit, wraps at 2^32. t_s: bench time of exposure. received_s: bench
    time of the frame's last byte. t_v: ring centre from the left camera, m, shape (3,). q_vt: shape
    (4,), scalar last. covariance: shape (6, 6), m^2, m rad, rad^2, of t_v and of the small rotation e
    about v's axes, ``R_est = exp([e]x) R_true``. leds_left, leds_right: bit n set = LED n was used.
    """

    counter: int
    t_s: float
    received_s: float
    t_v: Array
    q_vt: Array
    covariance: Array
    leds_left: int = 0
    leds_right: int = 0


@dataclass(frozen=True, slots=True)
class Event:
    """Something worth a line in the log: when, who, what."""

    t_s: float
    source: str
    text: str
