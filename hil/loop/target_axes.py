"""Axes of the target or of another body: homing, placing, jogging, parking, stop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, Final

import numpy as np

from hil.bench import kinematics, stopping
from hil.bench.jog import Jog
from hil.config.rig import AxisGroupTable
from hil.core import alarm_table as table
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, Array, AxisFeedback, Homing, new
from hil.drivers.base import AxisGroup, Jogs, LimitsSetpoints
from hil.loop.bench_stage import BenchStage, Move
from hil.loop.rate_keeper import Tick
from hil.models.profile import along_smooth_line, duration
from hil.params import bench as bench_params
from hil.safety.packet_loss import SpeedCheck

FRACTION_OF_LIMITS: Final = Move.FRACTION_OF_LIMITS
_FOLLOWING: Final = replace(table.FOLLOWING_ERROR, digits=(3, 3), limit_digits=(3, 3))
_SETTLE_S: Final = 3.0  # allowed after the move until the axes are at their places
_SETTLED: Final = 0.001  # m or rad
_STEP_S: Final = 0.02  # until a jog begins


class TargetAxes:
    """Target or another body on axes, m or rad: placed before the run is armed; homed, jogged and parked as rails.

    first: of the six places of AXES and BENCH_PARAMS, that of the first axis.
    """

    jogs_before_homing: ClassVar[bool] = True

    def __init__(self, axes: AxisGroup, config: AxisGroupTable, position: Array, first: int = 0) -> None:
        self.axes = axes
        self.rotates = config.si_per_unit != 1.0
        """Whether they rotate, rad, rather than move along lines, m."""
        self.place_at = position
        """Position (n,) that ``place`` moves to."""
        limits, n = np.array([axis.limits for axis in config.axes]), len(position)
        self._smooth_s = np.array([axis.averaging_s for axis in config.axes])
        self._rate_max, self.acceleration_max, self._park_at = limits[:, 2], limits[:, 3], limits[:, 4]
        self.feedback = AxisFeedback(0.0, np.zeros(n), np.zeros(n), (Homing.NEEDED,) * n, (0,) * n)
        """From the last ``read``."""
        self._error_max, self._error_per_speed_s = config.si("following_error_max"), config.following_error_per_speed_s
        self._speeds = SpeedCheck(config.si("speed_mismatch_max"))
        self._config, self._places, self._jogged = config, slice(first, first + n), False
        self._motion, self._wanted, self._next = (
            kernel_record(new(kinematics.MOTION)),
            kernel_record(new(AXES)),
            kernel_record(new(AXES)),
        )
        self._limits = self._limits_of(_STEP_S)
        kinematics.limit_setpoint(self._limits, self._motion, self._wanted, self._next)  # loads the kernels of a jog
        stopping.brake_step(self._limits, self._motion, self._next)
        self._stand_at(position)

    def open(self, now_s: float) -> None:
        """Open the axes; they hold their positions. Raises DeviceError."""
        self.axes.open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed. Raises DeviceError."""
        self.axes.home(now_s)

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are. Raises SafetyTrip if homing has failed."""
        waiting = ""
        for name, state in zip(self.axes.axis_names, self.axes.read(now_s).homing, strict=True):
            if state is Homing.FAILED:
                raise table.HOMING.trip(name, "failed", "home switch found")
            waiting = waiting or ("" if state is Homing.DONE else name)
        return waiting

    def read(self, now_s: float) -> None:
        """Read the newest encoder values. Raises BenchError."""
        self.feedback = self.axes.read(now_s)

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move all axes slowly to the place and wait until they are at rest there. Raises BenchError.

        tick: waits for the next cycle, of period ``step_s``, s, and checks the bench.
        """
        self._move_to(self.place_at, tick, step_s, FRACTION_OF_LIMITS)

    def park(self, tick: Callable[[], Tick], step_s: float, rate_fraction: float) -> None:
        """Move all axes to their park positions, at most at ``rate_fraction`` of the limits; otherwise as ``place``."""
        self._move_to(self._park_at, tick, step_s, rate_fraction)

    def _move_to(self, goal: Array, tick: Callable[[], Tick], step_s: float, rate_fraction: float) -> None:
        now_s = tick().now_s
        feedback = self.axes.read(now_s)
        for name, homing in zip(self.axes.axis_names, feedback.homing, strict=True):
            if homing is not Homing.DONE:
                raise table.HOMING.trip(name, homing.name.lower().replace("_", " "), "done before a run")
        start, distance = feedback.position.copy(), goal - feedback.position
        self._stand_at(start)
        speeds, accelerations = rate_fraction * self._rate_max, FRACTION_OF_LIMITS * self.acceleration_max
        if isinstance(self.axes, LimitsSetpoints):
            self.axes.set_limits(Move.RESERVE * speeds, Move.RESERVE * accelerations)
        moved_s = 0.0
        limits = list(zip(np.abs(distance), speeds, accelerations, self._smooth_s, strict=True))
        duration_s = max(duration(length, speed, up, up) + smooth_s for length, speed, up, smooth_s in limits)
        position, motion, along = start.copy(), np.zeros(len(start)), np.empty(2)
        while moved_s <= duration_s or np.abs(self.feedback.position - goal).max() > _SETTLED:
            if moved_s > duration_s + _SETTLE_S:
                raise table.PLACE.trip(self.axes.name, "not reached", _SETTLE_S)
            for i, (length, speed, up, smooth_s) in enumerate(limits):
                along_smooth_line(length, speed, up, up, smooth_s, moved_s, along)
                position[i] = start[i] + math.copysign(along[0], distance[i])
                motion[i] = math.copysign(along[1], distance[i])
            self._expect(self.axes.send(position, motion, now_s), motion)
            now_s = tick().now_s
            self.read(now_s)
            self._check_following()
            moved_s += step_s  # a late cycle delays the move
        self.axes.send(goal, np.zeros(len(start)), now_s)

    def seed(self, now_s: float) -> None:
        """Seed the setpoints with the encoder positions, at rest."""
        self._stand_at(self.axes.read(now_s).position)
        if isinstance(self.axes, LimitsSetpoints):
            self.axes.set_limits(self._rate_max, self.acceleration_max)

    def begin_jog(self, axis: int, direction: int, rate_fraction: float, now_s: float, step_s: float) -> Jog:
        """Seed the setpoints; return a jog of ``axis``, 0..n - 1, in cycles of ``step_s``. ``end_jog`` ends it.

        Beyond the travel it may move back; one that is not homed has no limits of its travel, and a lower speed.
        """
        self._limits = self._limits_of(step_s)
        self.seed(now_s)
        self._jogged = True
        if isinstance(self.axes, Jogs):
            self.axes.set_jogging(True)
        homed, index = self.feedback.homing[axis] is Homing.DONE, self._places.start + axis
        return Jog(self._limits, index, direction, homed, self._motion.position, rate_fraction)

    def jog(self, jog: Jog, now_s: float) -> None:
        """Send the next setpoint of a jog while its key is pressed."""
        jog.aim(self._motion, self._wanted)
        kinematics.limit_setpoint(jog.params, self._motion, self._wanted, self._next)
        self._send(now_s)

    def end_jog(self) -> None:
        """Limit the setpoints to the travel again."""
        self._jogged = False
        if isinstance(self.axes, Jogs):
            self.axes.set_jogging(False)

    def brake(self, now_s: float) -> bool:
        """Send the next setpoint of a braking ramp; return whether it still moves."""
        moving = stopping.brake_step(self._limits, self._motion, self._next)
        self._send(now_s)
        return bool(moving)

    def check_motion(self) -> None:
        """Raise SafetyTrip if an axis, by the last ``read``, is too far from its setpoint or on a limit switch.

        In a jog a switch is respected by the jog itself: it may move off one.
        """
        self._check_following()
        for name, switch in zip(self.axes.axis_names, self.feedback.limit, strict=True):
            if switch and not self._jogged:
                raise table.LIMIT_SWITCH.trip(name, "low" if switch < 0 else "high", "none")

    def _check_following(self) -> None:
        """Raise SafetyTrip if an axis is too far from its setpoint, or moves otherwise than it reports."""
        error = np.abs(self.feedback.position - self._expected)
        allowed = self._error_max + self._error_per_speed_s * np.abs(self._expected_rate)
        worst = int(np.argmax(error - allowed))
        if not error[worst] <= allowed[worst]:
            name = self.axes.axis_names[worst]
            raise _FOLLOWING.trip(name, error[worst], allowed[worst], rotates=self.rotates)
        self._check_speeds()

    def _check_speeds(self) -> None:
        """Raise SafetyTrip if the reported speed of an axis is not the change of its position."""
        if (mismatch := self._speeds.update(self.feedback)) is not None:
            axis, reported, moved = mismatch
            raise table.SPEED.trip(self.axes.axis_names[axis], reported, moved, rotates=self.rotates)

    def check(self, now_s: float) -> None:
        """Raise SafetyTrip if an axis is not where it should be, DeviceError on failure."""
        raise NotImplementedError

    def relate(self, axes: np.record) -> None:
        """Replace positions of rails and turntable, AXES, by those relative to the target, if it moves in a run."""

    def check_apart(self, now_s: float, jogs: bool, setpoint: np.record, feedback: np.record) -> None:
        """Raise SafetyTrip if bodies that move with a target come too near to others in a motion outside a run.

        jogs: whether it is a jog, which may lead out of the distance. setpoint, feedback: AXES of rails and turntable.
        """

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record the axes at ``t_s`` of the run; of a target that moves in it with those of ``chaser``.

        run_zero_s: bench time of the run's time zero.
        """
        raise NotImplementedError

    def stop(self, now_s: float) -> None:
        """Stop the axes. Never raises."""
        self.axes.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of the axes off. Never raises."""
        self.axes.disable(now_s)

    def close(self) -> None:
        """Close the axes. Never raises."""
        self.axes.close()

    def _limits_of(self, step_s: float) -> np.record:
        """Return BENCH_PARAMS with the limits of the axes, for cycles of ``step_s``."""
        return kernel_record(bench_params.limits_of(self._config.axes, step_s, self._places.start))

    def _stand_at(self, position: Array) -> None:
        """Begin the next motion, and expect the axes, at ``position`` (n,)."""
        whole = np.zeros(6)
        whole[self._places] = position
        kinematics.start_motion(whole[:3], whole[3:], self._motion)
        self._speeds.restart()
        self._expect(position, np.zeros(len(position)))

    def _send(self, now_s: float) -> None:
        out = self._next
        position, rate = np.concatenate((out.rail_m, out.gimbal_rad)), np.concatenate((out.rail_mps, out.gimbal_radps))
        self._expect(self.axes.send(position[self._places], rate[self._places], now_s), rate[self._places])

    def _expect(self, accepted: Array, rate: Array) -> None:
        """Expect the axes where they are that follow the setpoint (n,) of ``rate`` by their leads late."""
        self._accepted, self._expected_rate = accepted, rate.copy()
        self._expected = accepted - self._limits.lead[self._places] * rate
