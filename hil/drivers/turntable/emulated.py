"""Three emulated gimbals: they move with bench time, brake, and stop when commands cease."""

from __future__ import annotations

import math

from hil.clock import WallClock
from hil.config.rig import Turntable
from hil.drivers.axes import ServoAxes
from hil.drivers.board import AxisBoard
from hil.messages import Array

STEP_S = 0.004  # longest bench time between two looks at the axes; the board is due every 5 ms
WATCHDOG_S = 0.5
_SUBSTEP_S = 0.002


class EmulatedGimbals:
    """The mechanics behind an emulated turntable; axis 0, 1, 2 is roll, pitch, yaw; rad and rad/s.

    An axis follows setpoints, or it brakes along its acceleration limit and then stands (a real one
    has its brake on or holds by current; both stand). overdue: axes that braked because no command
    came in time; it is the owner who clears them.
    """

    def __init__(self, config: Turntable, clock: WallClock, board: AxisBoard) -> None:
        self._axes = ServoAxes(config)
        self._board = board
        self._braking = [True, True, True]
        self._deadline_s = [math.inf, math.inf, math.inf]
        self.overdue = [False, False, False]
        self._axes.step(0.0)  # compiles the kernel before anyone waits for an answer
        self._t_s = clock.now_s()

    @property
    def position(self) -> Array:
        """Present position, shape (3,), rad; a view."""
        return self._axes.position

    @property
    def rate(self) -> Array:
        """Present rate, shape (3,), rad/s; a view."""
        return self._axes.rate

    def follow(self, axis: int, position_rad: float, rate_radps: float, now_s: float, watchdog_s: float) -> None:
        """Give one axis its setpoint; it brakes when no other comes within ``watchdog_s``."""
        self._axes.setpoint[axis] = position_rad
        self._axes.feedforward[axis] = rate_radps
        self._braking[axis] = False
        self._deadline_s[axis] = now_s + watchdog_s

    def brake(self, axis: int) -> None:
        """Quick stop of one axis: slow down as fast as it may, then stand."""
        self._axes.feedforward[axis] = 0.0
        self._braking[axis] = True
        self._deadline_s[axis] = math.inf

    def advance(self, now_s: float) -> None:
        """Move on to bench time ``now_s`` and show the axes on the board."""
        while self._t_s < now_s:
            for axis in range(3):
                if self._deadline_s[axis] <= self._t_s:
                    self.overdue[axis] = True
                    self.brake(axis)
            step_s = min(_SUBSTEP_S, now_s - self._t_s)
            self._brake_on()
            self._axes.step(step_s)
            self._t_s += step_s
        self._board.write("turntable", self._t_s, self._axes.position, self._axes.rate)

    def _brake_on(self) -> None:
        for axis in range(3):
            if self._braking[axis] and self._axes.rate[axis] != 0.0:
                self._axes.setpoint[axis] = self._axes.position[axis]  # no way back to where braking began
