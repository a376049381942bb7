"""Servo model of one to six axes with its parameters, for mocks and emulators; limits of setpoints, for drivers."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.config.tables.mechanics import DriveMechanics
from hil.core import alarm_table as table
from hil.core.messages import Array, new
from hil.drivers.base import accepted_setpoint, full_names, setpoint_bounds
from hil.models.drive_mechanics import drive_mechanics_record, drive_mechanics_step, encoder_reading
from hil.models.servo import servo_record, servo_step

AXES_LEAST: Final = 3
"""Axes of a record, also of a group of fewer: the kernels of rails and turntable serve it."""
_FROM_CONFIG: Final = ("low", "high", "rate_max", "acceleration_max", "position")


class ServoAxes:
    """Axes that follow setpoints, n of one to six, in SI units: m and m/s, or rad and rad/s.

    position, rate, setpoint, feedforward, low, high, kp (1/s), tau (s): arrays of shape (n,), in the order of
    ``config.axes``; views of ``record`` (SERVO, of more axes a wider one), a new one or the given one. The axes start
    at their park position, at rest.
    """

    def __init__(self, config: AxisGroupTable, record: np.record | None = None) -> None:
        table = np.array([axis.limits for axis in config.axes])
        n, width = len(table), max(AXES_LEAST, len(table))
        table = np.concatenate([table, np.repeat(table[-1:], width - n, axis=0)])  # those that it has not stand
        self.record: np.record = new(servo_record(width)) if record is None else record
        for name, column in zip(_FROM_CONFIG, table.T, strict=True):
            self.record[name] = column
        self.record.rate_min = -self.record.rate_max
        self.record.setpoint = self.record.position
        self.record.kp, self.record.tau = config.servo.gain_per_s, config.servo.lag_s
        self.low, self.high, self.rate_max, self.acceleration_max, self.position = (
            np.asarray(self.record[name])[:n] for name in _FROM_CONFIG
        )
        self.rate, self.setpoint, self.feedforward, self.kp, self.tau = (
            np.asarray(self.record[name])[:n] for name in ("rate", "setpoint", "feedforward", "kp", "tau")
        )
        self.counted, self.counted_rate = self.position, self.rate
        """Positions and rates at the encoders, (n,)."""

    def displace(self, axis: int, position: float, rate: float) -> None:
        """Put one axis to ``position``, moving at ``rate``, whatever its drive does."""
        self.position[axis], self.rate[axis] = position, rate

    def hold(self) -> None:
        """Make the present position the setpoint."""
        self.setpoint[:] = self.position
        self.feedforward[:] = 0.0

    def step(self, dt_s: float) -> None:
        """Advance by ``dt_s``."""
        servo_step(
            self.position,
            self.rate,
            self.setpoint,
            self.feedforward,
            self.kp,
            self.tau,
            self.rate_max,
            self.acceleration_max,
            self.low,
            self.high,
            dt_s,
        )


class MechanicalAxes(ServoAxes):
    """Axes with the mechanics of a machine: ``position`` and ``rate`` are those of the load.

    counted, counted_rate: of the encoders, which are on the motors.
    """

    def __init__(self, config: AxisGroupTable, mechanics: DriveMechanics) -> None:
        super().__init__(config)
        n = len(self.position)
        state: np.record = new(drive_mechanics_record(max(AXES_LEAST, n)))
        state.motor = state.counted = self.record.position
        gain = 2.0 * np.pi * mechanics.velocity_bandwidth_hz
        load = mechanics.load_ratio / (1.0 + mechanics.load_ratio)
        resonance = 2.0 * np.pi * mechanics.resonance_hz
        state.velocity_gain = gain
        state.coulomb, state.breakaway = mechanics.si("friction_coulomb"), mechanics.si("friction_breakaway")
        state.stribeck, state.viscous = mechanics.si("friction_stribeck"), mechanics.viscous
        state.presliding, state.gap = mechanics.si("presliding"), mechanics.si("backlash")
        state.stiffness = load * resonance * resonance
        state.damping = 2.0 * mechanics.damping_ratio * load * resonance
        state.load_fraction = load
        state.cogging, state.cogging_period = mechanics.si("cogging"), mechanics.si("cogging_period")
        state.encoder_step = mechanics.si("encoder_step")
        state.force_max = (1.0 + mechanics.force_reserve_fraction) * self.record.acceleration_max + state.breakaway
        self._mechanics = state
        self.counted, self.counted_rate = np.asarray(state.counted)[:n], np.asarray(state.motor_rate)[:n]

    def displace(self, axis: int, position: float, rate: float) -> None:
        super().displace(axis, position, rate)
        state = self._mechanics
        state.motor[axis] = position
        state.counted[axis] = encoder_reading(position, state.encoder_step[axis])
        state.motor_rate[axis] = state.rate_reference[axis] = rate
        state.integral[axis] = state.bristle[axis] = 0.0

    def hold(self) -> None:
        self.setpoint[:] = self.counted
        self.feedforward[:] = 0.0

    def step(self, dt_s: float) -> None:
        drive_mechanics_step(self.record, self._mechanics, dt_s)


def axes_of(config: AxisGroupTable) -> ServoAxes:
    """Return the axes of an emulated device, with its mechanics if it has some."""
    mechanics = config.emulated_mechanics
    return ServoAxes(config) if mechanics is None else MechanicalAxes(config, mechanics)


class SetpointLimits:
    """Names of the axes of a device, and the limits of their setpoints, (n,) each, in SI units."""

    def __init__(self, name: str, config: AxisGroupTable) -> None:
        axes = ServoAxes(config)
        self.names = full_names(name, config.axis_names)
        self.low, self.high = axes.low, axes.high
        self.rate_max, self.acceleration_max = axes.rate_max, axes.acceleration_max

    def accepted(self, position: Array, rate: Array, jogging: bool) -> tuple[Array, Array]:
        """Return position and rate (n,) within the limits; an axis that is limited in position gets rate 0.

        jogging: the position is not limited. Raises SafetyTrip for a value that is not finite.
        """
        accepted = accepted_setpoint(self.names, position, *setpoint_bounds(self.low, self.high, jogging))
        accepted_rate = accepted_setpoint(self.names, rate, -self.rate_max, self.rate_max, table.RATE)
        return accepted, np.where(accepted == position, accepted_rate, 0.0)

    def accepted_goal(self, position: Array, rate: Array) -> tuple[Array, Array]:
        """Return the goal of a move (n,), and its largest rate, within the limits; errors: see ``accepted``."""
        goal = accepted_setpoint(self.names, position, self.low, self.high)
        return goal, accepted_setpoint(self.names, np.abs(rate), np.zeros_like(rate), self.rate_max, table.RATE)
