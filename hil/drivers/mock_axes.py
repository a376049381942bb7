"""Three axes in memory, in simulated time: the mock of the rails and of the turntable."""

from __future__ import annotations

from hil.config.rig import Rails, Turntable
from hil.drivers.axes import ServoAxes
from hil.drivers.base import accepted_setpoint, full_names
from hil.errors import DeviceError, LinkLost
from hil.messages import Array, AxisFeedback

_BRAKE_STEP_S = 0.002


class MockAxes:
    """An AxisGroup without a wire; the same calls give the same numbers, bit for bit.

    name: the device; short_names: its axes as in ``RAIL_NAMES`` or ``GIMBAL_NAMES``. The axes move
    when they are asked, up to the time that they are given; time that runs backwards moves nothing.
    """

    def __init__(self, name: str, short_names: tuple[str, str, str], config: Rails | Turntable) -> None:
        self.name = name
        self.axis_names = full_names(name, short_names)
        self._axes = ServoAxes(config)
        self._t_s = 0.0
        self._stopped = False
        self._error: DeviceError | None = LinkLost(name, "is not open")

    def open(self, now_s: float) -> None:
        """Hold the present position."""
        self._axes.hold()
        self._t_s = now_s
        self._stopped = False
        self._error = None

    def home(self, now_s: float) -> None:
        """Do nothing: these axes know their places."""

    def send(self, position: Array, rate: Array, now_s: float) -> Array:
        """Take the setpoint at ``now_s``; a stopped device stays where it is and returns that place."""
        self._check()
        axes = self._axes
        accepted = accepted_setpoint(self.axis_names, position, axes.low, axes.high)
        feedforward = accepted_setpoint(self.axis_names, rate, -axes.rate_max, axes.rate_max, "rate")
        self._move(now_s)
        if self._stopped:
            return axes.position.copy()
        axes.setpoint[:] = accepted
        axes.feedforward[:] = feedforward
        return accepted

    def read(self, now_s: float) -> AxisFeedback:
        """Return where the axes are at ``now_s``."""
        self._check()
        self._move(now_s)
        return AxisFeedback(now_s, self._axes.position.copy(), self._axes.rate.copy())

    def stop(self, now_s: float) -> None:
        """Brake, then stand."""
        self._move(now_s)
        self._stopped = True

    def close(self) -> None:
        self._stopped = True
        self._error = LinkLost(self.name, "is closed")

    def fail(self, error: DeviceError) -> None:
        """Let every later ``send`` and ``read`` raise ``error``, as after a failure of the link."""
        self._error = error

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _move(self, now_s: float) -> None:
        left_s = now_s - self._t_s
        if left_s <= 0.0:
            return
        self._t_s = now_s
        if not self._stopped:
            self._axes.step(left_s)
            return
        while left_s > 0.0 and self._axes.rate.any():
            self._axes.hold()  # no way back to the place where braking began
            self._axes.step(min(left_s, _BRAKE_STEP_S))
            left_s -= _BRAKE_STEP_S
