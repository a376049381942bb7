"""Modes of operation of an emulated CiA 402 drive."""

from __future__ import annotations

import math

import numpy as np

from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.setpoint_limiter import ProfiledMove, compile_profile
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.units import Units
from hil.parts.emulation.cia402_objects import ObjectDictionary
from hil.parts.emulation.emulated_axes import EmulatedAxes

_BIT_4 = 0x10  # controlword bit: start
_FOLLOWS = 0x1400  # statusword of a drive that follows setpoints: it does, and is at the target
_CLOSE_COUNTS = 50
_HOMING_WORD = {
    Homing.NEEDED: codec.TARGET_REACHED,  # at rest, not commanded yet
    Homing.UNDER_WAY: 0,
    Homing.DONE: codec.HOMING_ATTAINED,
    Homing.FAILED: codec.TARGET_REACHED | codec.HOMING_ERROR,
}


class DriveAxis:
    """The axis ``axis`` of ``gimbals`` as its drive sees it, in the units of the drive."""

    def __init__(self, gimbals: EmulatedAxes, axis: int, units: Units, clock: BenchClock) -> None:
        self._gimbals = gimbals
        self._axis = axis
        self.units = units
        self._clock = clock

    def feedback(self) -> tuple[int, int]:
        """Return position and velocity."""
        position, rate = self._gimbals.position[self._axis], self._gimbals.rate[self._axis]
        return self.units.counts(position), self.units.speed(rate)

    def follow(self, target: float, velocity: float, watchdog_s: float) -> None:
        """Move to ``target`` with feed-forward of ``velocity``; brake without a target within ``watchdog_s``."""
        position, rate = target / self.units.position, velocity / (self.units.velocity or math.inf)
        self._gimbals.follow(self._axis, position, rate, self._clock.now_s(), watchdog_s)

    def brake(self) -> None:
        """Quick stop, then hold."""
        self._gimbals.brake(self._axis)

    def enable(self) -> None:
        """Switch the torque on and release the brake."""
        self._gimbals.enable(self._axis)

    def disable(self) -> None:
        """Close the brake, then switch the torque off."""
        self._gimbals.disable(self._axis)

    def home(self) -> None:
        """Start homing."""
        self._gimbals.home(self._axis)

    def homing(self) -> Homing:
        return self._gimbals.homing[self._axis]

    def moving(self) -> bool:
        return self._gimbals.moving(self._axis)

    def limit(self) -> int:
        """Return the active limit switch: -1, 0, 1."""
        return self._gimbals.limit(self._axis)

    def torque_off(self) -> bool:
        """Return whether the safety chain is open."""
        return self._gimbals.torque_off

    def astray(self) -> bool:
        """Return whether the axis has lost its torque because of its following error."""
        return self._gimbals.astray[self._axis]

    def clear_astray(self) -> None:
        """Allow torque again."""
        self._gimbals.astray[self._axis] = False

    def window(self) -> tuple[int, int]:
        """Return the following error window, counts, and its time-out, ms."""
        window, time_s = self._gimbals.window[self._axis], self._gimbals.window_s[self._axis]
        return self.units.counts(window), round(1e3 * time_s)

    def set_window(self, counts: float, time_out_ms: int) -> None:
        """Set them; inf: no supervision."""
        self._gimbals.window[self._axis] = counts / self.units.position
        self._gimbals.window_s[self._axis] = 1e-3 * time_out_ms


class DriveMotion:
    """Motion of the enabled drive by its mode of operation: setpoints, homing or profile.

    mode: the one in which the drive is, which it displays; it follows object 0x6060 as the drive's habits allow.
    """

    def __init__(self, axis: DriveAxis, objects: ObjectDictionary) -> None:
        self._axis = axis
        self._objects = objects
        self._habits = objects.habits
        self._profile: ProfiledMove | None = None
        self._goal = 0
        self._acknowledged = False
        self.mode = objects.value(codec.MODE)
        self._requested_s = self._changed_s = -math.inf
        self._lingering = _FOLLOWS
        self._interpolates = False
        self._sync_s = -math.inf
        self._previous: int | None = None
        compile_profile()

    def request(self, now_s: float) -> None:
        """Take note of a new value of object 0x6060."""
        self._requested_s = now_s

    def begin(self) -> None:
        """Hold the setpoint or the present position after enabling or a change of mode."""
        self._profile = self._previous = None
        self._acknowledged = False
        if self.mode == codec.CYCLIC_SYNCHRONOUS_POSITION:
            self._follow(codec.TARGET_POSITION, 0, math.nan)
        else:
            self._axis.follow(self._axis.feedback()[0], 0, math.inf)

    def control(self, word: int, rising: int, falling: int, now_s: float) -> None:
        """Act on bit 4 of the controlword."""
        if self.mode == codec.HOMING and rising & _BIT_4:
            self._axis.home()
        elif self.mode == codec.HOMING and falling & _BIT_4 and self._axis.homing() is Homing.UNDER_WAY:
            self._axis.brake()
        elif self.mode == codec.PROFILE_POSITION and rising & _BIT_4:
            self._plan(now_s)
        self._interpolates = bool(word & _BIT_4)
        self._acknowledged = bool(word & _BIT_4)

    def on_sync(self, now_s: float) -> None:
        """Take the new target."""
        if self.mode == codec.CYCLIC_SYNCHRONOUS_POSITION:
            self._follow(codec.TARGET_POSITION, 0, now_s)
        elif self.mode == codec.INTERPOLATED_POSITION and self._interpolates:
            self._follow(codec.INTERPOLATION_DATA, 1, now_s)

    def _follow(self, index: int, subindex: int, now_s: float) -> None:
        """Follow the setpoint; between two, the drive interpolates over its period and stands for the rest."""
        target = self._objects.value(index, subindex)
        velocity = float(self._objects.value(codec.VELOCITY_OFFSET))
        interval_s, self._sync_s = now_s - self._sync_s, now_s
        mapped = self._objects.value(codec.SETPOINT_PDO.mapping_index)
        if mapped < len(codec.SETPOINT_PDO.mapping) and self._previous is not None:
            period_s = self._period_s() or interval_s
            if period_s > 0.5 * interval_s:
                units = self._axis.units
                velocity = (target - self._previous) / max(period_s, interval_s)
                velocity *= (units.velocity or 0.0) / units.position
        self._previous = target
        deadline_ms = self._objects.value(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER)
        self._axis.follow(target, velocity, deadline_ms * 1e-3 if deadline_ms else math.inf)

    def _period_s(self) -> float:
        """Return the time over which the drive interpolates, s; 0 for one that has no such setting."""
        exponent = self._objects.value(codec.INTERPOLATION_PERIOD, 2)
        return float(self._objects.value(codec.INTERPOLATION_PERIOD, 1) * codec.power_of_ten(exponent))

    def advance(self, now_s: float, is_enabled: bool) -> None:
        """Take a requested mode that is due, advance along the profile."""
        requested = self._objects.value(codec.MODE)
        is_taken = is_enabled or not self._habits.mode_only_enabled
        if requested != self.mode and is_taken and now_s >= self._requested_s + self._habits.mode_lag_s:
            self._lingering, self._changed_s = self.statusword(now_s), now_s
            self.mode = requested
            if is_enabled:
                self.begin()
        if is_enabled and self._profile is not None:
            position, rate = self._profile.at(now_s)
            units = self._axis.units
            self._axis.follow(position[0], rate[0] * (units.velocity or 0.0) / units.position, math.inf)

    def statusword(self, now_s: float) -> int:
        """Return the bits that depend on the mode; after a change, those of the mode before may linger."""
        if now_s < self._changed_s + self._habits.bits_lag_s:
            return self._lingering
        if self.mode == codec.HOMING:
            at_rest = self._axis.homing() is Homing.DONE and not self._axis.moving()
            return _HOMING_WORD[self._axis.homing()] | codec.TARGET_REACHED * at_rest
        if self.mode == codec.PROFILE_POSITION:
            there = self._profile is not None and abs(self._axis.feedback()[0] - self._goal) <= _CLOSE_COUNTS
            return codec.SETPOINT_TAKEN * self._acknowledged | codec.TARGET_REACHED * there
        return _FOLLOWS

    def _plan(self, now_s: float) -> None:
        self._goal = self._objects.value(codec.TARGET_POSITION)
        units = self._axis.units
        per_s = units.position / (units.velocity or math.inf)  # the profile is in position units
        speed = np.array([per_s * self._objects.value(codec.PROFILE_VELOCITY)])
        acceleration = np.array([per_s * self._objects.value(codec.PROFILE_ACCELERATION)])
        start = np.array([float(self._axis.feedback()[0])])
        self._profile = ProfiledMove(start, np.array([float(self._goal)]), speed, acceleration, now_s)
