"""Modes of operation of an emulated CiA 402 drive that is enabled; counts and counts/s."""

from __future__ import annotations

import math

import numpy as np

from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.setpoint_limiter import ProfiledMove, compile_profile
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.objects import ObjectDictionary
from hil.parts.emulation.emulated_axes import EmulatedAxes

_BIT_4 = 0x10  # controlword bit: start
_FOLLOWS = 0x1000  # statusword in cyclic synchronous position: the drive follows the target
_CLOSE_COUNTS = 50
_HOMING_WORD = {
    Homing.NEEDED: codec.TARGET_REACHED,  # at rest, not commanded yet
    Homing.UNDER_WAY: 0,
    Homing.DONE: codec.HOMING_ATTAINED,
    Homing.FAILED: codec.TARGET_REACHED | codec.HOMING_ERROR,
}


class DriveAxis:
    """The axis ``axis`` of ``gimbals`` as its drive sees it; counts and counts/s."""

    def __init__(self, gimbals: EmulatedAxes, axis: int, counts_per_turn: int, clock: BenchClock) -> None:
        self._gimbals = gimbals
        self._axis = axis
        self._scale = counts_per_turn
        self._clock = clock

    def feedback(self) -> tuple[int, int]:
        """Return position and velocity."""
        position, rate = self._gimbals.position[self._axis], self._gimbals.rate[self._axis]
        return codec.counts_from_rad(position, self._scale), codec.counts_from_rad(rate, self._scale)

    def follow(self, target: int, velocity_offset: int, watchdog_s: float) -> None:
        """Move to ``target``; brake without another target within ``watchdog_s``."""
        position = codec.rad_from_counts(target, self._scale)
        rate = codec.rad_from_counts(velocity_offset, self._scale)
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
        return self._gimbals.limit[self._axis]

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
        return codec.counts_from_rad(window, self._scale), round(1e3 * time_s)

    def set_window(self, counts: float, time_out_ms: int) -> None:
        """Set them; inf: no supervision."""
        self._gimbals.window[self._axis] = counts * codec.rad_from_counts(1, self._scale)
        self._gimbals.window_s[self._axis] = 1e-3 * time_out_ms


class DriveMotion:
    """Motion of the enabled drive: setpoints, homing or profile, selected by object 0x6060."""

    def __init__(self, axis: DriveAxis, objects: ObjectDictionary) -> None:
        self._axis = axis
        self._objects = objects
        self._profile: ProfiledMove | None = None
        self._goal = 0
        self._acknowledged = False
        compile_profile()

    @property
    def mode(self) -> int:
        return self._objects.value(codec.MODE)

    def begin(self) -> None:
        """Hold the setpoint or the present position after enabling or a change of mode."""
        self._profile = None
        self._acknowledged = False
        if self.mode == codec.CYCLIC_SYNCHRONOUS_POSITION:
            self.follow()
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
        self._acknowledged = bool(word & _BIT_4)

    def on_sync(self) -> None:
        """Take the new target."""
        if self.mode == codec.CYCLIC_SYNCHRONOUS_POSITION:
            self.follow()

    def follow(self) -> None:
        deadline_ms = self._objects.value(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER)
        self._axis.follow(
            self._objects.value(codec.TARGET_POSITION),
            self._objects.value(codec.VELOCITY_OFFSET),
            deadline_ms * 1e-3 if deadline_ms else math.inf,
        )

    def advance(self, now_s: float) -> None:
        """Advance along the profile."""
        if self._profile is not None:
            position, rate = self._profile.at(now_s)
            self._axis.follow(round(position[0]), round(rate[0]), math.inf)

    def statusword(self) -> int:
        """Return the bits that depend on the mode."""
        if self.mode == codec.HOMING:
            at_rest = self._axis.homing() is Homing.DONE and not self._axis.moving()
            return _HOMING_WORD[self._axis.homing()] | codec.TARGET_REACHED * at_rest
        if self.mode == codec.PROFILE_POSITION:
            there = self._profile is not None and abs(self._axis.feedback()[0] - self._goal) <= _CLOSE_COUNTS
            return codec.SETPOINT_TAKEN * self._acknowledged | codec.TARGET_REACHED * there
        return _FOLLOWS

    def _plan(self, now_s: float) -> None:
        self._goal = self._objects.value(codec.TARGET_POSITION)
        speed = np.array([float(self._objects.value(codec.PROFILE_VELOCITY))])
        acceleration = np.array([float(self._objects.value(codec.PROFILE_ACCELERATION))])
        start = np.array([float(self._axis.feedback()[0])])
        self._profile = ProfiledMove(start, np.array([float(self._goal)]), speed, acceleration, now_s)
