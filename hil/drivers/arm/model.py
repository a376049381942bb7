"""Model of a robot, which its driver's package gives, and the six axes of a bench that the robot stands for."""

from __future__ import annotations

from importlib import import_module
from typing import NamedTuple, Protocol

import numpy as np

from hil.config.rig import Rig
from hil.core.messages import Array
from hil.maths import euler, quat


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
    """Kinematics and limits of a robot. r_L (3,), m, and a_CL (3, 3): turntable's centre in L, and from L to c."""

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
    """Conversions of a rig with a robot. axes: (6,), rails x, y, z in m, roll, pitch, yaw in rad."""

    def __init__(self, rig: Rig) -> None:
        assert rig.arm is not None
        module, _, name = rig.arm.entry.model.partition(":")
        self.model: RobotModel = getattr(import_module(module), name)(rig.arm)
        self._order = np.array(["xyz".index(letter) for letter in rig.bench.gimbal_order])

    def flange(self, axes: Array) -> tuple[Array, Array]:
        """Return position and axes of the flange."""
        return self.model.flange_of(axes[:3], quat.to_matrix(euler.to_quaternion(axes[3:], self._order)))

    def target(self, axes: Array, t_s: float, near: Array | None) -> FlangePose:
        """Return the flange with its joints. near: joints before. Raises Unreachable."""
        position, orientation = self.flange(axes)
        return FlangePose(t_s, position, orientation, self.model.joints_of(position, orientation, near))

    def axes_of(self, flange: FlangePose, near: Array) -> Array:
        """Return the six axes of a flange; whole turns of the angles as ``near`` (6,) has them."""
        r_L, a_CL = self.model.pose_of(flange.position_m, flange.axes)
        angles = np.empty(3)
        euler.from_matrix_into(a_CL, self._order, angles)
        return np.concatenate([r_L, angles + 2.0 * np.pi * np.round((near[3:] - angles) / (2.0 * np.pi))])
