"""What passes between the bench and a GNC that is not in its process, or not ours: three records and their meaning.

The same bytes travel as cells of the reflective memory and as the structs of a shared library: aligned as a C
compiler for x86-64 or ARM64 aligns them, little-endian. Frames: H is Hill's (LVLH) frame of the target, c the
chaser's body; quaternions have the scalar last and ``q_CH`` turns components in H into components in c
(``docs/frames.md``). The bench says ``GNC_SETUP`` once, ``GNC_INPUT`` each cycle, and hears ``GNC_OUTPUT``.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag
from typing import Final

import numpy as np

from hil.core.messages import MAX_POSES, MAX_THRUSTERS

PROTOCOL: Final = 1
"""Goes up when one of the records gets another layout or another meaning."""
REASON_BYTES: Final = 128
"""Room for the reason of a library that refuses a scenario, with its closing zero."""


class GncMode(IntEnum):
    """What the bench is doing; a GNC opens thrusters in RUNNING alone."""

    STANDBY = 0  # the setup stands, nothing is measured yet
    ARMED = 1  # the bench stands at the start pose; time has not begun
    RUNNING = 2  # time runs; each input wants an output
    HOLD = 3  # the axes are braked and time stands; inputs say so, the GNC keeps its state
    STOPPED = 4  # the run is over


class GncOrder(IntFlag):
    """What has been decided, each in one input alone."""

    NONE = 0
    GO = 1  # the operator lets the approach go on from its wait
    ABORT = 2  # an abort has begun, ordered or by supervision: the reference brakes and retreats from here on


class GncState(IntEnum):
    """What the GNC says of itself."""

    STARTING = 0  # has not answered a RUNNING input yet; its demands do not count
    WORKING = 1
    ASKS_FOR_HOLD = 2  # the bench is to be brought to a stand, the run can go on
    FAULT = 3  # the bench is to stop; text says why


GNC_SETUP: Final = np.dtype(
    [
        ("scenario", "S32"),  # its name
        ("step_s", "f8"),  # of a cycle
        ("duration_s", "f8"),
        ("mean_motion_radps", "f8"),  # of the target's orbit: Hill's equations
        ("mass_kg", "f8"),
        ("inertia_kgm2", "f8", (3, 3)),  # in c
        ("n_thrusters", "i8"),
        ("thruster_position_m", "f8", (MAX_THRUSTERS, 3)),  # in c
        ("thruster_force_N", "f8", (MAX_THRUSTERS, 3)),  # on the chaser while open, in c
        ("minimum_on_s", "f8"),
        ("acceleration_mps2", "f8", 3),  # of a force demand along each axis of c, without boost
        ("angular_acceleration_radps2", "f8", 3),  # of a torque demand about each axis of c
        ("start_r_CT_H_m", "f8", 3),
        ("start_q_CH", "f8", 4),
        ("ready_point_m", "f8", 3),  # in H: where the chaser is to wait for docking
        ("closing_rate_max_mps", "f8"),
    ],
    align=True,
)
"""What a GNC may know before the run: the nominal vehicle and plan, not how chance has built it."""

GNC_POSE: Final = np.dtype(
    [
        ("t_s", "f8"),  # moment of exposure, time of the run
        ("r_TC_C_m", "f8", 3),  # target's reference point seen from the chaser's, in c
        ("q_CH", "f8", 4),
        ("covariance_position_m2", "f8", (3, 3)),  # in c
        ("covariance_attitude_rad2", "f8", (3, 3)),  # of the small turn of c, in c
    ],
    align=True,
)

GNC_INPUT: Final = np.dtype(
    [
        ("cycle", "i8"),  # RUNNING: counts from 0, the output carries the same number; else the last one, at first -1
        ("t_s", "f8"),  # time of the run
        ("mode", "i4"),  # hil_gnc_mode
        ("orders", "i4"),  # hil_gnc_order
        ("rate_radps", "f8", 3),  # gyro, mean over the last step, in c, against inertial space
        ("force_mps2", "f8", 3),  # accelerometer, mean over the last step, in c
        ("reference_r_CT_H_m", "f8", 3),  # the scenario's own plan at t_s: to be followed, or left alone
        ("reference_v_CT_H_mps", "f8", 3),
        ("reference_a_CT_H_mps2", "f8", 3),
        ("reference_q_CH", "f8", 4),
        (
            "boost",
            "i8",
        ),  # 1: force demands open strong thruster sets and accelerate more, as the brake of an abort needs
        ("n_poses", "i8"),  # that came since the last input
        ("poses", GNC_POSE, MAX_POSES),
    ],
    align=True,
)

GNC_OUTPUT: Final = np.dtype(
    [
        ("cycle", "i8"),  # of the input that this answers
        ("state", "i4"),  # hil_gnc_state
        ("direct", "i4"),  # 1: on opens thrusters; 0: force and torque are allocated by the bench
        ("force", "i4", 3),  # -1, 0 or 1: demand along each axis of c
        ("torque", "i4", 3),  # the same about each axis
        ("on", "u1", MAX_THRUSTERS),  # 0 or 1 a thruster
        ("estimate", "i8"),  # 1: the fields below hold an estimate, which is recorded and supervised
        ("r_CT_H_m", "f8", 3),
        ("v_CT_H_mps", "f8", 3),
        ("q_CH", "f8", 4),
        ("w_CH_C_radps", "f8", 3),
        ("text", "S64"),  # a word for the operator; "" for none
    ],
    align=True,
)
