"""Model of a robot, which its driver's package gives, and the six axes of a bench that the robot stands for."""

from __future__ import annotations

import math
from collections.abc import Iterable
from importlib import import_module
from typing import Final, NamedTuple, Protocol

import numpy as np

from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, AxisGroupTable, Rig
from hil.core.messages import Array
from hil.errors import DeviceError
from hil.maths import euler, quat

_SIX: Final = (*RAIL_NAMES, *GIMBAL_NAMES)
_DEGREES: Final = math.degrees(1.0)
_HELD: Final = np.repeat((5e-3, math.radians(0.5)), 3)  # m and rad that an axis that is held may be off


class Unreachable(ValueError):
    """A pose that the robot cannot take, or may not: the text names the limit."""


class FlangePose(NamedTuple):
    """Pose of the flange in the robot's base frame.

    t_s: bench time, s. position_m: (3,). axes: of the flange as columns, (3, 3). joints_rad: as the controller counts
    them; None if it does not report them.
    """

    t_s: float
    position_m: Array
    axes: Array
    joints_rad: Array | None


class RobotModel(Protocol):
    """Kinematics and limits of a robot. r_L (3,), m, and a_CL (3, 3): turntable's centre in L, and from L to c.

    Of a robot that carries the target: the centre of its rotation, and H in place of c.
    """

    link_radius: float | None
    """Radius of the links, m; None: they are not checked."""

    def flange_of(self, r_L: Array, a_CL: Array) -> tuple[Array, Array]:
        """Return position (3,), m, and axes (3, 3) of the flange."""

    def pose_of(self, r_F: Array, axes: Array) -> tuple[Array, Array]:
        """Return r_L and a_CL of a flange."""

    def joints_of(self, r_F: Array, axes: Array, near: Array | None = None) -> Array:
        """Return the joints, rad, with the whole turns of ``near``. Raises Unreachable."""

    def check_rate(self, before: Array, joints: Array, duration_s: float) -> None:
        """Raise Unreachable if a joint would be too fast between two poses."""

    def links(self, joints: Array) -> dict[str, Array]:
        """Return the ends of each link that the bodies of the lab can meet, (2, 3), m, in L."""


class ArmKinematics:
    """Conversions of the robot ``name`` of a rig. axes: (n,), those of x, y, z in m, roll, pitch, yaw in rad it moves.

    An axis of another controller moves the robot's base: here it is at 0. numbers: of the n axes among the six.
    parts: tables of the axes, by groups.
    """

    def __init__(self, rig: Rig, name: str = "arm") -> None:
        arm, self.name, self.parts = rig.robots[name], name, rig.robot_axes(name)
        module, _, factory = arm.entry.model.partition(":")
        self.model: RobotModel = getattr(import_module(module), factory)(arm)
        self.numbers = np.array([_SIX.index(axis) for part in self.parts.values() for axis in part.axis_names])
        groups: list[AxisGroupTable] = [rig.rails, rig.turntable]
        order, self._six, self._carried = rig.bench.gimbal_order, np.zeros(6), np.zeros(3, bool)
        if name == "target_arm":
            assert rig.rotary_manipulator is not None
            groups, order = [rig.rotary_manipulator], rig.rotary_manipulator.gimbal_order
            self._six[:3] = -np.array(rig.rotary_manipulator.lever_arm_m)
        self._order = np.array(["xyz".index(letter) for letter in order])
        for axis, table in ((axis, getattr(group, axis)) for group in groups for axis in group.axis_names):
            if table.is_fixed:
                self._six[_SIX.index(axis)] = table.si("park")
            elif axis in RAIL_NAMES:
                self._carried[_SIX.index(axis)] = _SIX.index(axis) not in self.numbers

    def base_moved_by(self, six: Array) -> Array:
        """Return the displacement of the base (3,), m, with x, y, z, roll, pitch, yaw of all controllers at ``six``."""
        return np.where(self._carried, six[:3], 0.0)

    def flange(self, axes: Array) -> tuple[Array, Array]:
        """Return position and axes of the flange."""
        six = self._six.copy()
        six[self.numbers] = axes
        return self.model.flange_of(six[:3], quat.to_matrix(euler.to_quaternion(six[3:], self._order)))

    def target(self, axes: Array, t_s: float, near: Array | None) -> FlangePose:
        """Return the flange with its joints. near: joints before. Raises Unreachable."""
        position, orientation = self.flange(axes)
        return FlangePose(t_s, position, orientation, self.model.joints_of(position, orientation, near))

    def axes_of(self, flange: FlangePose, near: Array) -> Array:
        """Return the axes of a flange; whole turns of the angles as ``near`` (n,) has them.

        Raises DeviceError for a flange that is off where the robot holds it.
        """
        r_L, a_CL = self.model.pose_of(flange.position_m, flange.axes)
        six = np.empty(6)
        euler.from_matrix_into(a_CL, self._order, six[3:])
        six[:3] = r_L
        nearest = self._six.copy()
        nearest[self.numbers] = near
        six[3:] += 2.0 * np.pi * np.round((nearest[3:] - six[3:]) / (2.0 * np.pi))
        off = np.abs(six - self._six) / _HELD
        off[self.numbers] = 0.0
        if off.max() > 1.0:
            axis = int(off.argmax())
            scale, unit = (1e3, "mm") if axis < 3 else (_DEGREES, "deg")
            away = scale * (six[axis] - self._six[axis])
            raise DeviceError(self.name, f"is {away:.3g} {unit} off along or about {_SIX[axis]}, which it holds")
        moved: Array = six[self.numbers]
        return moved


def braking(position: Array, rate: Array, t_s: float, acceleration_max: Array) -> tuple[Array, Array]:
    """Return position and rate (n,) ``t_s`` after braking has begun there: all axes in the same, the shortest time."""
    duration_s = float((np.abs(rate) / acceleration_max).max())
    if duration_s <= 0.0:
        return position, rate
    t_s = min(max(0.0, t_s), duration_s)
    left = 1.0 - t_s / duration_s
    return position + 0.5 * t_s * (1.0 + left) * rate, left * rate


class ArmPath:
    """Poses of a robot one after the other, each within its own limits. acceleration_max: (n,), of the axes."""

    def __init__(self, kinematics: ArmKinematics, acceleration_max: Array) -> None:
        self._kinematics, self._acceleration_max = kinematics, acceleration_max

    def begin(self, axes: Array, t_s: float, joints: Array | None = None) -> None:
        """Begin at rest at ``axes`` (n,). joints: of the robot, as far as known. Raises Unreachable."""
        self.flange = self._kinematics.target(axes, t_s, joints)
        self.delivered = t_s, axes, np.zeros(len(axes))

    def go_on(self, position: Array, rate: Array, t_s: float, brakes: bool = False) -> None:
        """Move to ``position`` (n,) at ``rate``; unless it ``brakes``, at a speed and to where the robot can brake.

        Raises Unreachable, and then stays where it is.
        """
        before, kinematics = self.flange.joints_rad, self._kinematics
        flange, elapsed_s = kinematics.target(position, t_s, before), t_s - self.delivered[0]
        if elapsed_s > 0.0 and not brakes:
            assert before is not None
            assert flange.joints_rad is not None
            kinematics.model.check_rate(before, flange.joints_rad, elapsed_s)
            kinematics.target(braking(position, rate, math.inf, self._acceleration_max)[0], t_s, before)
        self.flange, self.delivered = flange, (t_s, position, rate)


class JoinedSetpoints:
    """Setpoints of ``groups``, given one group after the other, that go to their robot together."""

    def __init__(self, groups: Iterable[str]) -> None:
        self._given: dict[str, tuple[Array, Array, float] | None] = dict.fromkeys(groups)

    def forget(self, group: str) -> None:
        """Discard the setpoint of a group that waits for the others."""
        self._given[group] = None

    def joined(self, group: str, position: Array, rate: Array, now_s: float) -> tuple[Array, Array] | None:
        """Take the setpoint of a group; return positions and rates (n,) of all once they are of one time, else None."""
        self._given[group] = position, rate, now_s
        given = [each for each in self._given.values() if each is not None and each[2] == now_s]
        if len(given) < len(self._given):
            return None
        return np.concatenate([each[0] for each in given]), np.concatenate([each[1] for each in given])
