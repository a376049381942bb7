"""Servo model of three axes with its parameters, for mocks and emulators."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.messages import new
from hil.models.servo import SERVO, servo_step

_FROM_CONFIG: Final = ("low", "high", "rate_max", "acceleration_max", "position")


class ServoAxes:
    """Three axes that follow setpoints, in SI units: m and m/s, or rad and rad/s.

    position, rate, setpoint, feedforward, low, high, kp (1/s), tau (s): arrays of shape (3,), rails x y z or gimbals
    roll pitch yaw; views of ``record`` (SERVO). The axes start at their park position, at rest.
    """

    def __init__(self, config: AxisGroupTable) -> None:
        table = np.array([axis.limits for axis in config.axes]) * config.si_per_unit
        self.record: np.record = new(SERVO)
        for name, column in zip(_FROM_CONFIG, table.T, strict=True):
            self.record[name] = column
        self.record.rate_min = -self.record.rate_max
        self.record.setpoint = self.record.position
        self.record.kp, self.record.tau = config.servo.gain_per_s, config.servo.lag_s
        self.low, self.high, self.rate_max, self.acceleration_max, self.position = (
            np.asarray(self.record[name]) for name in _FROM_CONFIG
        )
        self.rate, self.setpoint, self.feedforward, self.kp, self.tau = (
            np.asarray(self.record[name]) for name in ("rate", "setpoint", "feedforward", "kp", "tau")
        )

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
