"""Mechanics of emulated drives, one to six: servos, holding brakes, encoders, home and limit switches, faults."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from hil.config.rig import AxisGroupTable
from hil.core.clock import BenchClock
from hil.core.messages import Array, Homing
from hil.drivers.axes import axes_of
from hil.drivers.io.relay import HoldingBrakes
from hil.maths.random_streams import stream
from hil.parts.emulation.fault_injection import Faults
from hil.parts.emulation.shared_state import ChainState, SharedAxisState

STEP_S: Final = 0.004  # longest time between two updates of the axes, as BenchClock.paced_s
WATCHDOG_S: Final = 0.5
_SUBSTEP_S: Final = 0.002
_SAMPLING_S: Final = 1e-4  # sampling of a drive's encoder: requests in between return the last sample
_PUBLISHED_S: Final = 0.001  # least time between two writes of the shared state
_TIME_SLACK_S: Final = 1e-9
_STANDSTILL: Final = 2e-3  # speed, m/s or rad/s
_SWITCH: Final = 1e-6  # m or rad from the end stop, at which its limit switch closes
_HOMING_TIME_MAX_S: Final = 120.0
_GRAVITY_MPS2: Final = 9.81  # rad/s^2 for a gravity-loaded gimbal, whose load is 1 m from the axis
_FRICTION: Final = 0.5  # deceleration of an axis without torque, in acceleration limits
_BRAKE: Final = 4.0  # deceleration by a closed holding brake, in acceleration limits; at least twice the weight

ReadChain = Callable[[], ChainState]


class EmulatedAxes:
    """Axes 0 to n - 1 of ``device``; m and m/s (rails x, y, z) or rad and rad/s (turntable roll, pitch, yaw).

    An axis follows setpoints, or brakes at its acceleration limit and then holds; with a reversed encoder its drive
    does the opposite of both. Without torque, because the safety
    chain is open or its drive is disabled, it coasts against friction; one that is gravity-loaded falls to its low end
    until its brake has closed. ``position`` and ``rate`` are the encoder's values, which a drive reports; they differ
    from the true ones when an encoder fails. overdue: axes that braked because setpoints ceased; cleared by the owner.
    astray: axes that lost their torque because the following error, by the encoder, was beyond ``window`` (m or rad)
    for ``window_s``; nothing moves them until the owner has cleared it.
    chain: state of the safety chain; unless given, that in ``shared``.
    """

    def __init__(
        self,
        device: str,
        config: AxisGroupTable,
        clock: BenchClock,
        shared: SharedAxisState,
        faults: Faults | None = None,
        chain: ReadChain | None = None,
        seed: int = 0,
    ) -> None:
        self.device = device
        self.names = config.axis_names
        n = len(self.names)
        self._numbers = config.axis_numbers
        self.faults = faults or Faults(device, ("wire", "drive"), self.names)
        self.overdue = [False] * n
        self.astray = [False] * n
        self.torque_off = False
        axes = config.axes
        self.window = [config.si("drive_following_error_max")] * n
        self.window_s = [config.drive_following_error_s] * n
        self._speed = [0.0] * n  # in the step before
        self._within_s = [-math.inf] * n  # bench time at which it was last within the window
        self._unit = config.si_per_unit
        self._axes = axes_of(config)
        mechanics = config.emulated_mechanics
        self._delay_s = 0.0 if mechanics is None else mechanics.loop_delay_s
        self._still = 0.0 if mechanics is None else _STANDSTILL  # friction never lets a rate be exactly zero
        self._coming: list[deque[tuple[float, float, float]]] = [deque() for _ in self.names]
        self._shared = shared
        self._read_chain = chain or partial(shared.read_chain, clock)
        self._chain = ChainState()
        self._brakes = [
            None if axis.brake is None else HoldingBrakes(axis.brake.close_s, axis.brake.open_s) for axis in axes
        ]
        self._falls = [axis.falls for axis in axes]
        self._enabled = [False] * n
        self._current_until_s = [-math.inf] * n  # end of the current of a disabled drive: its brake has closed
        self._runaway: list[float | None] = [None] * n
        self._sigma = config.si("encoder_sigma")
        self._noise = stream(seed, "encoders", device)
        self.wire_noise = stream(seed, "wire")
        """Random numbers of the faults of the wire."""
        self._absolute = [axis.encoder == "absolute" for axis in axes]
        self._home = np.array([axis.si("home") for axis in axes])
        self._homing_rate = np.array([axis.si("homing_rate") for axis in axes])
        self.homing = [Homing.DONE if absolute else Homing.NEEDED for absolute in self._absolute]
        # an incremental encoder counts from where it was switched on
        self._offset = np.where(self._absolute, 0.0, -self._axes.position)
        self._damage = np.zeros(n)  # part of it that faults have left
        self._clears = 0
        self._gear = np.ones(n)  # displacement assumed by the drive per displacement of the axis
        self._count = np.ones(n)  # displacement counted by the encoder, negative when reversed
        self._altered = False  # one of them is not 1
        self._setpoint = np.zeros(n)  # in the encoder's zero and scale
        self._braking = [True] * n
        self._deadline_s = [math.inf] * n
        self._homing_until_s = [math.inf] * n
        self.position: Array = np.zeros(n)
        self.rate: Array = np.zeros(n)
        self._axes.step(0.0)  # compiles the kernel outside the cycle
        self._t_s = clock.now_s()
        self._stood = self._axes.position.copy()
        self._update_encoders()
        self._publish()

    @property
    def low(self) -> Array:
        """Positions of the low limit switches, (n,)."""
        return self._axes.low

    @property
    def high(self) -> Array:
        """Positions of the high limit switches, (n,)."""
        return self._axes.high

    def limit(self, axis: int) -> int:
        """Return the limit switch that the axis stands on: -1 low, 1 high, 0 none."""
        position = self._axes.position[axis]
        if position <= self._axes.low[axis] + _SWITCH:
            return -1
        return int(position >= self._axes.high[axis] - _SWITCH)

    def moving(self, axis: int) -> bool:
        """Whether the axis moves faster than the standstill limit."""
        return bool(abs(self._axes.rate[axis]) > _STANDSTILL)

    def follow(self, axis: int, position: float, rate: float, now_s: float, watchdog_s: float = WATCHDOG_S) -> None:
        """Set the setpoint of one axis in the encoder's zero; without another within ``watchdog_s`` the axis brakes."""
        if not self._chain.closed or self.astray[axis] or self.homing[axis] is Homing.UNDER_WAY:
            return
        self._enabled[axis] = True
        self._deadline_s[axis] = now_s + watchdog_s
        if self._delay_s > 0.0:
            self._coming[axis].append((now_s + self._delay_s, position, rate))
        else:
            self._act_on(axis, position, rate)

    def _act_on(self, axis: int, position: float, rate: float) -> None:
        self._setpoint[axis] = position
        self._axes.feedforward[axis] = rate / self._gear[axis]
        if self._braking[axis]:
            self._braking[axis], self._within_s[axis] = False, self._t_s

    def brake(self, axis: int) -> None:
        """Quick stop of one axis: brake at the acceleration limit, then hold. Aborts its homing."""
        if self.homing[axis] is Homing.UNDER_WAY:
            self.homing[axis] = Homing.FAILED
        self._coming[axis].clear()
        self._axes.feedforward[axis] = 0.0
        self._braking[axis] = True
        self._within_s[axis] = math.inf
        self._deadline_s[axis] = math.inf

    def enable(self, axis: int) -> None:
        """Switch the torque of one axis on and release its brake."""
        self._enabled[axis] = not self.astray[axis]

    def disable(self, axis: int) -> None:
        """Switch the torque of one axis off; a drive with a holding brake waits until that has closed."""
        if not self._enabled[axis]:
            return
        self.brake(axis)
        self._enabled[axis] = False
        brake = self._brakes[axis]
        self._current_until_s[axis] = self._t_s + (0.0 if brake is None else brake.close_s + 2.0 * _SUBSTEP_S)

    def home(self, axis: int) -> None:
        """Start homing at ``homing_rate``; no effect with an absolute encoder."""
        if self._absolute[axis] or self.astray[axis] or not self._chain.closed:
            return
        self._enabled[axis] = True
        self._coming[axis].clear()
        self.homing[axis] = Homing.UNDER_WAY
        self._braking[axis] = False
        self._deadline_s[axis] = math.inf
        self._homing_until_s[axis] = self._t_s + _HOMING_TIME_MAX_S

    def advance(self, now_s: float) -> None:
        """Advance to bench time ``now_s`` and publish the axes."""
        if now_s < self._t_s + _SAMPLING_S:
            return
        self._apply_safety_chain()
        while self._t_s < now_s:
            step_s = min(_SUBSTEP_S, now_s - self._t_s)
            for axis in range(len(self.names)):
                self._act_on_due_setpoints(axis)
            self._t_s += step_s
            for axis in range(len(self.names)):
                self._supervise(axis)
            previous = self._axes.position.copy(), self._axes.rate.copy()
            self._axes.step(step_s)
            for axis in range(len(self.names)):
                self._apply_missing_torque(axis, previous[0][axis], previous[1][axis], step_s)
            self._hold_stuck_axes()
        self._update_encoders()
        if self._t_s >= self._published_s + _PUBLISHED_S:
            self._publish()

    def _apply_safety_chain(self) -> None:
        self._chain = self._read_chain()
        self.torque_off = not self._chain.torque
        if not self._chain.closed:
            for axis in range(len(self.names)):
                self.brake(axis)

    def _apply_missing_torque(self, axis: int, position: float, rate: float, step_s: float) -> None:
        """Replace the step of an axis without torque, or with a runaway drive.

        position, rate: m and m/s, or rad and rad/s, before the step.
        """
        axes, brake = self._axes, self._brakes[axis]
        braked = brake is not None and brake.update(self._t_s, self._chain.brakes_released and self._enabled[axis])
        current = self._enabled[axis] or self._t_s < self._current_until_s[axis]
        if current and self._chain.torque:
            rate_of_runaway = self._rate_of_runaway(axis, rate)
            if rate_of_runaway is None:
                return
            rate = rate_of_runaway
        else:
            rate = self._rate_without_torque(axis, rate, braked, step_s)
        target = position + step_s * rate
        reached = min(max(target, axes.low[axis]), axes.high[axis])
        axes.displace(axis, reached, rate if reached == target else 0.0)

    def _rate_without_torque(self, axis: int, rate: float, braked: bool, step_s: float) -> float:
        """Return the rate after ``step_s``, m/s or rad/s, by gravity, friction and holding brake."""
        gravity = -_GRAVITY_MPS2 if self._falls[axis] else 0.0
        limit = self._axes.acceleration_max[axis]
        hold = max(_BRAKE * limit, -gravity) - gravity if braked else _FRICTION * limit
        free = rate + step_s * gravity
        return math.copysign(max(0.0, abs(free) - step_s * hold), free)

    def _rate_of_runaway(self, axis: int, rate: float) -> float | None:
        """Return the rate of an axis whose drive ignores all commands; None for a working one."""
        value = self.faults.value("runaway", self.names[axis])
        if value is None:
            self._runaway[axis] = None
            return None
        if self._runaway[axis] is None:
            self._runaway[axis] = self._unit * value if value != 0.0 else rate
        return self._runaway[axis]

    def _act_on_due_setpoints(self, axis: int) -> None:
        coming = self._coming[axis]
        while coming and coming[0][0] <= self._t_s + _TIME_SLACK_S:
            self._act_on(axis, *coming.popleft()[1:])

    def _supervise(self, axis: int) -> None:
        if self._deadline_s[axis] <= self._t_s:
            self.overdue[axis] = True
            self.brake(axis)
        if self.homing[axis] is Homing.UNDER_WAY:
            self._step_homing(axis)
        elif not self._braking[axis]:
            self._check_window(axis, self._regulate(axis))
        rate = self._axes.counted_rate[axis]
        if self._braking[axis] and abs(rate) > self._still:
            self._axes.setpoint[axis] = self._axes.counted[axis]  # does not return to where braking began
            runs_away = self._count[axis] * self._gear[axis] < 0.0 and abs(rate) > _STANDSTILL
            self._axes.feedforward[axis] = math.copysign(self._axes.rate_max[axis], rate) if runs_away else 0.0

    def _regulate(self, axis: int) -> float:
        """Close the drive's position loop on its encoder; return the following error.

        A reversed encoder makes the axis run away.
        """
        counted = self._axes.counted[axis]
        error = self._setpoint[axis] - (self._count[axis] * counted + self._offset[axis])
        self._axes.setpoint[axis] = counted + error / self._gear[axis]
        return float(error)

    def _check_window(self, axis: int, error: float) -> None:
        """Switch the torque off after ``window_s`` beyond the window; a runaway drive does not look.

        An axis that approaches a far setpoint, or brakes beyond it, is within it: a drive compares with its own demand,
        which it limits.
        """
        rate = self._count[axis] * self._axes.counted_rate[axis]
        slowing, self._speed[axis] = abs(rate) < self._speed[axis], abs(rate)
        on_its_way = abs(rate) > _STANDSTILL and (slowing or error * rate > 0.0)
        if abs(error) <= self.window[axis] or on_its_way or self._runaway[axis] is not None:
            self._within_s[axis] = self._t_s
        elif self._t_s - self._within_s[axis] > self.window_s[axis]:
            self.astray[axis] = True
            self.disable(axis)

    def _step_homing(self, axis: int) -> None:
        """Advance homing by one step."""
        position, home = self._axes.position[axis], self._home[axis]
        way = home - position
        if abs(way) <= self._homing_rate[axis] * _SUBSTEP_S:
            self._offset[axis] = self._damage[axis] = 0.0
            self._count[axis] = 1.0
            self.homing[axis] = Homing.DONE
            self._setpoint[axis] = home
            self._axes.setpoint[axis] = home
            self._axes.feedforward[axis] = 0.0
        elif self._t_s > self._homing_until_s[axis]:
            self.brake(axis)
        else:
            self._axes.setpoint[axis] = self._axes.counted[axis]
            self._axes.feedforward[axis] = math.copysign(self._homing_rate[axis], way)

    def _hold_stuck_axes(self) -> None:
        if self.faults.active:
            for axis, name in enumerate(self.names):
                if self.faults.value("stuck", name) is not None:
                    self._axes.displace(axis, float(self._stood[axis]), 0.0)
        self._stood[:] = self._axes.position

    def _update_encoders(self) -> None:
        """Update the encoders' values."""
        axes = self._axes
        if self.faults.active or self.faults.clears != self._clears or self._altered:
            self._apply_encoder_faults()
        if self.faults.value("freeze") is None:
            noise = self._sigma * self._noise.standard_normal(len(self.names)) if self._sigma > 0.0 else 0.0
            self.position = self._count * axes.counted + self._offset + noise
            self.rate = self._count * axes.counted_rate

    def _apply_encoder_faults(self) -> None:
        axes = self._axes
        for axis, name in enumerate(self.names):
            jump = self.faults.pop("jump", name)
            damage = self._unit * jump if jump is not None else 0.0
            self._gear[axis], count = self._signs_and_scales(name)
            if count != self._count[axis]:  # the scale changes, the present value does not
                damage += (self._count[axis] - count) * axes.counted[axis]
                self._count[axis] = count
            self._offset[axis] += damage
            self._damage[axis] += damage
        if self.faults.clears != self._clears:
            self._clears = self.faults.clears
            self._offset -= self._damage
            self._damage[:] = 0.0
        self._altered = bool((self._gear != 1.0).any() or (self._count != 1.0).any())

    def _signs_and_scales(self, name: str) -> tuple[float, float]:
        """Return the scales of drive and encoder under the active faults."""
        gear = self.faults.value("scaled", name) or 1.0
        if self.faults.value("mirrored", name) is not None:
            gear = -gear
        return gear, -gear if self.faults.value("reversed", name) is not None else gear

    def _publish(self) -> None:
        self._published_s = self._t_s
        self._shared.write(self.device, self._t_s, self._axes.position, self._axes.rate, self._numbers)
