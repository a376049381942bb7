"""Error state of the navigation: blocks of errors, of which one covariance holds all.

A block declares its states, how they move in a step, and whether an update corrects them (estimated) or only takes
them into account (considered: Schmidt 1966). The blocks of the position filter (PKF) and of the attitude filter (AKF)
are always there; the others are those of the sensors' errors for which a scenario gives a size
(docs/explanation/error-budget.md). A block that is left out has no states: the covariance is as large as it must be.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

import numpy as np

from hil.core.sensor_records import ERROR_STATES_MAX
from hil.gnc.estimation.akf import AKF_STATE
from hil.gnc.estimation.pkf import PKF_STATE


class BlockMotion(Enum):
    """How the states of a block move in a step."""

    FILTER = "by the equations of its filter"
    CONSTANT = "constant"
    MARKOV = "first-order Gauss-Markov process"
    EULER = "by Euler's equations of a free body"


@dataclass(frozen=True, slots=True)
class Block:
    """A part of the error state. states: name, number and unit of each group; frames as in the names."""

    name: str
    states: tuple[tuple[str, int, str], ...]
    motion: BlockMotion
    estimated: bool

    @property
    def size(self) -> int:
        """Number of states."""
        return sum(number for _, number, _ in self.states)


def _block(name: str, number: int, unit: str, motion: BlockMotion, estimated: bool) -> Block:
    return Block(name, ((name, number, unit),), motion, estimated)


PKF: Final = Block("pkf", (("r_CT_H", 3, "m"), ("v_CT_H", 3, "m/s"), ("bias_C", 3, "m/s^2")), BlockMotion.FILTER, True)
AKF: Final = Block("akf", (("rotation_C", 3, "rad"), ("drift_C", 3, "rad/s")), BlockMotion.FILTER, True)

PARAMETER_BLOCKS: Final = (
    _block("misalignment", 3, "rad", BlockMotion.CONSTANT, True),  # of the cameras, about c's axes
    _block("bias", 3, "m", BlockMotion.CONSTANT, True),  # of a pose, in c
    _block("scale", 1, "1", BlockMotion.CONSTANT, True),  # of the distance
    _block("correlated", 6, "1", BlockMotion.MARKOV, True),  # noise of position and rotation, of unit variance
    _block("sensor_errors", ERROR_STATES_MAX, "as of the sensor", BlockMotion.MARKOV, True),  # as many as are declared
    _block("target_rate", 3, "rad/s", BlockMotion.EULER, True),  # rate of a tumbling target, in H
    _block("target_moments", 3, "1", BlockMotion.CONSTANT, True),  # logarithms of its principal moments
    _block("disturbance", 3, "m/s^2", BlockMotion.CONSTANT, True),  # of the specific force apart from the thrust, in c
    _block("thrust_scale", 1, "1", BlockMotion.CONSTANT, True),  # scale error of a commanded thrust
    _block("gyro_scale", 3, "1", BlockMotion.CONSTANT, False),
    _block("gyro_misalignment", 3, "rad", BlockMotion.CONSTANT, False),
    _block("gyro_instability", 3, "rad/s", BlockMotion.MARKOV, True),
    _block("accelerometer_scale", 3, "1", BlockMotion.CONSTANT, False),
    _block("accelerometer_misalignment", 3, "rad", BlockMotion.CONSTANT, False),
    _block("accelerometer_instability", 3, "m/s^2", BlockMotion.MARKOV, True),
)
"""Blocks that a scenario may add, in the order of their states."""

R, V, BIAS, ROTATION, DRIFT = 0, 3, 6, 9, 12
"""Indices of the states of PKF and AKF."""
FILTER_ERRORS = 15
"""States of PKF and AKF together."""
ERRORS_MAX: Final = 64
"""States of a scenario; one with more of the blocks is rejected."""
LANES: Final = -8 * (-ERRORS_MAX // 8)
"""Length of a row of the covariance: whole vector registers. Entries beyond the states are zero."""

ERROR_STATE = np.dtype(
    [
        ("n", "i8"),  # states
        ("lanes", "i8"),  # the same, rounded up to whole vector registers
        *((block.name, "i8") for block in PARAMETER_BLOCKS),  # index of the first state of each, 0: it is left out
        ("imu", "i8"),  # index of the first state that acts on the motion: disturbance, thrust, IMU; n: there is none
        ("moves", "i8"),  # 1: a Gauss-Markov process is among the states
        ("variance", "f8", LANES),  # variance of the parameters
        ("kept", "f8", LANES),  # part of each that is left after a step, 1 of a constant
        ("estimated", "i8", LANES),
        ("target_walk", "f8"),  # (rad/s)^2 in a step, variance of the target rate's random walk
        ("fraction", "f8"),  # correlated fraction of the noise's variance
        ("bench_variance", "f8", 2),  # m^2, rad^2: part of a pose's covariance that is the bench's, all correlated
        ("noise_variance", "f8"),  # of the logarithm of true over reported variance, 0: the reported one is true
        ("noise_window", "f8"),  # poses
        ("camera_position", "f8", 3),  # m, in c
        ("ring_position", "f8", 3),  # m, in H
    ],
    align=True,
)

STEP_INPUT = np.dtype(
    [
        ("force", "f8", 3),  # m/s^2, specific force in c
        ("rate", "f8", 3),  # rad/s, in c
        ("measured", "i8"),  # 1: the force is that of the accelerometer
        ("variance", "f8"),  # (m/s^2)^2, of the force's noise
    ],
    align=True,
)
"""What the filters are carried by over a step."""

FILTERS = np.dtype(
    [
        ("input", STEP_INPUT),
        ("akf", AKF_STATE),
        ("pkf", PKF_STATE),
        ("parameters", "f8", LANES),  # estimates of the added states, from FILTER_ERRORS on
        ("moments", "f8", 3),  # kg m^2, of a target that tumbles, of the logarithms that follow; 0: not computed yet
        ("moments_of", "f8", 3),
        ("p", "f8", (ERRORS_MAX, LANES)),  # covariance of all errors, in both triangles
    ],
    align=True,
)
"""Estimates of all blocks and the covariance of their errors."""

NOISE_FACTOR = np.dtype([("log", "f8", 2), ("information", "f8", 2)], align=True)
"""Logarithm of true over reported variance of position and attitude, and the information on it."""

INNOVATION = np.dtype(
    [
        ("value", "f8", 3),
        ("h", "f8", (3, LANES)),  # sensitivity to the errors
        ("cross", "f8", (3, LANES)),  # covariance with the errors
        ("gain", "f8", (3, LANES)),  # transposed
        ("s", "f8", (3, 3)),  # covariance
        ("s_inverse", "f8", (3, 3)),
        ("noise", "f8", (3, 3)),  # white part of s
    ],
    align=True,
)
