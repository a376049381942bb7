"""Mock of rails, turntable and other axes: one to six in memory, in simulated time."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core import alarm_table as table
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.axes import AXES_LEAST, ServoAxes
from hil.drivers.base import accepted_setpoint, full_names, setpoint_bounds
from hil.errors import DeviceError, LinkLost
from hil.models.servo import move_servo

_BRAKE_STEP_S: Final = 0.002
_AT_SWITCH: Final = 1e-4  # m or rad


class MockAxes:
    """AxisGroup without a wire; equal calls give equal numbers, bit for bit.

    Each call advances the axes to its time; earlier times move nothing. An axis with ``encoder = "incremental"``
    counts from its position at power-on. ``home`` moves axes that are not homed to their home switches. servo: SERVO
    of three axes, which a compiled loop moves instead of ``send`` and ``read``; None: of their own.
    """

    def __init__(self, name: str, config: AxisGroupTable, servo: np.record | None = None) -> None:
        self.name = name
        self.axis_names = full_names(name, config.axis_names)
        self._axes = ServoAxes(config, servo)
        self.servo = kernel_record(self._axes.record)
        """SERVO."""
        self._home = [axis.si("home") for axis in config.axes]
        self._homing_rate = [axis.si("homing_rate") for axis in config.axes]
        self._incremental = [axis.encoder == "incremental" for axis in config.axes]
        n = len(config.axes)
        self._homed = (Homing.DONE,) * n
        self._homing = self._homed
        self._offset, self._disturbance, self._disturbance_rate = (
            np.asarray(self._axes.record[name])[:n] for name in ("encoder_offset", "disturbance", "disturbance_rate")
        )
        self._counted_from: Array = np.zeros(n)  # zero of an encoder that is not homed
        self._limit: tuple[int, ...] = (0,) * n
        self._without_switch: set[int] = set()
        self._jogging = False
        self._stopped = False
        self._error: DeviceError | None = LinkLost(name, "is not open")
        self.switch_off_and_on()

    def open(self, now_s: float) -> None:
        """Hold the present position."""
        self._axes.hold()
        self.servo.t_s = now_s
        self._stopped = False
        self._jogging = False
        self._error = None

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        self._check()
        self._move(now_s)
        self._set_homing({i: Homing.UNDER_WAY for i, state in enumerate(self._homing) if state != Homing.DONE})

    def set_jogging(self, on: bool) -> None:
        self._jogging = on

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Set the setpoint at ``now_s``; a stopped device returns the position that it holds."""
        self._check()
        axes = self._axes
        if not self._jogging:
            self._refuse_without_home()
        bounds = setpoint_bounds(axes.low, axes.high, self._jogging)
        accepted = accepted_setpoint(self.axis_names, position, *bounds)
        feedforward = accepted_setpoint(self.axis_names, rate, -axes.rate_max, axes.rate_max, table.RATE)
        self._move(now_s)
        if self._stopped:
            return self._shown()
        counted = accepted + self._counted_from if self._homing is not self._homed else accepted
        axes.setpoint[:] = counted - self._offset + self._disturbance
        axes.feedforward[:] = feedforward + self._disturbance_rate
        return accepted

    def read(self, now_s: float) -> AxisFeedback:
        """Return the feedback of the encoders at ``now_s``."""
        self._check()
        self._move(now_s)
        return AxisFeedback(now_s, self._shown(), self._axes.rate.copy(), self._homing, self._limit)

    def position_at(self, now_s: float) -> Array:
        """Return the true positions at ``now_s``, (n,), m or rad, whatever the encoders show."""
        self._check()
        self._move(now_s)
        return self._axes.position.copy()

    def stop(self, now_s: float) -> None:
        """Brake, then hold; homing is aborted."""
        self._move(now_s)
        self._stopped = True
        self._set_homing({i: Homing.NEEDED for i, state in enumerate(self._homing) if state == Homing.UNDER_WAY})

    def disable(self, now_s: float) -> None:
        """Stop: an axis in memory stands without torque."""
        self.stop(now_s)

    def close(self) -> None:
        self._stopped = True
        self._error = LinkLost(self.name, "is closed")

    def fail(self, error: DeviceError) -> None:
        """Make later ``send`` and ``read`` raise ``error``, as after a failure of the link."""
        self._error = error

    def switch_off_and_on(self) -> None:
        """Cycle the drives' power: incremental encoders restart from zero, not homed."""
        self._axes.hold()
        self._axes.rate[:] = 0.0
        self._counted_from = np.where(self._incremental, self._axes.position, 0.0)
        self._homing = self._homed
        self._set_homing({i: Homing.NEEDED for i, lost in enumerate(self._incremental) if lost})

    def set_limit_switch(self, axis: int, switch: int) -> None:
        """Put ``axis`` on its low (-1), its high (1) or no (0) limit switch."""
        limit = [*self._limit]
        limit[axis] = switch
        self._limit = tuple(limit)

    def hide_home_switch(self, axis: int) -> None:
        """Make homing of ``axis`` fail at the position of its switch."""
        self._without_switch.add(axis)

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _refuse_without_home(self) -> None:
        if self._homing is self._homed:
            return
        for name, state in zip(self.axis_names, self._homing, strict=True):
            if state != Homing.DONE:
                raise table.SETPOINT.trip(name, "not homed", "homed axes")

    def _set_homing(self, changed: dict[int, Homing]) -> None:
        states = [changed.get(i, state) for i, state in enumerate(self._homing)]
        self._homing = self._homed if all(state == Homing.DONE for state in states) else tuple(states)

    def _shown(self) -> Array:
        position: Array = self._axes.position + self._offset
        return position if self._homing is self._homed else position - self._counted_from

    def _move(self, now_s: float) -> None:
        left_s = now_s - float(self.servo["t_s"])
        if left_s <= 0.0:
            return
        if not self._stopped:
            if Homing.UNDER_WAY in self._homing:
                self._step_homing(left_s)
            if len(self.axis_names) <= AXES_LEAST:
                move_servo(self.servo, now_s)
                return
            self._axes.step(left_s)
            self.servo.t_s = now_s
            return
        self.servo.t_s = now_s
        while left_s > 0.0 and self._axes.rate.any():
            self._axes.hold()  # does not return to where braking began
            self._axes.step(min(left_s, _BRAKE_STEP_S))
            left_s -= _BRAKE_STEP_S

    def _step_homing(self, dt_s: float) -> None:
        """Advance homing; axes at their switches are homed."""
        axes = self._axes
        arrived: dict[int, Homing] = {}
        for axis, state in enumerate(self._homing):
            if state != Homing.UNDER_WAY:
                continue
            way = self._home[axis] - axes.setpoint[axis]
            if abs(self._home[axis] - axes.position[axis]) > _AT_SWITCH:
                axes.setpoint[axis] += math.copysign(min(abs(way), self._homing_rate[axis] * dt_s), way)
                axes.feedforward[axis] = 0.0
            elif axis in self._without_switch:
                arrived[axis] = Homing.FAILED
            else:
                arrived[axis] = Homing.DONE
                self._counted_from[axis] = 0.0
        self._set_homing(arrived)
