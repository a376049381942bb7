"""Driver of a robot: up to six axes, exchanged together at the robot's own rate, as groups of axes of a bench.

The robot owns its clock: its link answers each cycle with the pose that is due then, within the span of the last two
setpoints. A stop brakes all axes along their path and holds; the torque is the vendor's safety controller's.
"""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np

from hil.config.rig import AxisGroupTable, Rig
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback
from hil.core.plug_ins import call
from hil.drivers.arm.model import ArmKinematics, ArmPath, FlangePose, JoinedSetpoints, Unreachable, braking
from hil.drivers.axes import SetpointLimits
from hil.drivers.base import AxisGroup
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.errors import DeviceError, ProtocolError

HOLD, END = 2, 1
"""Categories of a stop: the robot holds under the correction; the correction has ended."""
_PERIOD_S: Final = 0.02  # of the setpoints, unless ``set_period``
_LATE: Final = 0.5  # periods for which a missing setpoint is bridged at its rate, before the axes brake
_FROZEN: Final = np.repeat((1e-3, math.radians(0.1)), 3)  # m, rad that may be commanded while the feedback stays,
_FROZEN_S: Final = 0.05  # for so long: a fast robot has gone further when a few answers were late


class PoseLink(Protocol):
    """Link to a robot that takes a pose of its flange in each of its cycles. Errors are DeviceErrors."""

    def open(self) -> FlangePose:
        """Wait for the robot's first cycle; return where it is."""

    def exchange(self, target: FlangePose) -> FlangePose | None:
        """Answer the robot's last cycle with ``target``; return its next one, None for a damaged or repeated one."""

    def due_s(self) -> float:
        """Return the bench time of the robot's last cycle, by its own clock."""

    def stop(self, category: int) -> None:
        """Do what the robot needs for a stop, HOLD or END; with END nothing is answered until the next ``open``."""

    def close(self) -> None:
        """Close the wire. Idempotent."""

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``; ``exchanges`` is one of them."""


class RobotAxes(AxisGroupTable):
    """Axes of one robot as those of one device."""

    all_names = ("x", "y", "z", "roll", "pitch", "yaw")
    device = "arm"


def robot_axes(rig: Rig, name: str) -> RobotAxes:
    """Return the table of the axes that the robot ``name`` stands for, of all groups."""
    parts, timeout_s = [*rig.robot_axes(name).values()], rig.robots[name].timeout_s
    axes = {axis: getattr(part, axis) for part in parts for axis in part.axis_names}
    table = RobotAxes.model_construct(driver="arm", timeout_s=timeout_s, servo=parts[0].servo, **axes)
    table._part = tuple(axes)
    return table


class ArmExchange:
    """A PoseLink as the link of n axes, with the robot's own limits in each cycle."""

    has_profiles = False
    jogging = False

    def __init__(self, kinematics: ArmKinematics, link: PoseLink, acceleration_max: Array) -> None:
        self._kinematics, self._link, self._path = kinematics, link, ArmPath(kinematics, acceleration_max)
        self._acceleration_max, self._name = acceleration_max, kinematics.name
        self._rest, self._frozen = np.zeros(len(acceleration_max)), _FROZEN[kinematics.numbers]
        self.error: DeviceError | None = None
        """Refusal of a setpoint; the robot then brakes and holds."""

    def open(self) -> AxisFeedback:
        """Connect; return the present axes."""
        self._ramp: tuple[Array, Array, float] | None = None  # where and how fast braking began, and when
        self._ending = self._ended = False
        self.error = None
        flange = call(self._name, self._link.open)
        axes = self._kinematics.axes_of(flange, self._rest)
        try:
            self._path.begin(axes, flange.t_s, flange.joints_rad)
        except Unreachable as error:
            raise DeviceError(self._name, f"stands where it may not be commanded: {error}") from error
        self._measured = self._unchanged = axes
        self._measured_s = self._unchanged_s = flange.t_s
        return AxisFeedback(flange.t_s, axes, self._rest)

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Answer the robot with the setpoint, or with the ramp of a stop; return its next feedback."""
        due_s = self._link.due_s()
        if self._ramp is not None:
            position, rate = braking(*self._ramp[:2], due_s - self._ramp[2], self._acceleration_max)
            if self._ending and not self._ended and not rate.any():
                self._ended = True
                self._link.stop(END)
        try:
            self._path.go_on(position, rate, due_s, brakes=self._ramp is not None)
        except Unreachable as refused:
            self.error = self.error or DeviceError(self._name, str(refused))
            self._brake(due_s)
        flange = call(self._name, self._link.exchange, self._path.flange)
        return None if flange is None else self._feedback(flange)

    @property
    def delivered(self) -> tuple[float, Array, Array]:
        """Bench time, axes (n,) and their rates of the last pose."""
        return self._path.delivered

    def _brake(self, now_s: float) -> None:
        if self._ramp is None:
            self._ramp = *self.delivered[1:], now_s

    def _feedback(self, flange: FlangePose) -> AxisFeedback:
        axes = self._kinematics.axes_of(flange, self.delivered[1])
        if not np.array_equal(axes, self._measured):
            self._unchanged, self._unchanged_s = self.delivered[1], flange.t_s
        elif (
            flange.t_s - self._unchanged_s > _FROZEN_S
            and (np.abs(self.delivered[1] - self._unchanged) > self._frozen).any()
        ):
            raise ProtocolError(self._name, "repeats its last pose while it is commanded to move")
        elapsed_s = flange.t_s - self._measured_s
        rate = (axes - self._measured) / elapsed_s if elapsed_s > 0.0 else self._rest
        self._measured, self._measured_s = axes, flange.t_s
        return AxisFeedback(flange.t_s, axes, rate)

    def home(self) -> None:
        """Nothing to do: the joints have absolute encoders."""

    def move_to(self, position: Array, rate: Array) -> None:
        """Never called: the axes are moved by setpoints."""

    def quick_stop(self) -> None:
        """Brake all axes along their path, then hold."""
        self._brake(self.delivered[0])
        self._link.stop(HOLD)

    def disable(self) -> None:
        """Let the correction end as soon as the axes are at rest."""
        self._ending = True

    def close(self) -> None:
        self._link.close()

    def counters(self) -> dict[str, int]:
        """Return the counters of the link."""
        return self._link.counters()


class ArmAxes(CyclicAxisGroup):
    """The axes of the robot ``name``, exchanged with it in each of its cycles."""

    _link: ArmExchange

    def __init__(self, rig: Rig, clock: BenchClock, link: PoseLink, name: str) -> None:
        table = robot_axes(rig, name)
        self._acceleration_max = np.array([axis.limits[3] for axis in table.axes])
        super().__init__(table, clock, ArmExchange(ArmKinematics(rig, name), link, self._acceleration_max), name)
        self._robot = link
        self._period_s = _PERIOD_S
        self._span: tuple[Array, Array, float] | None = None
        self.opened: set[str] = set()
        self.setpoints = JoinedSetpoints(rig.robot_axes(name))

    def set_period(self, period_s: float) -> None:
        """Expect a setpoint every ``period_s``."""
        self._period_s = period_s

    @property
    def jogging(self) -> bool:
        """Whether setpoints are not limited to the travel."""
        return self._jogging

    def set_part_limits(self, axes: slice, rate: Array, acceleration: Array) -> None:
        """Set the limits within which the ``axes`` catch up after a gap."""
        for limiter, *limits in zip(self._limiters[axes], rate.tolist(), acceleration.tolist(), strict=True):
            limiter.set_limits(*limits)

    def open(self, now_s: float) -> None:
        """Connect and hold the present pose. Raises DeviceError."""
        self._span = None
        super().open(now_s)

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the axes at the end of the period that begins ``now_s``; return the accepted ones."""
        before = self._setpoint
        accepted = super().send(position, rate, now_s)
        if self._setpoint is not before:
            follows = 0.0 < now_s - before[2] < 1.5 * self._period_s
            self._span = before if follows else None
        return accepted

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback. Raises DeviceError, also for a refused setpoint, LinkTimeout."""
        if self._link.error is not None and not self._stopping.is_set():
            raise self._link.error
        return super().read(now_s)

    def _due_s(self) -> float:
        return self._robot.due_s()

    def _wait(self, until_s: float) -> bool:
        """Return at once: the exchange waits for the robot."""
        return False

    def _limited(self, position: Array, rate: Array, sent_s: float, now_s: float) -> tuple[Array, Array]:
        """Return what to deliver now: after a gap the axes catch up from what was delivered last."""
        last_s, *last = self._link.delivered
        axes = zip(self._limiters, position.tolist(), rate.tolist(), *(each.tolist() for each in last), strict=True)
        limited = np.array([limiter.next(p, v, sent_s, now_s, (last_s, q, u)) for limiter, p, v, q, u in axes])
        return limited[:, 0], limited[:, 1]

    def _next_setpoint(self, now_s: float) -> tuple[Array, Array]:
        """Return position and rate due at ``now_s``: within the span of the last two setpoints, or braking after it."""
        (b, v, sent_s), span, h = self._setpoint, self._span, self._period_s
        s = (now_s - sent_s) / h
        if s > 1.0 + _LATE:
            position, rate = braking(b + _LATE * h * v, v, (s - 1.0 - _LATE) * h, self._acceleration_max)
        elif s >= 1.0 or span is None:
            position, rate = b + (s - 1.0) * h * v, v
        else:  # cubic Hermite interpolation
            a, u, s = span[0], span[1], max(0.0, s)
            position = a + (3.0 - 2.0 * s) * s * s * (b - a) + h * s * (1.0 - s) * ((1.0 - s) * u - s * v)
            rate = 6.0 * s * (1.0 - s) * (b - a) / h + (1.0 - s) * (1.0 - 3.0 * s) * u + s * (3.0 * s - 2.0) * v
        return self._limited(position, rate, sent_s, now_s)


class ArmPart:
    """AxisGroup of those axes of a robot, from ``first`` on, that stand for one group; open while one of them is."""

    def __init__(self, axes: ArmAxes, name: str, table: AxisGroupTable, first: int) -> None:
        self.name = name
        self._limits = SetpointLimits(name, table)
        self.axis_names = self._limits.names
        self._axes, self._of = axes, slice(first, first + len(self.axis_names))

    def open(self, now_s: float) -> None:
        """Connect to the robot, unless another part has done so. Raises DeviceError."""
        if self.name in self._axes.opened or not self._axes.opened:
            self._axes.opened.clear()
            self._axes.open(now_s)
        self._axes.setpoints.forget(self.name)
        self._axes.opened.add(self.name)

    def home(self, now_s: float) -> None:
        """Nothing to do: the joints have absolute encoders."""

    def set_jogging(self, on: bool) -> None:
        """While on, do not limit setpoints to the travel."""
        self._axes.set_jogging(on)

    def set_period(self, period_s: float) -> None:
        """Expect a setpoint every ``period_s``."""
        self._axes.set_period(period_s)

    def set_limits(self, rate: Array, acceleration: Array) -> None:
        """Set the limits (n,) within which the axes catch up after a gap."""
        self._axes.set_part_limits(self._of, rate, acceleration)

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the axes of this part; they go to the robot with those of the other parts of the same time."""
        accepted, accepted_rate = self._limits.accepted(position, rate, self._axes.jogging)
        joined = self._axes.setpoints.joined(self.name, accepted, accepted_rate, now_s)
        return accepted if joined is None else np.array(self._axes.send(*joined, now_s)[self._of])

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback of these axes. Raises LinkTimeout, DeviceError."""
        of_all = self._axes.read(now_s)
        own = self._of
        return AxisFeedback(of_all.t_s, of_all.position[own], of_all.rate[own], of_all.homing[own])

    def counters(self) -> dict[str, int]:
        """Return the counters of the link; those of the device are the rails'."""
        return self._axes.counters()

    def stop(self, now_s: float) -> None:
        """Brake all axes of the robot along their path and hold."""
        self._axes.stop(now_s)

    def disable(self, now_s: float) -> None:
        """End the correction; the controller then holds by itself."""
        self._axes.disable(now_s)

    def close(self) -> None:
        """Close the device with its last part."""
        self._axes.opened.discard(self.name)
        if not self._axes.opened:
            self._axes.close()


def make_arms(rig: Rig, clock: BenchClock) -> dict[str, AxisGroup]:
    """Return the axes of the robots of ``rig``, by the groups that they stand for."""
    made: dict[str, AxisGroup] = {}
    for name, robot in rig.robots.items():
        axes, first = ArmAxes(rig, clock, robot.make_driver(clock, name), name), 0
        for group, table in rig.robot_axes(name).items():
            made[group] = ArmPart(axes, group, table, first)
            first += len(table.axis_names)
    return made
