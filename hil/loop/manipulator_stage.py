"""Rotary manipulator in the closed loop: shows the relative rotation as far as its limits allow, in every cycle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hil.bench import kinematics, manipulator
from hil.bench.manipulator import ChaserMotion
from hil.config.rig import RotaryManipulator
from hil.core.kernel_record import kernel_record
from hil.core.manipulator_records import MANIPULATOR_SAMPLE
from hil.core.messages import Array
from hil.drivers.base import AxisGroup
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.bench_stage import BenchStage
from hil.loop.rate_keeper import Tick
from hil.loop.target_axes import TargetAxes


class RotatedTarget(TargetAxes):
    """Target on the gimbals of ``config``.

    params: MANIPULATOR. bench: BENCH_PARAMS of the chaser's rig. limits: BENCH_PARAMS with the limits of the gimbals.
    q_CH: (4,), attitude of the chaser at the start of a run.
    """

    jogs_before_homing = False

    def __init__(
        self,
        axes: AxisGroup,
        config: RotaryManipulator,
        params: np.record,
        bench: np.record,
        limits: np.record,
        q_CH: Array,
    ) -> None:
        self._given = kernel_record(limits)
        super().__init__(axes, config, manipulator.start_angles(params, limits, q_CH), first=3)
        self.params = params
        self.sink: Telemetry = NoTelemetry()
        """Receives the physical axes in each cycle, as a row of MANIPULATOR_SAMPLE."""
        self._sample = np.zeros(1, MANIPULATOR_SAMPLE)
        self._bench, self._rest_radps = bench, config.si("speed_mismatch_max")
        self._largest = np.zeros((3, 3))  # angle, rate, following error

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move all axes slowly to the angles of the start pose and wait until they are at rest there."""
        super().place(tick, step_s)
        self._stand_at(self.place_at)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes, roll, pitch and yaw."""
        return self.axes.axis_names

    def park(self, tick: Callable[[], Tick], step_s: float, rate_fraction: float) -> None:
        """Stand: the target is left as it is."""

    def check(self, now_s: float) -> None:
        """Read the axes; raise SafetyTrip if one is too far from its setpoint, or, but in a jog, on a limit switch."""
        self.read(now_s)
        self.check_motion()
        feedback, error = self.feedback, np.abs(self.feedback.position - self._expected)
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

    def at_rest(self, now_s: float) -> bool:
        """Return whether the axes are at rest according to their encoders."""
        return bool(np.abs(self.axes.read(now_s).rate).max() <= self._rest_radps)

    def _limits_of(self, step_s: float) -> np.record:
        return self._given

    def _relate(self, axes: np.record, target_rad: Array) -> None:
        axes.rail_m, axes.gimbal_rad = manipulator.relative_axes(
            self._bench, self.params, axes.rail_m, axes.gimbal_rad, target_rad
        )
