"""Rotary manipulator in the closed loop: shows the relative rotation as far as its limits allow, in every cycle."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from hil.bench import kinematics, manipulator, stopping
from hil.bench.jog import Jog
from hil.bench.manipulator import ChaserMotion
from hil.config.rig import RotaryManipulator
from hil.core.kernel_record import kernel_record
from hil.core.manipulator_records import MANIPULATOR_SAMPLE
from hil.core.messages import AXES, Array, AxisFeedback, new
from hil.drivers.base import AxisGroup, Jogs, LimitsSetpoints
from hil.errors import SafetyTrip
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.bench_stage import BenchStage
from hil.loop.rate_keeper import Tick
from hil.loop.target_stage import TargetAxes


class RotatedTarget(TargetAxes):
    """Target on the gimbals of ``config``.

    params: MANIPULATOR. bench: BENCH_PARAMS of the chaser's rig. limits: BENCH_PARAMS with the limits of the gimbals.
    q_CH: (4,), attitude of the chaser at the start of a run.
    """

    def __init__(
        self,
        axes: AxisGroup,
        config: RotaryManipulator,
        params: np.record,
        bench: np.record,
        limits: np.record,
        q_CH: Array,
    ) -> None:
        super().__init__(axes, config, manipulator.start_angles(params, limits, q_CH))
        self.params = params
        self.feedback = AxisFeedback(0.0, np.zeros(3), np.zeros(3))
        """From the last ``read``."""
        self.sink: Telemetry = NoTelemetry()
        """Receives the physical axes in each cycle, as a row of MANIPULATOR_SAMPLE."""
        self._sample = np.zeros(1, MANIPULATOR_SAMPLE)
        self._accepted = self.place_at
        self._jogged = False
        self._bench, self._limits = bench, kernel_record(limits)
        self._error_max = math.radians(config.following_error_max_deg)
        self._error_per_speed_s = config.following_error_per_speed_s
        self._rest_radps = math.radians(config.speed_mismatch_max_degps)
        self._motion, self._wanted, self._next = (
            kernel_record(new(kinematics.MOTION)),
            kernel_record(new(AXES)),
            kernel_record(new(AXES)),
        )
        self._expected, self._expected_rate = self.place_at, np.zeros(3)
        self._largest = np.zeros((3, 3))  # angle, rate, following error

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move all axes slowly to the angles of the start pose and wait until they are at rest there."""
        super().place(tick, step_s)
        self._stand_at(self.place_at)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, roll, pitch and yaw."""
        return self.axes.axis_names

    def read(self, now_s: float) -> None:
        """Read the newest encoder values."""
        self.feedback = self.axes.read(now_s)

    def check(self, now_s: float) -> None:
        """Read the axes; raise SafetyTrip if one is too far from its setpoint, or, but in a jog, on a limit switch."""
        self.read(now_s)
        feedback = self.feedback
        error = np.abs(feedback.position - self._expected)
        allowed = self._error_max + self._error_per_speed_s * np.abs(self._expected_rate)
        worst = int(np.argmax(error - allowed))
        if not error[worst] <= allowed[worst]:
            value, limit = (f"{math.degrees(each[worst]):.3f} deg" for each in (error, allowed))
            raise SafetyTrip(self.axes.axis_names[worst], "following error", value, limit)
        for name, switch in zip(self.axes.axis_names, feedback.limit, strict=True):
            if switch and not self._jogged:  # a jog respects it by itself: it may move off one
                raise SafetyTrip(name, "limit switch", "low" if switch < 0 else "high", "none")
        np.maximum(self._largest, np.abs([feedback.position, feedback.rate, error]), out=self._largest)

    def relate(self, axes: np.record) -> None:
        """Replace positions of rails and turntable, AXES, by those relative to the target, by its encoders."""
        self._relate(axes, self.feedback.position)

    def relate_setpoint(self, axes: np.record) -> None:
        """``relate`` for setpoints, of the last cycle."""
        self._relate(axes, self._expected)

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Send the last setpoints of all axes, and the encoders that this cycle has read, to the sink."""
        row, (rails, turntable) = self._sample, chaser.feedback
        row["t_s"], row["sampled_s"] = t_s, self.feedback.t_s - run_zero_s
        row["setpoint"]["angle_rad"], row["setpoint"]["rate_radps"] = self._accepted, self._expected_rate
        row["feedback"]["angle_rad"], row["feedback"]["rate_radps"] = self.feedback.position, self.feedback.rate
        row["chaser_setpoint"] = chaser.accepted
        seen = row["chaser_feedback"]
        seen["rail_m"], seen["rail_mps"] = rails.position, rails.rate
        seen["gimbal_rad"], seen["gimbal_radps"] = turntable.position, turntable.rate
        self.sink.put(row)

    def numbers(self) -> dict[str, Any]:
        """Return the largest angles, rates and following errors of roll, pitch and yaw, for the JSON."""
        names = ("angle_max_deg", "rate_max_degps", "following_error_max_deg")
        return {name: np.degrees(row).tolist() for name, row in zip(names, self._largest, strict=True)}

    def seed(self, now_s: float) -> None:
        """Seed the setpoints with the encoder positions, at rest."""
        self._stand_at(self.axes.read(now_s).position)
        if isinstance(self.axes, LimitsSetpoints):
            self.axes.set_limits(self._limits.rate_max[3:], self._limits.acceleration_max[3:])

    def shown_at_rest(self, r_CT_H: Array, q_CH: Array) -> ChaserMotion:
        """Return what the chaser's rig has to show of a pose at rest, with the manipulator at its place."""
        rest = np.zeros(3)
        return manipulator.shown_motion(self.params, self.place_at, rest, ChaserMotion(r_CT_H, rest, q_CH, rest))

    def follow(self, relative: ChaserMotion, now_s: float) -> ChaserMotion:
        """Send the next setpoint on the way to the motion relative to the target at the end of this cycle.

        Returns what is left for the chaser's rig: the motion in L.
        """
        wanted, out = self._wanted, self._next
        wanted.gimbal_rad, wanted.gimbal_radps = manipulator.wanted_angles(
            self.params, relative.q, relative.w, self._motion.position[3:]
        )
        kinematics.limit_setpoint(self._limits, self._motion, wanted, out)
        self._send(now_s)
        return manipulator.shown_motion(self.params, self._expected, self._expected_rate, relative)

    def begin_jog(self, axis: int, direction: int, rate_fraction: float) -> Jog:
        """Return a jog of ``axis``, 0..2, from the last ``seed``; beyond the travel it may move back."""
        self._jogged = True
        if isinstance(self.axes, Jogs):
            self.axes.set_jogging(True)
        return Jog(self._limits, 3 + axis, direction, True, self._motion.position, rate_fraction)

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

    def at_rest(self, now_s: float) -> bool:
        """Return whether the axes are at rest according to their encoders."""
        return bool(np.abs(self.axes.read(now_s).rate).max() <= self._rest_radps)

    def _stand_at(self, position: Array) -> None:
        """Begin the next motion, and expect the axes, at ``position`` (3,)."""
        kinematics.start_motion(np.zeros(3), position, self._motion)
        self._accepted = self._expected = position
        self._expected_rate = np.zeros(3)

    def _send(self, now_s: float) -> None:
        out = self._next
        accepted = self.axes.send(out.gimbal_rad, out.gimbal_radps, now_s)
        self._expected_rate = out.gimbal_radps.copy()
        # an axis that follows its setpoint ``lead`` late is there
        self._accepted = accepted
        self._expected = accepted - self._limits.lead[3:] * self._expected_rate

    def _relate(self, axes: np.record, target_rad: Array) -> None:
        axes.rail_m, axes.gimbal_rad = manipulator.relative_axes(
            self._bench, self.params, axes.rail_m, axes.gimbal_rad, target_rad
        )
