"""Bench stage of the cycle: rails and turntable as one six-axis machine, and slow moves between poses."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final, NamedTuple, Protocol

import numpy as np

from hil.bench import kinematics, stopping
from hil.bench.bench_guard import BENCH_GUARD_MEMORY
from hil.bench.guard import NOTHING
from hil.bench.manipulator import ChaserMotion
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, Array, AxisFeedback, new
from hil.drivers.base import AxisGroup, Jogs, LimitsSetpoints, Parks
from hil.dynamics.truth import rate_against_hill
from hil.errors import DeviceError
from hil.loop import core
from hil.loop.core_memory import CoreMemory
from hil.models.profile import along_line, duration
from hil.safety.monitor import SafetyMonitor
from hil.safety.motion_guards import breach_alarm


class SafetyInputs(NamedTuple):
    """Inputs of the bench, None for one that it does not have.

    emergency: returns, for a bench time, the levels of the emergency stop (None: unknown) and of its reset.
    local_enable: returns the level of the local enabling input.
    """

    emergency: Callable[[float], tuple[bool | None, bool]] | None = None
    local_enable: Callable[[float], bool] | None = None


NO_INPUTS: Final = SafetyInputs()


class MovesTarget(Protocol):
    """Axes that move the target in a run, see ``hil.loop.target_stage``. params: MANIPULATOR."""

    params: np.record
    feedback: AxisFeedback

    def seed(self, now_s: float) -> None: ...
    def shown_at_rest(self, r_CT_H: Array, q_CH: Array) -> ChaserMotion: ...
    def follow(self, relative: ChaserMotion, now_s: float) -> ChaserMotion: ...
    def relate_setpoint(self, axes: np.record) -> None: ...
    def brake(self, now_s: float) -> bool: ...
    def at_rest(self, now_s: float) -> bool: ...


class BenchStage:
    """Rails and turntable as one machine that realises the chaser's pose.

    memory: of the core, whose records of encoders and setpoints this stage writes. manipulator: of the target, which
    moves with the chaser's rig; None if the target stands still. inputs: for the safety monitor.
    """

    can_hold = True
    """Whether a run can be held: braked axes stand."""

    def __init__(
        self,
        rails: AxisGroup,
        turntable: AxisGroup,
        memory: CoreMemory,
        safety: SafetyMonitor,
        manipulator: MovesTarget | None = None,
        inputs: SafetyInputs = NO_INPUTS,
    ) -> None:
        self.rails = rails
        self.turntable = turntable
        self.safety = safety
        self.axis_names = (*rails.axis_names, *turntable.axis_names)
        self.emergency_input, self.local_enable = inputs
        self.manipulator = manipulator
        self.feedback: tuple[AxisFeedback, AxisFeedback]
        """Of rails and turntable, from the last ``read``."""
        self.commanded_s = math.nan
        """Bench time at which the last setpoint was sent; nan if none was sent since ``seed``."""
        self._params, self._state, self._now = memory.params, memory.state, memory.now
        self.params = kernel_record(memory.params.bench)
        self.ticks = int(memory.params.ticks)
        self.motion, self.wanted, self.accepted, self._next, self._guard_memory = (
            memory.view(name) for name in ("motion", "wanted", "accepted", "next", "bench_guard")
        )
        self._next_arrays = tuple(self._next[name] for name in ("rail_m", "rail_mps", "gimbal_rad", "gimbal_radps"))
        self._left = kernel_record(new(AXES))  # of the last demanded pose, what the manipulator leaves
        self._related = kernel_record(new(AXES))  # ``wanted`` of the last cycle, nan before the first
        self._rate = np.empty(3)
        self._limits = self.params
        """BENCH_PARAMS with the limits that the devices have for catching up."""

    @property
    def tick(self) -> int:
        """Tick of the last cycle that comes next; 0: all have run."""
        return int(self._state["tick"])

    @property
    def limited_cycles(self) -> int:
        """Setpoints that were limited."""
        return int(self._state["limited"])

    def open(self, now_s: float) -> None:
        """Open both devices; they hold their positions. Raises SafetyTrip while ``interlock_power`` forbids it."""
        self.poll_safety_inputs(now_s)
        alarm = self.safety.interlock_power(now_s)
        if alarm is not None:
            raise alarm.trip()
        self._limits = self.params
        self.rails.open(now_s)
        self.turntable.open(now_s)

    def read(self, now_s: float) -> None:
        """Write the newest encoder values into the present row."""
        if self.emergency_input is not None:
            self.poll_safety_inputs(now_s)
        rails = self.rails.read(now_s)
        turntable = self.turntable.read(now_s)
        self.feedback = rails, turntable
        kinematics.write_axes(rails.position, rails.rate, turntable.position, turntable.rate, self._now.feedback)

    def sampled_s(self, zero_s: float) -> tuple[float, float]:
        """Return the sampling times of the last ``read``, rails and turntable, relative to bench time ``zero_s``."""
        rails, turntable = self.feedback
        return rails.t_s - zero_s, turntable.t_s - zero_s

    def poll_safety_inputs(self, now_s: float) -> None:
        """Update the safety monitor with emergency stop, its reset and local enabling input, if the bench has them.

        Raises DeviceError if they cannot be read, which counts as pressed.
        """
        if self.emergency_input is None:
            return
        try:
            self.safety.estop.update(*self.emergency_input(now_s))
            if self.local_enable is not None:
                self.safety.locally_enabled = self.local_enable(now_s)
        except DeviceError:
            self.safety.estop.update(None)
            raise

    def check(self, now_s: float) -> None:
        """Run the safety checks on the last ``read``; raise SafetyTrip if one fails."""
        alarm = self.safety.check(now_s, *self.feedback, self.commanded_s, self.accepted, self._now.feedback)
        if alarm is not None:
            raise alarm.trip()

    def guard(self, bench_s: float, run_zero_s: float) -> None:
        """Run the bench guard's checks at the start of a cycle; raise SafetyTrip if a limit is violated.

        run_zero_s: bench time of the run's time zero.
        """
        sampled_s = self._now.sampled_s
        sampled_s[0, 0], sampled_s[0, 1] = self.sampled_s(run_zero_s)
        code = core.guard_bench(self._params, self._state, bench_s - run_zero_s)
        if code != NOTHING:
            raise breach_alarm(bench_s, self.axis_names, int(code), self._state.breach).trip()

    def seed(self, now_s: float) -> None:
        """Seed the setpoints with the encoder positions, at rest, so that the next command causes no jump.

        Raises SafetyTrip if an axis moves. Every motion starts with this.
        """
        feedback, state = self._now.feedback, self._state
        alarm = self.safety.interlock_seed(now_s, feedback)
        if alarm is not None:
            raise alarm.trip()
        rest = np.zeros(3)
        kinematics.write_axes(feedback.rail_m, rest, feedback.gimbal_rad, rest, self.accepted)
        kinematics.start_motion(feedback.rail_m, feedback.gimbal_rad, self.motion)
        self.commanded_s = math.nan
        state.tick, state.span.known, state.limited_in_row = 0, 0, 0
        np.asarray(self._guard_memory)[...] = np.zeros((), BENCH_GUARD_MEMORY)
        if self.manipulator is not None:
            self._related.rail_m = self._related.gimbal_rad = math.nan
            self.manipulator.seed(now_s)

    def seed_for_run(self, now_s: float) -> None:
        """``seed`` if all axes are homed, within their travel and off their limit switches; SafetyTrip otherwise."""
        alarm = self.safety.interlock_motion(now_s, *self.feedback, self._now.feedback)
        if alarm is not None:
            raise alarm.trip()
        self.seed(now_s)

    def axes_of(self, r_CT_H: Array, v_CT_H: Array, q_CH: Array, w_CH_C: Array, out: np.record) -> None:
        """Write the axis positions and rates, without limits, for a pose of the chaser."""
        kinematics.axes_of_pose(self.params, r_CT_H, v_CT_H, q_CH, w_CH_C, out)

    def start_axes(self, truth: np.record, out: np.record) -> None:
        """Write the axis positions (AXES), at rest, of the start pose in ``truth``."""
        r, q, rest = truth.r_CT_H, truth.q_CH, np.zeros(3)
        if self.manipulator is not None:
            shown = self.manipulator.shown_at_rest(r, q)
            r, q = shown.r, shown.q
        self.axes_of(r, rest, q, rest, out)

    def follow(self, now_s: float) -> None:
        """Send the first setpoint on the way to the truth's pose at the end of this cycle, for which ``core.aim``."""
        if self.manipulator is None:
            self.follow_on(now_s)
            return
        truth = self._now.truth
        rate_against_hill(truth, self._rate)
        remaining = self.manipulator.follow(
            ChaserMotion(truth.r_CT_H, truth.v_CT_H, truth.q_CH, self._rate, truth.t_s), now_s
        )
        self.axes_of(remaining.r, remaining.v, remaining.q, remaining.w, self._left)
        self.command(self._left, now_s)
        self.manipulator.relate_setpoint(self._now.setpoint)
        if self.params.reduced:
            self._want_what_is_left()

    def _want_what_is_left(self) -> None:
        """Make ``wanted`` what manipulator and chaser's rig together show, if this has fixed axes."""
        assert self.manipulator is not None
        wanted, before = self.wanted, self._related
        np.asarray(wanted)[...] = self._left
        self.manipulator.relate_setpoint(wanted)
        for position, rate in (("rail_m", "rail_mps"), ("gimbal_rad", "gimbal_radps")):
            change = (wanted[position] - before[position]) / self.params.dt_s
            wanted[rate] = np.where(np.isfinite(change), change, 0.0)
        np.asarray(before)[...] = wanted

    def follow_on(self, now_s: float) -> None:
        """Send the setpoint of the present tick of the cycle: where the axes have to be at the next one."""
        if self._limits is not self.params:
            self._set_limits(self.params)
        core.next_setpoint(self._params, self._state)
        self._send(now_s)
        core.next_tick(self._params, self._state)

    def command(self, target: np.record, now_s: float, params: np.record | None = None) -> None:
        """Send ``target`` (AXES), advanced by each axis' lead, limited in travel, speed and acceleration.

        params: BENCH_PARAMS with other limits or leads, for a jog or a measurement.
        """
        limits = self.params if params is None else params
        if limits is not self._limits:
            self._set_limits(limits)
        core.limit_setpoint(limits, self._state, target)
        self._send(now_s)

    def send(self, setpoint: np.record, now_s: float) -> None:
        """Send ``setpoint`` (AXES), which is within the limits."""
        np.asarray(self._next)[...] = setpoint
        self._send(now_s)

    def brake(self, now_s: float, params: np.record | None = None) -> bool:
        """Send the next setpoint of a braking ramp; return whether a setpoint still moves."""
        limits = self.params if params is None else params
        if limits is not self._limits:
            self._set_limits(limits)
        moving = bool(stopping.brake_step(limits, self.motion, self._next))
        self._send(now_s)
        return (self.manipulator is not None and self.manipulator.brake(now_s)) or moving

    def _set_limits(self, limits: np.record) -> None:
        """Set the limits within which the axes catch up after a gap, from BENCH_PARAMS."""
        self._limits = limits
        for device, axes in ((self.rails, slice(0, 3)), (self.turntable, slice(3, 6))):
            if isinstance(device, LimitsSetpoints):
                device.set_limits(limits.rate_max[axes], limits.acceleration_max[axes])

    def _send(self, now_s: float) -> None:
        rail_m, rail_mps, gimbal_rad, gimbal_radps = self._next_arrays
        rail_accepted = self.rails.send(rail_m, rail_mps, now_s)
        gimbal_accepted = self.turntable.send(gimbal_rad, gimbal_radps, now_s)
        core.accept(self._state, rail_accepted, gimbal_accepted)
        self.commanded_s = now_s

    def at_rest(self, now_s: float) -> bool:
        """Return whether all axes are at rest according to their encoders."""
        still = self.safety.interlock_seed(now_s, self._now.feedback) is None
        return still and (self.manipulator is None or self.manipulator.at_rest(now_s))

    def home(self, now_s: float) -> None:
        """Start homing of each axis that needs it."""
        self.rails.home(now_s)
        self.turntable.home(now_s)

    def set_jogging(self, on: bool) -> bool:
        """Allow setpoints before homing and beyond the travel; return False if a device does not support it."""
        if not (isinstance(self.rails, Jogs) and isinstance(self.turntable, Jogs)):
            return False
        self.rails.set_jogging(on)
        self.turntable.set_jogging(on)
        return True

    def park_turntable(self, target: np.record, now_s: float) -> None:
        """Move the turntable to ``target`` (AXES) by its drives' own profiles, if they have them.

        These have no limit of the jerk: axes with one are moved by setpoints.
        """
        if isinstance(self.turntable, Parks) and self.params.averaged[3:].max() < 2:
            rate = self.safety.limits.parking_rate_fraction * self.params.rate_max[3:]
            self.turntable.move_to(target.gimbal_rad, rate, now_s)

    def stop(self, now_s: float) -> None:
        """Stop all axes; never raises."""
        self.rails.stop(now_s)
        self.turntable.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all axes off; never raises."""
        self.rails.disable(now_s)
        self.turntable.disable(now_s)

    def close(self) -> None:
        """Close both devices; never raises."""
        self.rails.close()
        self.turntable.close()


class Move:
    """Slow move of all six axes from start to target, each with a trapezoidal speed profile.

    limits: BENCH_PARAMS with the limits of the move, slightly above its profile: an axis that is behind can catch up.
    """

    FRACTION_OF_LIMITS = 0.5
    RESERVE = 1.1

    def __init__(
        self, params: np.record, start: np.record, target: np.record, rate_fraction: float = FRACTION_OF_LIMITS
    ) -> None:
        self._start = np.concatenate([start.rail_m, start.gimbal_rad])
        self._distance = np.concatenate([target.rail_m, target.gimbal_rad]) - self._start
        self._speed = rate_fraction * params.rate_max
        self._acceleration = self.FRACTION_OF_LIMITS * params.acceleration_max
        self.limits = kernel_record(params.copy())
        self.limits.rate_max = np.minimum(self.RESERVE * self._speed, params.rate_max)
        self.limits.acceleration_max = np.minimum(self.RESERVE * self._acceleration, params.acceleration_max)
        for axis in range(6):  # a move may be late by the limit of the jerk, but not beyond its end
            self.limits.lead[axis] -= kinematics.averaging_delay(params, axis)
        self.duration_s = max(
            duration(abs(distance), speed, acceleration, acceleration)
            for distance, speed, acceleration in zip(self._distance, self._speed, self._acceleration, strict=True)
        )

    def at(self, t_s: float, out: np.record) -> None:
        """Write the axes (AXES) at ``t_s`` after the start of the move."""
        along = np.empty(3)
        for axis, distance in enumerate(self._distance):
            along_line(abs(distance), self._speed[axis], self._acceleration[axis], self._acceleration[axis], t_s, along)
            sign = math.copysign(1.0, distance)
            position, rate = self._start[axis] + sign * along[0], sign * along[1]
            if axis < 3:
                out.rail_m[axis], out.rail_mps[axis] = position, rate
            else:
                out.gimbal_rad[axis - 3], out.gimbal_radps[axis - 3] = position, rate
