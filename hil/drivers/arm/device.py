"""Driver of a robot: six axes, exchanged together at the robot's own rate, as the rails and the turntable of a bench.

The robot owns its clock: its link answers each cycle with the pose that is due then, within the span of the last two
setpoints. A stop brakes all axes along their path and holds; the torque is the vendor's safety controller's.
"""

from __future__ import annotations

import math
from typing import Final, Protocol

import numpy as np

from hil.config.rig import AxisGroupTable, GimbalAxis, RailAxis, Rig
from hil.core.clock import BenchClock
from hil.core.messages import HOMED, Array, AxisFeedback
from hil.core.plug_ins import call
from hil.drivers.arm.model import ArmKinematics, FlangePose, Unreachable
from hil.drivers.axes import SetpointLimits
from hil.drivers.base import AxisGroup
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.errors import DeviceError, ProtocolError

HOLD, END = 2, 1
"""Categories of a stop: the robot holds under the correction; the correction has ended."""
_PERIOD_S: Final = 0.02  # of the setpoints, unless ``set_period``
_LATE: Final = 0.5  # periods for which a missing setpoint is bridged at its rate, before the axes brake
_FROZEN: Final = (1e-3, math.radians(0.1))  # m and rad that may be commanded while the feedback stays the same
_HOMED: Final = 2 * HOMED


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


class SixAxes(AxisGroupTable):
    """Axes of rails and turntable as those of one device."""

    all_names = ("x", "y", "z", "roll", "pitch", "yaw")
    device = "arm"
    x: RailAxis
    y: RailAxis
    z: RailAxis
    roll: GimbalAxis
    pitch: GimbalAxis
    yaw: GimbalAxis


def six_axes(rig: Rig) -> SixAxes:
    """Return the table of both groups."""
    assert rig.arm is not None
    axes = {name: getattr(table, name) for table in (rig.rails, rig.turntable) for name in table.axis_names}
    return SixAxes.model_construct(driver="arm", timeout_s=rig.arm.timeout_s, servo=rig.rails.servo, **axes)


def braking(position: Array, rate: Array, t_s: float, acceleration_max: Array) -> tuple[Array, Array]:
    """Return position and rate (6,) ``t_s`` after braking has begun there: all axes in the same, the shortest time."""
    duration_s = float((np.abs(rate) / acceleration_max).max())
    if duration_s <= 0.0:
        return position, rate
    t_s = min(max(0.0, t_s), duration_s)
    left = 1.0 - t_s / duration_s
    return position + 0.5 * t_s * (1.0 + left) * rate, left * rate


class ArmExchange:
    """A PoseLink as the link of six axes, with the robot's own limits in each cycle."""

    has_profiles = False
    jogging = False

    def __init__(self, rig: Rig, link: PoseLink, acceleration_max: Array) -> None:
        self._kinematics, self._link, self._acceleration_max = ArmKinematics(rig), link, acceleration_max
        self.error: DeviceError | None = None
        """Refusal of a setpoint; the robot then brakes and holds."""

    def open(self) -> AxisFeedback:
        """Connect; return the present axes."""
        self._ramp: tuple[Array, Array, float] | None = None  # where and how fast braking began, and when
        self._ending = self._ended = False
        self.error = None
        flange = call("arm", self._link.open)
        axes = self._kinematics.axes_of(flange, np.zeros(6))
        self.delivered = flange.t_s, axes, np.zeros(6)
        try:
            self._target = self._kinematics.target(axes, flange.t_s, flange.joints_rad)
        except Unreachable as error:
            raise DeviceError("arm", f"stands where it may not be commanded: {error}") from error
        self._measured = self._unchanged = axes
        self._measured_s = flange.t_s
        return AxisFeedback(flange.t_s, axes, np.zeros(6), _HOMED)

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Answer the robot with the setpoint, or with the ramp of a stop; return its next feedback."""
        due_s = self._link.due_s()
        if self._ramp is not None:
            position, rate = braking(*self._ramp[:2], due_s - self._ramp[2], self._acceleration_max)
            if self._ending and not self._ended and not rate.any():
                self._ended = True
                self._link.stop(END)
        target = self._allowed(position, rate, due_s) or self._target
        if target is not self._target:
            self.delivered, self._target = (due_s, position, rate), target
        flange = call("arm", self._link.exchange, target)
        return None if flange is None else self._feedback(flange)

    def _allowed(self, position: Array, rate: Array, due_s: float) -> FlangePose | None:
        """Return the flange at ``position`` if the robot may go and brake there; begin to brake otherwise."""
        before, model = self._target.joints_rad, self._kinematics
        try:
            target = model.target(position, due_s, before)
            if self._ramp is None and due_s > self.delivered[0]:
                assert before is not None
                assert target.joints_rad is not None
                model.model.check_rate(before, target.joints_rad, due_s - self.delivered[0])
                model.target(braking(position, rate, math.inf, self._acceleration_max)[0], due_s, before)
            return target
        except Unreachable as refused:
            self.error = self.error or DeviceError("arm", str(refused))
            self._brake(due_s)
            return None

    def _brake(self, now_s: float) -> None:
        if self._ramp is None:
            self._ramp = *self.delivered[1:], now_s

    def _feedback(self, flange: FlangePose) -> AxisFeedback:
        axes = self._kinematics.axes_of(flange, self.delivered[1])
        if not np.array_equal(axes, self._measured):
            self._unchanged = self.delivered[1]
        elif np.any(np.abs(self.delivered[1] - self._unchanged) > np.repeat(_FROZEN, 3)):
            raise ProtocolError("arm", "repeats its last pose while it is commanded to move")
        elapsed_s = flange.t_s - self._measured_s
        rate = (axes - self._measured) / elapsed_s if elapsed_s > 0.0 else np.zeros(6)
        self._measured, self._measured_s = axes, flange.t_s
        return AxisFeedback(flange.t_s, axes, rate, _HOMED)

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
        """Close the link. Idempotent."""
        self._link.close()

    def counters(self) -> dict[str, int]:
        """Return the counters of the link."""
        return self._link.counters()


class ArmAxes(CyclicAxisGroup):
    """The six axes, exchanged with the robot in each of its cycles."""

    _link: ArmExchange

    def __init__(self, rig: Rig, clock: BenchClock, link: PoseLink) -> None:
        table = six_axes(rig)
        self._acceleration_max = np.array([axis.limits[3] for axis in table.axes])
        super().__init__(table, clock, ArmExchange(rig, link, self._acceleration_max), "arm")
        self._robot = link
        self._period_s = _PERIOD_S
        self._span: tuple[Array, Array, float] | None = None
        self.opened: set[str] = set()

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
    """AxisGroup of three axes of the robot. The device is open while one of its parts is."""

    def __init__(self, axes: ArmAxes, name: str, table: AxisGroupTable, parts: list[ArmPart]) -> None:
        self.name = name
        self._limits = SetpointLimits(name, table)
        self.axis_names = self._limits.names
        self._axes, self._parts, self._of = axes, parts, slice(3 * len(parts), 3 * len(parts) + 3)
        self.given: tuple[Array, Array, float] | None = None
        """Setpoint that waits for the other part's."""
        parts.append(self)

    def open(self, now_s: float) -> None:
        """Connect to the robot, unless the other part has done so. Raises DeviceError."""
        if self.name in self._axes.opened or not self._axes.opened:
            self._axes.opened.clear()
            self._axes.open(now_s)
        self.given = None
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
        """Set the limits (3,) within which the axes catch up after a gap."""
        self._axes.set_part_limits(self._of, rate, acceleration)

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the axes of this part; they go to the robot with those of the other part of the same time."""
        accepted, accepted_rate = self._limits.accepted(position, rate, self._axes.jogging)
        self.given = accepted, accepted_rate, now_s
        given = [part.given for part in self._parts if part.given is not None and part.given[2] == now_s]
        if len(given) < len(self._parts):
            return accepted
        six = [np.concatenate([each[k] for each in given]) for k in (0, 1)]
        return np.array(self._axes.send(six[0], six[1], now_s)[self._of])

    def read(self, now_s: float) -> AxisFeedback:
        """Return the newest feedback of these axes. Raises LinkTimeout, DeviceError."""
        all_six = self._axes.read(now_s)
        return AxisFeedback(all_six.t_s, all_six.position[self._of], all_six.rate[self._of], HOMED)

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


def make_arm(rig: Rig, clock: BenchClock) -> dict[str, AxisGroup]:
    """Return rails and turntable of the robot of ``rig``."""
    assert rig.arm is not None
    axes = ArmAxes(rig, clock, rig.arm.make_driver(clock, "arm"))
    parts: list[ArmPart] = []
    return {name: ArmPart(axes, name, rig.axis_groups[name], parts) for name in ("rails", "turntable")}
