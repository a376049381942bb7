"""Stages of a cycle whose vehicle floats: the truth is the pose that is measured, and no axis has a drive.

The axes of the records are those that would show the truth, so that guards and displays see the measured pose.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

import numpy as np

from hil.bench import bench_guard, keep_out, kinematics
from hil.config.tables.floating import Floating
from hil.core import alarm_table as table
from hil.core.kernel_record import kernel_record
from hil.core.messages import POSITION_ONLY, Array
from hil.core.modes import Mode
from hil.drivers.base import AxisGroup, PoseSource
from hil.dynamics.floating import carry_on, fit_rates
from hil.dynamics.thrusters import propellant_flow
from hil.dynamics.truth import rate_against_hill
from hil.errors import DeviceError
from hil.frmn.ring import Telemetry
from hil.loop import core
from hil.loop.bench_stage import BenchStage, SafetyInputs
from hil.loop.core_memory import CoreMemory
from hil.loop.safety_io_stage import SafetyIo
from hil.loop.stages import DssStage, FrameUsed, VisionStage
from hil.maths import linear, quat
from hil.maths.random_streams import NormalRows
from hil.safety.monitor import SafetyMonitor
from hil.safety.motion_guards import breach_alarm
from hil.sensors.vision_unit.pose import largest_sigmas, position_in_h

_KEEP_OUT: Final = (keep_out.KEEP_OUT, keep_out.PLANE, bench_guard.BODIES_MEET)


class MeasuredTruth:
    """Truth by the poses of a vision unit, of ``rate_hz``, in the plane: the newest pose, moved on by fitted rates.

    ``begin`` before each run. Before its first pose the vehicle counts as having moved as at the start of the plan.
    Mass and open valves are by the commands.
    """

    def __init__(self, memory: CoreMemory, settings: Floating, rate_hz: float) -> None:
        self._memory, self._settings, self._truth = memory, settings, memory.now.truth
        n = math.ceil(settings.rate_window_s * rate_hz) + 1
        self._t_s, self._r, self._q = np.zeros(n), np.zeros((n, 3)), np.zeros((n, 4))
        self._v, self._w, self._n, self._rate_hz = np.zeros(3), np.zeros(3), 0, rate_hz
        self._sigma_m = self._sigma_rad = 0.0

    def bench(
        self, axes: tuple[AxisGroup, AxisGroup, CoreMemory, SafetyMonitor], inputs: SafetyInputs, lines: SafetyIo
    ) -> FloatingBench:
        """Return the stage of the bench whose axes are those of this pose."""
        return FloatingBench(axes, inputs, lines, self)

    def vision(
        self,
        source: PoseSource,
        memory: CoreMemory,
        on_frame_used: FrameUsed | None = None,
        frame_sink: Telemetry | None = None,
    ) -> MeasuredVision:
        """Return the stage of the vision unit whose poses are this truth."""
        stage = MeasuredVision(source, memory, on_frame_used, frame_sink)
        stage.truth = self
        return stage

    def dss(self, memory: CoreMemory, field: Array, imu_noise: NormalRows) -> FloatingDss:
        """Return the stage that predicts this truth."""
        return FloatingDss(self, memory, field, imu_noise)

    def begin(self) -> None:
        """Forget all poses: until the first one the truth is the start of the plan."""
        self._n = 0
        self._sigma_m = self._sigma_rad = 0.0

    def update(self, poses: np.ndarray, t_s: float) -> None:
        """Take ``poses``, (n,) of POSE, and write the truth at ``t_s`` of the run.

        Raises SafetyTrip if the first pose is not at the start of the plan, or if there is none for too long.
        """
        taken = 0
        for pose in poses.view(np.recarray):
            is_whole = pose.status != POSITION_ONLY and bool(np.isfinite([*pose.z_TC_C, *pose.q_CH, pose.t_s]).all())
            if is_whole and not (self._n and pose.t_s <= self._t_s[0]):
                self._take(pose)
                taken += 1
        newest_s = float(self._t_s[0]) if self._n else 0.0
        if t_s - newest_s > self._settings.pose_lost_s:
            raise table.MEASURED_POSE.trip(self._settings.pose, t_s - newest_s, self._settings.pose_lost_s)
        if taken:
            n = int(np.count_nonzero(newest_s - self._t_s[: self._n] <= self._settings.rate_window_s))
            fit_rates(self._t_s, self._r, self._q, n, self._v, self._w)
        self.write(t_s)

    def _take(self, pose: np.record) -> None:
        for kept in (self._t_s, self._r, self._q):
            kept[1:] = kept[:-1].copy()
        self._t_s[0], self._q[0] = pose.t_s, pose.q_CH
        position_in_h(pose, self._r[0])
        if self._n == 0:
            self._require_start(self._r[0], self._q[0])
            self._fill()
        sigma_m, sigma_rad = largest_sigmas(pose)
        self._sigma_m, self._sigma_rad = max(self._sigma_m, sigma_m), max(self._sigma_rad, sigma_rad)

    def _fill(self) -> None:
        """Let the motion of the start of the plan lead to the first pose."""
        self._n, w = len(self._t_s), np.empty(3)
        rate_against_hill(self._truth, w)
        for k in range(1, self._n):
            before_s = k / self._rate_hz
            self._t_s[k] = self._t_s[0] - before_s
            self._r[k] = self._r[0] - before_s * self._truth.v_CT_H
            self._q[k] = quat.multiply(quat.from_rotation_vector(-before_s * w), self._q[0])

    def _require_start(self, r_CT_H: Array, q_CH: Array) -> None:
        off_m = linear.length(r_CT_H - self._truth.r_CT_H)
        turn = np.empty(3)
        quat.rotation_between(q_CH, np.array(self._truth.q_CH), turn)
        off_deg = math.degrees(linear.length(turn))
        limit_m, limit_deg = self._settings.start_error_max_m, self._settings.start_error_max_deg
        if not off_m <= limit_m:
            raise table.START_POSE.trip("vehicle", f"{off_m:.3f} m from the plan", f"{limit_m:g} m")
        if not off_deg <= limit_deg:
            raise table.START_POSE.trip("vehicle", f"{off_deg:.2f} deg from the plan", f"{limit_deg:g} deg")

    def write(self, t_s: float) -> None:
        """Write the truth at ``t_s``: the newest pose in the plane, moved on; the start before the first one."""
        self._truth.t_s = t_s
        if self._n:
            carry_on(self._r[0], self._q[0], self._v, self._w, t_s - float(self._t_s[0]), self._truth)

    def numbers(self) -> dict[str, Any]:
        """Return for JSON who measures the truth, and the largest sigmas: as reported, and of the fitted rates."""
        window_s, sigma_deg = self._settings.rate_window_s, math.degrees(self._sigma_rad)
        per_window = math.sqrt(12.0 / len(self._t_s)) / window_s  # of a line through equally spaced poses
        return {
            "measured_by": self._settings.pose,
            "sigma_m": self._sigma_m,
            "sigma_deg": sigma_deg,
            "sigma_mps": per_window * self._sigma_m,
            "sigma_degps": per_window * sigma_deg,
            "rate_window_s": window_s,
        }


class MeasuredVision(VisionStage):
    """Vision whose poses are the truth as well."""

    truth: MeasuredTruth

    def receive(self, bench_s: float) -> None:
        """Receive poses, and write the truth of the present cycle. Raises SafetyTrip, see ``MeasuredTruth.update``."""
        super().receive(bench_s)
        self.truth.update(self.poses[: self.arrived], bench_s - float(self._state.zero_s))


class FloatingDss(DssStage):
    """Prediction of the truth to the next cycle, in place of its simulation; there is no IMU."""

    def __init__(self, truth: MeasuredTruth, memory: CoreMemory, field: Array, imu_noise: NormalRows) -> None:
        super().__init__(memory, field, imu_noise)
        self._truth, self._now = truth, memory.now
        self._dss = kernel_record(memory.params.dss)

    def step(self, k: int) -> None:
        """Predict the truth at the end of cycle ``k``."""
        truth, dss, step_s = self._now.truth, self._dss, float(self._params.step_s)
        truth.thrust_fraction[: dss.n_thrusters] = self._now.command.on[: dss.n_thrusters]
        if dss.mass_loss:
            flow = propellant_flow(truth.thrust_fraction, dss.thruster_force, dss.exhaust_speed, dss.n_thrusters)
            truth.mass_kg -= step_s * flow
        self._truth.write((k + 1) * step_s)
        core.aim(self._params, self._state)


class FloatingBench(BenchStage):
    """Bench without drives, whose axes are those of the measured pose. What stops it closes all valves.

    A chaser that would enter the keep-out is not stopped by closed valves: ``order_abort`` brakes it, once; within the
    keep-out the valves close. lines: of the thrusters. safety, inputs: see ``BenchStage``.
    """

    can_hold = False

    def __init__(
        self,
        axes: tuple[AxisGroup, AxisGroup, CoreMemory, SafetyMonitor],
        inputs: SafetyInputs,
        lines: SafetyIo,
        truth: MeasuredTruth,
    ) -> None:
        super().__init__(*axes, inputs=inputs)
        self._lines, self._truth = lines, truth
        self._aborted = False
        self.order_abort: Callable[[], None] = lambda: None

    def read(self, now_s: float) -> None:
        """Write the axes of the truth, predicted to this cycle, into the present row; at rest unless it runs."""
        super().read(now_s)
        truth, feedback = self._now.truth, self._now.feedback
        rate_against_hill(truth, self._rate)
        moves = 1.0 if self.safety.modes.mode is Mode.RUNNING else 0.0
        v, w = moves * truth.v_CT_H, moves * self._rate
        kinematics.axes_of_pose(self.params, truth.r_CT_H, v, truth.q_CH, w, feedback)
        np.asarray(self.accepted)[...] = feedback

    def guard(self, bench_s: float, run_zero_s: float) -> None:
        """Run the bench guard's checks; raise SafetyTrip, or order an abort if the chaser would enter the keep-out."""
        sampled_s, guard = self._now.sampled_s, self._params.bench_guard
        sampled_s[0, 0], sampled_s[0, 1] = self.sampled_s(run_zero_s)
        code = int(core.guard_bench(self._params, self._state, bench_s - run_zero_s))
        if code == keep_out.NOTHING:
            return
        breach = self._state.breach
        alarm = breach_alarm(bench_s, self.axis_names, code, breach)
        least = {keep_out.KEEP_OUT: guard.zone.radius, keep_out.PLANE: guard.zone.plane}.get(code, guard.distance)
        if code not in _KEEP_OUT or not breach.value > least:
            raise alarm.trip()
        if not self._aborted:
            self._aborted = True
            self.safety.alarms.latch(alarm)
            self.order_abort()

    def seed(self, now_s: float) -> None:
        """Start a motion without earlier poses."""
        super().seed(now_s)
        self._truth.begin()
        self._aborted = False

    def follow(self, now_s: float) -> None:
        """Note where the axes would be at the end of the cycle; nothing is sent."""
        np.asarray(self._now.setpoint)[...] = self.wanted
        self.commanded_s = now_s

    def command(self, target: np.record, now_s: float, params: np.record | None = None) -> None:
        """Do nothing: no axis has a drive."""
        self.commanded_s = now_s

    def brake(self, now_s: float, params: np.record | None = None) -> bool:
        """Close all valves; return False: no setpoint moves."""
        self._now.command.on[:] = 0
        with suppress(DeviceError):  # without the coupler the relay opens, and the valves close
            self._lines.mirror_thrusters(now_s)
        return False

    def at_rest(self, now_s: float) -> bool:
        """Return True: there are no axes."""
        return True

    def stop(self, now_s: float) -> None:
        """Close all valves; never raises."""
        self.brake(now_s)
        super().stop(now_s)
