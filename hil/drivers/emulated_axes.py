"""The mechanics behind three emulated drives: servos, brakes, encoders, home and limit switches, and their faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.clock import WallClock
from hil.core.messages import Array, Homing
from hil.drivers.axes import ServoAxes
from hil.drivers.fault_injection import AXIS, WIRE, Faults, kinds
from hil.drivers.shared_state import SharedAxisState
from hil.maths.random_streams import stream

STEP_S: Final = 0.004  # longest bench time between two looks at the axes; the board is due every 5 ms
WATCHDOG_S: Final = 0.5
_SUBSTEP_S: Final = 0.002
_STANDSTILL: Final = 2e-3  # of m/s or rad/s
_HOMING_TIME_MAX_S: Final = 120.0

ChainClosed = Callable[[], bool]


class EmulatedAxes:
    """Axes 0, 1, 2 of ``device``; m and m/s (rails x, y, z) or rad and rad/s (turntable roll, pitch, yaw).

    An axis follows setpoints, or it brakes along its acceleration limit and then stands (a real one has
    its brake on or holds by current; both stand). What a drive reports are ``position`` and ``rate``: the
    encoder's values, which are not where the axis is once an encoder fails. overdue: axes that braked
    because no command came in time; it is the owner who clears them. chain_closed: whether the safety
    chain lets the drives have torque; left away, ``board`` tells.
    """

    def __init__(
        self,
        device: str,
        config: AxisGroupTable,
        clock: WallClock,
        board: SharedAxisState,
        faults: Faults | None = None,
        chain_closed: ChainClosed | None = None,
        seed: int = 0,
    ) -> None:
        self.device = device
        self.names = config.axis_names
        self.faults = faults or Faults(device, kinds(WIRE, AXIS), self.names)
        self.overdue = [False, False, False]
        self.torque_off = False
        scale, axes = config.si_per_unit, config.axes
        self._unit = scale
        self._axes = ServoAxes(config)
        self._board = board
        self._chain_closed = chain_closed or partial(board.chain_closed, clock)
        self._sigma = scale * config.encoder_sigma
        self._noise = stream(seed, "encoders")
        self._absolute = [axis.encoder == "absolute" for axis in axes]
        self._home = np.array([scale * axis.home for axis in axes])
        self._homing_rate = np.array([scale * axis.homing_rate for axis in axes])
        self.homing = [Homing.DONE if known else Homing.NEEDED for known in self._absolute]
        # an incremental encoder counts from where it was switched on
        self._offset = np.where(self._absolute, 0.0, -self._axes.position)
        self._gear = np.ones(3)  # what the drive takes for the axis' way, as a share of it
        self._count = np.ones(3)  # what the encoder counts: the same, but for one that is reversed
        self._wanted = np.zeros(3)  # as the encoder counts
        self._braking = [True, True, True]
        self._deadline_s = [math.inf, math.inf, math.inf]
        self._homing_until_s = [math.inf, math.inf, math.inf]
        self.position: Array = np.zeros(3)
        self.rate: Array = np.zeros(3)
        self._axes.step(0.0)  # compiles the kernel before anyone waits for an answer
        self._t_s = clock.now_s()
        self._stood = self._axes.position.copy()
        self._look()
        self._publish()

    @property
    def low(self) -> Array:
        """Where the low limit switches are, (3,)."""
        return self._axes.low

    @property
    def high(self) -> Array:
        """Where the high limit switches are, (3,)."""
        return self._axes.high

    @property
    def limit(self) -> tuple[int, int, int]:
        """The limit switch that each axis stands on: -1 low, 1 high, 0 none."""
        place, low, high = self._axes.position, self._axes.low, self._axes.high
        on = [-1 if place[i] <= low[i] else 1 if place[i] >= high[i] else 0 for i in range(3)]
        return (on[0], on[1], on[2])

    def moving(self, axis: int) -> bool:
        """Whether the axis turns or travels faster than at a standstill."""
        return bool(abs(self._axes.rate[axis]) > _STANDSTILL)

    def follow(self, axis: int, position: float, rate: float, now_s: float, watchdog_s: float = WATCHDOG_S) -> None:
        """Give one axis its setpoint, as the encoder counts; it brakes when no other comes within ``watchdog_s``."""
        if self.torque_off or self.homing[axis] is Homing.UNDER_WAY:
            return
        self._wanted[axis] = position
        self._axes.feedforward[axis] = rate / self._gear[axis]
        self._braking[axis] = False
        self._deadline_s[axis] = now_s + watchdog_s

    def brake(self, axis: int) -> None:
        """Quick stop of one axis: slow down as fast as it may, then stand. Ends its homing."""
        if self.homing[axis] is Homing.UNDER_WAY:
            self.homing[axis] = Homing.FAILED
        self._axes.feedforward[axis] = 0.0
        self._braking[axis] = True
        self._deadline_s[axis] = math.inf

    def home(self, axis: int) -> None:
        """Let the axis look for its home switch at ``homing_rate``; nothing to do for an absolute encoder."""
        if self._absolute[axis] or self.torque_off:
            return
        self.homing[axis] = Homing.UNDER_WAY
        self._braking[axis] = False
        self._deadline_s[axis] = math.inf
        self._homing_until_s[axis] = self._t_s + _HOMING_TIME_MAX_S

    def power_off(self, axis: int) -> None:
        """Take the supply away: an incremental encoder loses its place."""
        self.brake(axis)
        if not self._absolute[axis]:
            self.homing[axis] = Homing.NEEDED
            self._offset[axis] = -self._axes.position[axis]

    def advance(self, now_s: float) -> None:
        """Move on to bench time ``now_s`` and show the axes on the board."""
        if now_s <= self._t_s:
            return
        self._obey_the_chain()
        while self._t_s < now_s:
            step_s = min(_SUBSTEP_S, now_s - self._t_s)
            self._t_s += step_s
            for axis in range(3):
                self._supervise(axis)
            self._axes.step(step_s)
            self._let_stuck_axes_stand()
        self._look()
        self._publish()

    def _obey_the_chain(self) -> None:
        self.torque_off = not self._chain_closed()
        if self.torque_off:
            for axis in range(3):
                self.brake(axis)

    def _supervise(self, axis: int) -> None:
        if self._deadline_s[axis] <= self._t_s:
            self.overdue[axis] = True
            self.brake(axis)
        if self.homing[axis] is Homing.UNDER_WAY:
            self._search(axis)
        elif not self._braking[axis]:
            self._regulate(axis)
        if self._braking[axis] and self._axes.rate[axis] != 0.0:
            self._axes.setpoint[axis] = self._axes.position[axis]  # no way back to where braking began

    def _regulate(self, axis: int) -> None:
        """Let the drive's position loop act on what its encoder says: one that counts backwards makes it run away."""
        place = self._axes.position[axis]
        error = self._wanted[axis] - (self._count[axis] * place + self._offset[axis])
        self._axes.setpoint[axis] = place + error / self._gear[axis]

    def _search(self, axis: int) -> None:
        """One step of the way to the home switch."""
        place, home = self._axes.position[axis], self._home[axis]
        way = home - place
        if abs(way) <= self._homing_rate[axis] * _SUBSTEP_S:
            self._offset[axis] = 0.0
            self._count[axis] = 1.0
            self.homing[axis] = Homing.DONE
            self._wanted[axis] = home
            self._axes.setpoint[axis] = home
            self._axes.feedforward[axis] = 0.0
        elif self._t_s > self._homing_until_s[axis]:
            self.brake(axis)
        else:
            self._axes.setpoint[axis] = place
            self._axes.feedforward[axis] = math.copysign(self._homing_rate[axis], way)

    def _let_stuck_axes_stand(self) -> None:
        for axis, name in enumerate(self.names):
            if self.faults.value("stuck", name) is not None:
                self._axes.rate[axis] = 0.0
                self._axes.position[axis] = self._stood[axis]
        self._stood[:] = self._axes.position

    def _look(self) -> None:
        """Bring the encoders' values up to date."""
        axes = self._axes
        for axis, name in enumerate(self.names):
            jump = self.faults.pop("jump", name)
            if jump is not None:
                self._offset[axis] += self._unit * jump
            self._gear[axis], count = self._geared(name)
            if count != self._count[axis]:  # from here on it counts otherwise
                self._offset[axis] += (self._count[axis] - count) * axes.position[axis]
                self._count[axis] = count
        if self.faults.value("freeze") is None:
            noise = self._sigma * self._noise.standard_normal(3) if self._sigma > 0.0 else 0.0
            self.position = self._count * axes.position + self._offset + noise
            self.rate = self._count * axes.rate

    def _geared(self, name: str) -> tuple[float, float]:
        """Return how the drive takes the axis' way, and how the encoder counts it, under the faults that are on."""
        gear = self.faults.value("scaled", name) or 1.0
        if self.faults.value("mirrored", name) is not None:
            gear = -gear
        return gear, -gear if self.faults.value("reversed", name) is not None else gear

    def _publish(self) -> None:
        self._board.write(self.device, self._t_s, self._axes.position, self._axes.rate)
