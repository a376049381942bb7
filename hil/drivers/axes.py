"""Servo model of three axes with its parameters, for mocks and emulators."""

from __future__ import annotations

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.messages import Array
from hil.models.servo import servo_step


class ServoAxes:
    """Three axes that follow setpoints, in SI units: m and m/s, or rad and rad/s.

    position, rate, setpoint, feedforward, low, high, kp (1/s), tau (s): arrays of shape (3,), rails x y z or gimbals
    roll pitch yaw. The axes start at their park position, at rest.
    """

    def __init__(self, config: AxisGroupTable) -> None:
        table = np.array([axis.limits for axis in config.axes]) * config.si_per_unit
        self.low, self.high, self.rate_max, self.acceleration_max, self.position = (
            np.ascontiguousarray(column) for column in table.T
        )
        self.rate: Array = np.zeros(3)
        self.setpoint: Array = self.position.copy()
        self.feedforward: Array = np.zeros(3)
        self.kp = np.full(3, config.servo.gain_per_s)
        self.tau = np.full(3, config.servo.lag_s)

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
