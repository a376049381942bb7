"""The bench as one stage of the cycle, and the slow move to a start pose."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hil.bench import kinematics, stopping
from hil.core.messages import AXES, Array, AxisFeedback, new
from hil.drivers.base import AxisGroup, Jogs, Parks
from hil.errors import DeviceError
from hil.models.profile import along_line, duration
from hil.safety.monitor import SafetyMonitor


class BenchStage:
    """Rails and turntable as one machine that carries the chaser's pose.

    emergency_input: gives, at a bench time, whether the emergency stop is pressed (None: unknown) and
    whether its reset is; None where the bench has no such input.
    """

    def __init__(
        self,
        rails: AxisGroup,
        turntable: AxisGroup,
        params: np.record,
        safety: SafetyMonitor,
        emergency_input: Callable[[float], tuple[bool | None, bool]] | None = None,
    ) -> None:
        self.rails = rails
        self.turntable = turntable
        self.params = params
        self.safety = safety
        self.axis_names = (*rails.axis_names, *turntable.axis_names)
        self.emergency_input = emergency_input
        self.motion = new(kinematics.MOTION)
        """Where the last setpoints are and how fast they went."""
        self.seen: tuple[AxisFeedback, AxisFeedback]
        """Of rails and turntable, as of the last ``read``."""
        self._wanted = new(AXES)
        self._before = new(AXES)
        self._commanded_s = math.nan
        self._next = new(AXES)
        self._next_arrays = tuple(self._next[name] for name in ("rail_m", "rail_mps", "gimbal_rad", "gimbal_radps"))
        self.limited_cycles = 0

    def open(self, now_s: float) -> None:
        """Open both devices; they hold where they stand. Raises SafetyTrip while the emergency stop holds."""
        self.poll_emergency_input(now_s)
        alarm = self.safety.interlock_open(now_s)
        if alarm is not None:
            raise alarm.trip()
        self.rails.open(now_s)
        self.turntable.open(now_s)

    def read(self, now_s: float, feedback: np.record) -> None:
        """Write the encoders' newest values into ``feedback`` (AXES)."""
        if self.emergency_input is not None:
            self.poll_emergency_input(now_s)
        rails = self.rails.read(now_s)
        turntable = self.turntable.read(now_s)
        self.seen = rails, turntable
        kinematics.write_axes(rails.position, rails.rate, turntable.position, turntable.rate, feedback)

    def sampled_s(self, zero_s: float) -> tuple[float, float]:
        """Return when rails and turntable had the values of the last ``read``, counted from bench time ``zero_s``."""
        rails, turntable = self.seen
        return rails.t_s - zero_s, turntable.t_s - zero_s

    def poll_emergency_input(self, now_s: float) -> None:
        """Tell the supervisor the levels of the emergency stop and of its reset, where the bench has them.

        Raises DeviceError where they cannot be read, which counts as pressed.
        """
        if self.emergency_input is None:
            return
        try:
            self.safety.estop.update(*self.emergency_input(now_s))
        except DeviceError:
            self.safety.estop.update(None)
            raise

    def check(self, now_s: float, feedback: np.record) -> None:
        """Let the supervisor look at what ``read`` found; raise SafetyTrip where it says stop."""
        alarm = self.safety.check(now_s, *self.seen, self._commanded_s, self._before, feedback)
        if alarm is not None:
            raise alarm.trip()

    def seed(self, now_s: float, feedback: np.record) -> None:
        """Make the encoders' positions the last setpoint, at rest: nothing jumps at the next command.

        Raises SafetyTrip where an axis moves. Whatever sets the bench in motion begins with this.
        """
        alarm = self.safety.interlock_seed(now_s, feedback)
        if alarm is not None:
            raise alarm.trip()
        rest = np.zeros(3)
        kinematics.write_axes(feedback.rail_m, rest, feedback.gimbal_rad, rest, self._before)
        kinematics.start_motion(feedback.rail_m, feedback.gimbal_rad, self.motion)
        self._commanded_s = math.nan

    def seed_for_run(self, now_s: float, feedback: np.record) -> None:
        """``seed``, where the axes are homed, within their travel and off their switches; SafetyTrip otherwise."""
        alarm = self.safety.interlock_motion(now_s, *self.seen, feedback)
        if alarm is not None:
            raise alarm.trip()
        self.seed(now_s, feedback)

    def axes_of(self, r_CT_H: Array, v_CT_H: Array, q_CH: Array, w_CH_C: Array, out: np.record) -> None:
        """Write the axes' positions and rates, unlimited, for a pose of the chaser."""
        kinematics.axes_of_pose(self.params, r_CT_H, v_CT_H, q_CH, w_CH_C, out)

    def follow(self, truth: np.record, w_CH_C: Array, now_s: float, setpoint: np.record) -> None:
        """Send the axes towards the pose in ``truth``; write what was accepted into ``setpoint``."""
        self.axes_of(truth.r_CT_H, truth.v_CT_H, truth.q_CH, w_CH_C, self._wanted)
        self.command(self._wanted, now_s, setpoint)

    def command(self, wanted: np.record, now_s: float, setpoint: np.record, params: np.record | None = None) -> None:
        """Send ``wanted`` (AXES), ahead by each axis' lead, cut to what travel, speed and acceleration allow.

        params: BENCH_PARAMS with other limits or leads, for a jog or a measurement.
        """
        limits = self.params if params is None else params
        if kinematics.limit_setpoint(limits, self.motion, wanted, self._next):
            self.limited_cycles += 1
        self._send(now_s, setpoint)

    def brake(self, now_s: float, setpoint: np.record, params: np.record | None = None) -> bool:
        """Send the next setpoint of the way to a stand; return whether one of the setpoints still moves."""
        moving = stopping.brake_step(self.params if params is None else params, self.motion, self._next)
        self._send(now_s, setpoint)
        return bool(moving)

    def _send(self, now_s: float, setpoint: np.record) -> None:
        rail_m, rail_mps, gimbal_rad, gimbal_radps = self._next_arrays
        rail_accepted = self.rails.send(rail_m, rail_mps, now_s)
        gimbal_accepted = self.turntable.send(gimbal_rad, gimbal_radps, now_s)
        kinematics.write_axes(rail_accepted, rail_mps, gimbal_accepted, gimbal_radps, setpoint)
        kinematics.write_axes(rail_accepted, rail_mps, gimbal_accepted, gimbal_radps, self._before)
        self._commanded_s = now_s

    def stands(self, now_s: float, feedback: np.record) -> bool:
        """Return whether all axes stand, by their encoders."""
        return self.safety.interlock_seed(now_s, feedback) is None

    def home(self, now_s: float) -> None:
        """Let each axis that does not know its place look for its switch."""
        self.rails.home(now_s)
        self.turntable.home(now_s)

    def set_jogging(self, on: bool) -> bool:
        """Let both devices take setpoints without a home and beyond their travel; False where one cannot."""
        able = isinstance(self.rails, Jogs) and isinstance(self.turntable, Jogs)
        for device in (self.rails, self.turntable):
            if able and isinstance(device, Jogs):
                device.set_jogging(on)
        return able

    def park_turntable(self, goal: np.record, now_s: float) -> None:
        """Let the turntable's drives go to ``goal`` (AXES) by their own profiles, where they have such."""
        if isinstance(self.turntable, Parks):
            self.turntable.move_to(goal.gimbal_rad, Move.FRACTION_OF_LIMITS * self.params.rate_max[3:], now_s)

    def stop(self, now_s: float) -> None:
        """Bring all axes to a stand; never raises."""
        self.rails.stop(now_s)
        self.turntable.stop(now_s)

    def close(self) -> None:
        """Let go of both devices; never raises."""
        self.rails.close()
        self.turntable.close()


class Move:
    """A slow move of all six axes from where they stand to a target, each with a trapezoidal speed."""

    FRACTION_OF_LIMITS = 0.5

    def __init__(self, params: np.record, start: np.record, target: np.record) -> None:
        self._start = np.concatenate([start.rail_m, start.gimbal_rad])
        self._way = np.concatenate([target.rail_m, target.gimbal_rad]) - self._start
        self._speed = self.FRACTION_OF_LIMITS * params.rate_max
        self._acceleration = self.FRACTION_OF_LIMITS * params.acceleration_max
        self.duration_s = max(
            duration(abs(way), speed, acceleration, acceleration)
            for way, speed, acceleration in zip(self._way, self._speed, self._acceleration, strict=True)
        )

    def at(self, t_s: float, out: np.record) -> None:
        """Write the axes (AXES) at ``t_s`` after the start of the move."""
        along = np.empty(3)
        for axis, way in enumerate(self._way):
            along_line(abs(way), self._speed[axis], self._acceleration[axis], self._acceleration[axis], t_s, along)
            sign = math.copysign(1.0, way)
            position, rate = self._start[axis] + sign * along[0], sign * along[1]
            if axis < 3:
                out.rail_m[axis], out.rail_mps[axis] = position, rate
            else:
                out.gimbal_rad[axis - 3], out.gimbal_radps[axis - 3] = position, rate
