"""Axes other than rails and turntable: held at their place during a run, or those that move the target in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hil.bench import guard, kinematics, manipulator
from hil.bench.manipulator import ChaserMotion
from hil.config.rig import HeldAtPlace, RotaryManipulator, TargetManipulator
from hil.core import alarm_table as table
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, HELD_SAMPLE, MANIPULATOR_SAMPLE, Array, Homing, new
from hil.drivers.base import AxisGroup
from hil.frmn.ring import NoTelemetry, Telemetry
from hil.loop.bench_stage import BenchStage
from hil.loop.rate_keeper import Tick
from hil.loop.target_axes import TargetAxes
from hil.safety.motion_guards import JogGuard, breach_alarm


class HeldAxes(TargetAxes):
    """Axes of ``config``, those of a target manipulator or further ones, held at their place during the run.

    number: among the groups of the rig that are held.
    """

    def __init__(self, axes: AxisGroup, config: HeldAtPlace, number: int = 0, sink: Telemetry | None = None) -> None:
        position, self._held_within = config.place
        super().__init__(axes, config, np.array(position))
        self._largest = np.zeros(len(position))
        self._sink = sink or NoTelemetry()
        self._sample = np.zeros(1, HELD_SAMPLE)
        self._sample["group"], self._sample["setpoint"][0, : len(position)] = number, position

    def check(self, now_s: float) -> None:
        """Read the axes; raise SafetyTrip if one is further from its place than the rig file allows."""
        self.read(now_s)
        error = np.abs(self.feedback.position - self.place_at)
        np.maximum(self._largest, error, out=self._largest)
        worst = int(error.argmax())
        if not error[worst] <= self._held_within:
            name = self.axes.axis_names[worst]
            raise table.COMMANDED_PLACE.trip(name, error[worst], self._held_within, rotates=self.rotates)
        self._check_speeds()

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Send place and encoders, as this cycle has read them, to the sink."""
        row, feedback, n = self._sample, self.feedback, len(self.place_at)
        row["t_s"], row["sampled_s"] = t_s, feedback.t_s - run_zero_s
        row["position"][0, :n], row["rate"][0, :n] = feedback.position, feedback.rate
        self._sink.put(row)

    def numbers(self) -> dict[str, float]:
        """Return the largest distances from their places while armed and running, for the JSON, in m or deg."""
        unit, scale = ("deg", math.degrees(1.0)) if self.rotates else ("m", 1.0)
        names = (name.rpartition(".")[2] for name in self.axes.axis_names)
        return {f"{name}_{unit}": scale * float(value) for name, value in zip(names, self._largest, strict=True)}


class AxesTogether:
    """Target and further axes as one stage, without any a fixed target: what is done is done to each in turn."""

    def __init__(self, groups: Sequence[TargetAxes] = ()) -> None:
        self.groups = tuple(groups)
        """The axis groups."""

    def open(self, now_s: float) -> None:
        """Open all devices."""
        for group in self.groups:
            group.open(now_s)

    def home(self, now_s: float) -> None:
        """Start homing of each axis that is not homed."""
        for group in self.groups:
            group.home(now_s)

    def not_homed(self, now_s: float) -> str:
        """Return the name of an axis that is not homed, "" if all are."""
        return next(filter(None, [group.not_homed(now_s) for group in self.groups]), "")

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move one group after the other to its place."""
        for group in self.groups:
            group.place(tick, step_s)

    def park(self, tick: Callable[[], Tick], step_s: float, rate_fraction: float) -> None:
        """Move one group after the other to its park position, the last one first."""
        for group in reversed(self.groups):
            group.park(tick, step_s, rate_fraction)

    def read(self, now_s: float) -> None:
        """Read all groups."""
        for group in self.groups:
            group.read(now_s)

    def check(self, now_s: float) -> None:
        """Check all groups."""
        for group in self.groups:
            group.check(now_s)

    def relate(self, axes: np.record) -> None:
        """Relate the axes to the target."""
        for group in self.groups:
            group.relate(axes)

    def check_apart(self, now_s: float, jogs: bool, setpoint: np.record, feedback: np.record) -> None:
        """Check the bodies of all groups."""
        for group in self.groups:
            group.check_apart(now_s, jogs, setpoint, feedback)

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Record all groups."""
        for group in self.groups:
            group.record(t_s, run_zero_s, chaser)

    def stop(self, now_s: float) -> None:
        """Stop all groups."""
        for group in self.groups:
            group.stop(now_s)

    def disable(self, now_s: float) -> None:
        """Switch the torque of all groups off."""
        for group in self.groups:
            group.disable(now_s)

    def close(self) -> None:
        """Close all groups."""
        for group in self.groups:
            group.close()


class TargetInMotion(TargetAxes):
    """Target that the axes of ``config`` move in a run.

    params: MANIPULATOR. bench: BENCH_PARAMS of the chaser's rig. limits: BENCH_PARAMS with the limits of these axes.
    start: record of the truth at the start of a run. sink: of HELD_SAMPLE for rails, of MANIPULATOR_SAMPLE otherwise.
    """

    jogs_before_homing = False

    def __init__(
        self,
        axes: AxisGroup,
        config: RotaryManipulator | TargetManipulator,
        params: np.record,
        bench: np.record,
        limits: np.record,
        start: np.record,
        sink: Telemetry | None = None,
    ) -> None:
        self._given = kernel_record(limits)
        at = manipulator.start_axes(params, bench, limits, start.r_CT_H, start.q_CH)
        super().__init__(axes, config, at, manipulator.places(params).start)
        self.params = params
        self._sink = sink or NoTelemetry()
        self._sample = np.zeros(1, HELD_SAMPLE if params.rails else MANIPULATOR_SAMPLE)
        self._bench, self._rest_radps = bench, config.si("speed_mismatch_max")
        self._largest = np.zeros((3, 3))  # position, rate, following error
        self._guards: tuple[np.record, np.record] | None = None
        self._in_jogs: list[JogGuard] = []
        self._breach, self._apart, self._near = new(guard.BREACH), kernel_record(new(AXES)), kernel_record(new(AXES))

    def protect(self, guards: tuple[np.record, np.record] | None) -> None:
        """Keep bodies that move with the target apart from others. guards: of ``params.bench.target_guards``."""
        self._guards, self._in_jogs = guards, [JogGuard(each) for each in guards or ()]

    def place(self, tick: Callable[[], Tick], step_s: float) -> None:
        """Move all axes slowly to their positions for the start pose and wait until they are at rest there."""
        super().place(tick, step_s)
        self._stand_at(self.place_at)

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the axes."""
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
        if self._guards is not None:
            at, rate = self.feedback.position, self.feedback.rate
            self._check_bodies(self._guards[0], self._set(self._apart, axes, axes.rail_m, axes.rail_mps - rate))
            self._check_bodies(self._guards[1], self._set(self._apart, axes, at, rate))

    def check_apart(self, now_s: float, jogs: bool, setpoint: np.record, feedback: np.record) -> None:
        """Raise SafetyTrip if bodies of the homed target come too near to others; a jog may lead away from them."""
        if self._guards is None or any(state is not Homing.DONE for state in self.feedback.homing):
            return
        near, wanted, at, rate = self._near, self._apart, self.feedback.position, self.feedback.rate
        self._set(near, feedback, feedback.rail_m, feedback.rail_mps)
        if not jogs:
            self.relate(near)
            return
        self._relate(near, at)
        near.rail_mps -= rate
        self._set(wanted, setpoint, setpoint.rail_m, setpoint.rail_mps - self._expected_rate)
        self._relate(wanted, self._accepted)
        if alarm := self._in_jogs[0].check(now_s, wanted, near):
            raise alarm.trip()
        self._set(wanted, setpoint, self._accepted, self._expected_rate)
        if alarm := self._in_jogs[1].check(now_s, wanted, self._set(near, feedback, at, rate)):
            raise alarm.trip()

    def _set(self, out: np.record, axes: np.record, rail_m: Array, rail_mps: Array) -> np.record:
        """Return ``out``, AXES, with these rails and the turntable of ``axes``."""
        out.rail_m, out.rail_mps = rail_m, rail_mps
        out.gimbal_rad, out.gimbal_radps = axes.gimbal_rad, axes.gimbal_radps
        return out

    def _check_bodies(self, of: np.record, axes: np.record) -> None:
        """Raise SafetyTrip if bodies that move with the target would come too near to others. of: GUARD."""
        code = int(guard.enters_volume(of, axes, self._breach))
        if code != guard.NOTHING:
            raise breach_alarm(self.feedback.t_s, self.axis_names, code, self._breach).trip()

    def relate_setpoint(self, axes: np.record) -> None:
        """``relate`` for setpoints, of the last cycle."""
        self._relate(axes, self._expected)

    def record(self, t_s: float, run_zero_s: float, chaser: BenchStage) -> None:
        """Send the last setpoints of all axes, and the encoders that this cycle has read, to the sink."""
        row, (rails, turntable) = self._sample, chaser.feedback
        row["t_s"], row["sampled_s"] = t_s, self.feedback.t_s - run_zero_s
        if self.params.rails:
            row["setpoint"][0, :3], row["position"][0, :3] = self._accepted, self.feedback.position
            row["rate"][0, :3] = self.feedback.rate
            self._sink.put(row)
            return
        row["setpoint"]["angle_rad"], row["setpoint"]["rate_radps"] = self._accepted, self._expected_rate
        row["feedback"]["angle_rad"], row["feedback"]["rate_radps"] = self.feedback.position, self.feedback.rate
        row["chaser_setpoint"] = chaser.accepted
        seen = row["chaser_feedback"]
        seen["rail_m"], seen["rail_mps"] = rails.position, rails.rate
        seen["gimbal_rad"], seen["gimbal_radps"] = turntable.position, turntable.rate
        self._sink.put(row)

    def numbers(self) -> dict[str, Any]:
        """Return the largest positions, rates and following errors of the three axes, for the JSON."""
        names, scale = ("angle_max_deg", "rate_max_degps", "following_error_max_deg"), math.degrees(1.0)
        if self.params.rails:
            names, scale = ("position_max_m", "rate_max_mps", "following_error_max_m"), 1.0
        return {name: (scale * row).tolist() for name, row in zip(names, self._largest, strict=True)}

    def shown_at_rest(self, r_CT_H: Array, q_CH: Array) -> ChaserMotion:
        """Return what the chaser's rig has to show of a pose at rest, with the target at its place."""
        rest = np.zeros(3)
        return manipulator.shown_motion(self.params, self.place_at, rest, ChaserMotion(r_CT_H, rest, q_CH, rest))

    def follow(self, relative: ChaserMotion, now_s: float) -> ChaserMotion:
        """Send the next setpoint on the way to the motion relative to the target at the end of this cycle.

        Returns what is left for the chaser's rig: the motion in L.
        """
        setpoint, out = self._wanted, self._next
        at, rates = manipulator.wanted_axes(self.params, self._bench, relative, self._motion.position[3:])
        if self.params.rails:
            setpoint.rail_m, setpoint.rail_mps = at, rates
        else:
            setpoint.gimbal_rad, setpoint.gimbal_radps = at, rates
        kinematics.limit_setpoint(self._limits, self._motion, setpoint, out)
        self._send(now_s)
        return manipulator.shown_motion(self.params, self._expected, self._expected_rate, relative)

    def at_rest(self, now_s: float) -> bool:
        """Return whether the axes are at rest according to their encoders."""
        return bool(np.abs(self.axes.read(now_s).rate).max() <= self._rest_radps)

    def _limits_of(self, step_s: float) -> np.record:
        return self._given

    def _relate(self, axes: np.record, target_at: Array) -> None:
        axes.rail_m, axes.gimbal_rad = manipulator.relative_axes(
            self._bench, self.params, axes.rail_m, axes.gimbal_rad, target_at
        )
