"""Messages of EGM: bytes <-> numbers, as in ``egm.proto`` of the controller. No I/O, no clock.

Positions in m, joints in rad; on the wire mm and degrees, attitudes as quaternions with the scalar first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil_abb_egm import wire
from hil_abb_egm.wire import Fields

DATA, CORRECTION = 2, 3
MOTORS_ON, MOTORS_OFF = 1, 2
MCI_ERROR, MCI_STOPPED, MCI_RUNNING = 1, 2, 3
RAPID_STOPPED, RAPID_RUNNING = 1, 2
_MM: Final = 1000.0
_HEADER, _FEEDBACK, _PLANNED = 1, 2, 3
_MOTORS, _MCI, _CONVERGED, _RAPID = 4, 5, 6, 8
_SENSOR_PLANNED: Final = 2


@dataclass(frozen=True)
class Posture:
    """Pose of the flange, position_m (3,) and axes (3, 3) as columns, and joints_rad (6,); what is not sent is None."""

    position_m: Array | None
    axes: Array | None
    joints_rad: Array | None


@dataclass(frozen=True)
class RobotState:
    """What the controller sends in each cycle. tm_ms: its time. states: as the constants of this module."""

    number: int
    tm_ms: int
    feedback: Posture
    planned: Posture
    motors: int
    mci: int
    rapid: int


def encode_state(state: RobotState) -> bytes:
    """Return the message of the controller."""
    header = wire.message([(1, state.number), (2, state.tm_ms), (3, DATA)])
    states = [(_MOTORS, state.motors), (_MCI, state.mci), (_RAPID, state.rapid)]
    return wire.message(
        [
            (_HEADER, header),
            (_FEEDBACK, _posture(state.feedback)),
            (_PLANNED, _posture(state.planned)),
            *((number, wire.message([(1, value)])) for number, value in states[:2]),
            (_CONVERGED, 0),
            *((number, wire.message([(1, value)])) for number, value in states[2:]),
        ]
    )


def decode_state(data: bytes) -> RobotState:
    """Return what a message of the controller says. Raises ValueError."""
    fields = wire.fields_of(data)
    header = wire.inner(fields, _HEADER)
    feedback = _posture_of(wire.inner(fields, _FEEDBACK))
    if header is None or feedback.position_m is None:
        raise ValueError("no header or no pose")
    motors, mci, rapid = (wire.integer(wire.inner(fields, number), 1) for number in (_MOTORS, _MCI, _RAPID))
    planned = _posture_of(wire.inner(fields, _PLANNED))
    return RobotState(wire.integer(header, 1), wire.integer(header, 2), feedback, planned, motors, mci, rapid)


def encode_answer(number: int, tm_ms: int, posture: Posture) -> bytes:
    """Return the answer of this computer, EgmSensor."""
    header = wire.message([(1, number), (2, tm_ms), (3, CORRECTION)])
    return wire.message([(_HEADER, header), (_SENSOR_PLANNED, _posture(posture))])


def decode_answer(data: bytes) -> tuple[int, Posture]:
    """Return the number and the posture of an answer. Raises ValueError."""
    fields = wire.fields_of(data)
    header = wire.inner(fields, _HEADER)
    if header is None or wire.integer(header, 3) != CORRECTION:
        raise ValueError("no correction")
    return wire.integer(header, 1), _posture_of(wire.inner(fields, _SENSOR_PLANNED))


def _posture(posture: Posture) -> bytes:
    fields: list[tuple[int, wire.Value]] = []
    if posture.joints_rad is not None:
        joints = np.degrees(posture.joints_rad).tolist()
        fields.append((1, wire.message([(1, value) for value in joints])))
    if posture.position_m is not None and posture.axes is not None:
        position = wire.message(list(enumerate((_MM * posture.position_m).tolist(), 1)))
        attitude = wire.message(list(enumerate(_quaternion(posture.axes), 1)))
        fields.append((2, wire.message([(1, position), (2, attitude)])))
    return wire.message(fields)


def _posture_of(fields: Fields | None) -> Posture:
    joints, pose = wire.inner(fields or {}, 1), wire.inner(fields or {}, 2)
    joints_rad = None if joints is None else np.radians(_finite(wire.doubles(joints, 1), 6))
    if pose is None:
        return Posture(None, None, joints_rad)
    position, attitude = wire.inner(pose, 1), wire.inner(pose, 2)
    if position is None or attitude is None:
        raise ValueError("a pose without position or attitude")
    r = _finite([value for number in (1, 2, 3) for value in wire.doubles(position, number)], 3)
    u = _finite([value for number in (1, 2, 3, 4) for value in wire.doubles(attitude, number)], 4)
    return Posture(r / _MM, _axes(u), joints_rad)


def _finite(values: list[float], n: int) -> Array:
    numbers = np.array(values)
    if len(values) != n or not np.isfinite(numbers).all():
        raise ValueError(f"{len(values)} numbers or one that is not finite, expected {n}")
    return numbers


def _quaternion(axes: Array) -> list[float]:
    """Return the unit quaternion, scalar first, of a frame with these axes as columns (3, 3)."""
    squares = np.array([1.0 + axes.trace(), *(1.0 + 2.0 * np.diag(axes) - axes.trace())])
    k = int(squares.argmax())
    half = 0.5 * math.sqrt(squares[k])
    off = 0.25 / half
    w = [(axes[2, 1] - axes[1, 2]) * off, (axes[0, 2] - axes[2, 0]) * off, (axes[1, 0] - axes[0, 1]) * off]
    if k == 0:
        return [half, *map(float, w)]
    i = k - 1
    vector = [float((axes[i, j] + axes[j, i]) * off) for j in range(3)]
    vector[i] = half
    return [float(w[i]), *vector]


def _axes(u: Array) -> Array:
    """Return the axes as columns (3, 3) of a quaternion, scalar first. Raises ValueError for one of length 0."""
    length = math.sqrt(float((u * u).sum()))
    if length < 0.5:
        raise ValueError("a quaternion that is not of unit length")
    w, x, y, z = (u / length).tolist()
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
