"""Robots of a mock rig: axes in memory, with the robots' own limits in each cycle."""

from __future__ import annotations

import numpy as np

from hil.config.rig import AxisGroupTable, Rig
from hil.core.messages import Array
from hil.drivers.arm.model import ArmKinematics, ArmPath, JoinedSetpoints, Unreachable
from hil.drivers.mock_axes import MockAxes
from hil.errors import DeviceError


class _MockRobot:
    """Limits of the robot ``name``, whose axes are those of ``groups``."""

    def __init__(self, rig: Rig, name: str) -> None:
        kinematics, self._name = ArmKinematics(rig, name), name
        parts = kinematics.parts
        self._path = ArmPath(kinematics, np.array([axis.limits[3] for part in parts.values() for axis in part.axes]))
        self._own = {
            key: [rig.axis_groups[key].axis_names.index(a) for a in part.axis_names] for key, part in parts.items()
        }
        self.groups: dict[str, MockAxes] = {}
        self.restart()

    def restart(self) -> None:
        """Begin at the next setpoints."""
        self._begun, self._setpoints = False, JoinedSetpoints(self._own)

    def take(self, group: str, position: Array, rate: Array, now_s: float) -> None:
        """Take the setpoint of a group; with that of the last one check the pose, and fail all if it is not allowed."""
        own = self._own[group]
        if (joined := self._setpoints.joined(group, position[own], rate[own], now_s)) is None:
            return
        axes, rates = joined
        try:
            if not self._begun:
                self._path.begin(axes, now_s)
                self._begun = True
            self._path.go_on(axes, rates, now_s)
        except Unreachable as refused:
            for each in self.groups.values():
                each.fail(DeviceError(self._name, str(refused)))


class _MockArmAxes(MockAxes):
    """A group of axes in memory that a robot stands for; those of its robot fail together."""

    robot: _MockRobot

    def open(self, now_s: float) -> None:
        """Hold the present position."""
        self.robot.restart()
        super().open(now_s)

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the setpoint at ``now_s``; what the robot does not allow is raised by the next call."""
        accepted = super().send(position, rate, now_s)
        self.robot.take(self.name, accepted, rate, now_s)
        return accepted


class MockRobots:
    """Makes the axes of a mock rig with robots."""

    def __init__(self, rig: Rig) -> None:
        self._robots: dict[str, _MockRobot] = {}
        for name in rig.robots:
            self._robots |= dict.fromkeys(rig.robot_axes(name), _MockRobot(rig, name))

    def axes(self, name: str, config: AxisGroupTable, servo: np.record | None = None) -> MockAxes:
        """Return the axes of the group ``name``; see ``MockAxes``."""
        if name not in self._robots:
            return MockAxes(name, config, servo)
        made = _MockArmAxes(name, config, servo)
        made.robot = self._robots[name]
        made.robot.groups[name] = made
        return made
