"""Steps of commissioning in their order; the first failed step ends it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hil.config.rig import Rig
from hil.core import alarm_table as table
from hil.core.messages import AXES, Array, new
from hil.drivers.base import NO_TORQUE_LIMIT, LimitsTorque
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner
from hil.parts.commissioning.emergency_stop import Button, ChainTests, EmergencyStopTest
from hil.parts.commissioning.identity import check_vision_unit, expected_identity
from hil.parts.commissioning.prompt import KeptPrompt, OperatorPrompt, StepFailed
from hil.parts.commissioning.slow_mover import MoveResult, SlowMover, shown, size
from hil.parts.vision.view_plan import axes_record

SCALE_ERROR_MAX: Final = 0.02
_MOVE_M, _MOVE_RAD = 0.020, math.radians(2.0)
_FIRST_M, _FIRST_RAD = 0.001, math.radians(0.1)  # largest motion before the first question
_UNIT_ERROR_MAX: Final = 60.0  # of a drive whose unit is taken wrongly: revolutions per minute for per second
_TRAVEL_FRACTION: Final = 0.25  # largest, of such a move
_SHORT_OF_END_M, _SHORT_OF_END_RAD = 0.005, math.radians(0.5)
_LAST_M, _LAST_RAD = 0.05, math.radians(5.0)  # before an end of the travel, at crawl speed
_STRAIGHT_M: Final = 0.1  # distance of the dry run, from the start pose towards the target
_SWITCH_TEXTS: Final = {-1: "on the low switch", 0: "off its switches", 1: "on the high switch"}

TruePosition = Callable[[int, float], float]
"""Returns the true position of an axis of an emulated bench at a bench time, which a technician would measure."""


@dataclass(frozen=True)
class AxisFindings:
    """Findings of one axis: relative scale error of its encoder, largest following error (m or rad)."""

    axis: int
    name: str
    scale_error: float
    following_error_max: float


@dataclass
class Findings:
    """Findings of commissioning; dry_run: largest following errors (6,), None without a dry run."""

    axes: list[AxisFindings] = field(default_factory=list)
    dry_run: Array | None = None
    proved: list[str] = field(default_factory=list)
    """Results of the tests of emergency stop, safety chain and brakes."""


@dataclass(frozen=True)
class CommissioningPlan:
    """Scope of a commissioning. axes: to be commissioned, 0..2 rails, 3..5 gimbals. signed: axes signed off before, or
    without a drive; if both together are all six, a dry run follows. ends: whether the ends of the travels are
    approached."""

    axes: Sequence[int]
    signed: Sequence[int] = ()
    ends: bool = False

    @property
    def complete(self) -> bool:
        return set(self.axes) | set(self.signed) == set(range(6))


class Commissioning:
    """Commissions axes of a bench in all steps. button, true_position: of an emulated bench.

    watchdog_pid: process that pulses the charge pump, on a bench with wires.
    """

    def __init__(
        self,
        runner: Runner,
        rig: Rig,
        prompt: OperatorPrompt,
        plan: CommissioningPlan,
        button: Button | None = None,
        true_position: TruePosition | None = None,
        watchdog_pid: int | None = None,
    ) -> None:
        self._runner = runner
        self._watchdog_pid = watchdog_pid
        self._rig = rig
        self._prompt = prompt
        self._plan = plan
        self._button = button
        self._true_position = true_position
        self._bench = runner.loop.bench
        self._params = self._bench.params

    def prove(self) -> list[str]:
        """Test emergency stop, safety chain and brakes; return the results. Raises StepFailed, BenchError."""
        prompt = KeptPrompt(self._prompt)
        self._title("emergency stop")
        lines, rate, poll = self._runner.loop.safety_io, self._runner.rate, self._runner.operator.poll
        EmergencyStopTest(lines, rate, prompt, self._button, poll).run()
        if self._runner.rate.paced:  # in simulated time the relay has no time-out
            self._title("safety chain")
            ChainTests(self._runner, self._rig, prompt, self._watchdog_pid).run()
        return prompt.lines

    def run(self) -> Findings:
        """Run all steps. Raises StepFailed, BenchError; the axes are stopped first."""
        findings = Findings(proved=self.prove())
        self._title("identity of the devices")
        with self._runner.axes_only() as sequencer:
            check_vision_unit(self._runner, sequencer, self._rig, self._prompt)
            for line in expected_identity(self._rig):
                self._prompt.show(line)
            mover = self._under_command(sequencer)
            for axis in self._plan.axes:
                findings.axes.append(self._sign_and_scale(mover, axis))
            self._limits(mover)
            if self._plan.complete:
                findings.dry_run = self._dry_run(mover)
            mover.end()
        return findings

    def _under_command(self, sequencer: MotionSequencer) -> SlowMover:
        mover = SlowMover(sequencer, self._prompt)
        homing = [state.name.lower().replace("_", " ") for group in self._bench.feedback for state in group.homing]
        needed = [name for name, state in zip(self._bench.axis_names, homing, strict=True) if state != "done"]
        if needed:
            self._title("homing")
            self._prompt.show(f"{', '.join(needed)}: not homed, will search for the home switch")
        mover.begin()
        if needed:
            places = ", ".join(self._position_text(mover, self._bench.axis_names.index(name)) for name in needed)
            self._require_yes(
                mover,
                needed[0],
                "homing",
                f"Homed: {places}. Are these the true positions?",
                "home_m or home_deg in the rig file, and the home switch",
            )
        return mover

    def _sign_and_scale(self, mover: SlowMover, axis: int) -> AxisFindings:
        name = self._bench.axis_names[axis]
        self._title(f"{name}: sign and scale")
        start = mover.setpoints()
        distance = self._test_distance(axis, float(start[axis]))
        with self._reduced_torque(mover, axis):
            self._first_move(mover, axis, math.copysign(1.0, distance))
        target = start.copy()
        target[axis] += distance
        reading = self._measured(mover, axis)
        there = mover.crawl(axis, target)
        measured = self._measured(mover, axis) - reading
        error = self._scale_error(axis, distance, there, measured)
        self._prompt.show(
            f"{name}: commanded {shown(axis, distance)}, encoder {shown(axis, float(there.travelled[axis]))}, "
            f"following error {size(axis, float(there.error_max[axis]))}"
        )
        moved = "carriage" if axis < 3 else "turntable"
        distance_text = f"{shown(axis, distance)} (measure it; signs: docs/explanation/frames.md)"
        question = f"Has the {moved} moved along {name} by {distance_text}?"
        self._require_yes(mover, name, "sign and scale", question, "sign and scale of drive and rig file")
        back = mover.crawl(axis, start)
        return AxisFindings(axis, name, error, float(max(there.error_max[axis], back.error_max[axis])))

    @contextmanager
    def _reduced_torque(self, mover: SlowMover, axis: int) -> Iterator[None]:
        """Reduce the torque limit of the axis, if its driver and drive can, and restore it afterwards."""
        name = self._bench.axis_names[axis]
        group: object = self._bench.rails if axis < 3 else self._bench.turntable
        number = (self._rig.rails if axis < 3 else self._rig.turntable).axis_numbers.index(axis % 3)
        if not isinstance(group, LimitsTorque):
            self._prompt.show(f"{name}: {NO_TORQUE_LIMIT}")
            yield
            return
        self._prompt.show(f"{name}: {mover.limit_torque(group, number, reduced=True)}")
        try:
            yield
        finally:
            self._prompt.show(f"{name}: {mover.limit_torque(group, number, reduced=False)}")

    def _first_move(self, mover: SlowMover, axis: int, direction: float) -> None:
        """Move so little that the axis stays within 1 mm or 0.1 deg also if its drive is wrong by a factor of 60.

        Raise StepFailed if encoder, measurement or technician contradict; only then the moves grow.
        """
        name, largest = self._bench.axis_names[axis], _FIRST_M if axis < 3 else _FIRST_RAD
        start, commanded = mover.setpoints(), direction * largest / _UNIT_ERROR_MAX
        target = start.copy()
        target[axis] += commanded
        reading = self._measured(mover, axis)
        travelled = float(mover.crawl(axis, target).travelled[axis])
        measured = self._measured(mover, axis) - reading
        for value, source in ((travelled, "by the encoder"), (measured, "measured")):
            if abs(value) > largest:
                signs = "encoder and motor have opposite signs, or check " if value * commanded < 0.0 else ""
                advice = f"{signs}its units of position and velocity, and its gear, in drive and rig file"
                raise StepFailed(
                    f"{name}: first move", shown(axis, commanded), f"{shown(axis, value)} {source}", advice
                )
        question = (
            f"{name} was commanded to move by {shown(axis, commanded)}. Did it stay within {size(axis, largest)}?"
        )
        self._require_yes(mover, name, "first move", question, "units and gear of drive and rig file")
        mover.crawl(axis, start)

    def _test_distance(self, axis: int, position: float) -> float:
        """Return a short distance within the travel, positive if possible."""
        low, high = float(self._params.low[axis]), float(self._params.high[axis])
        distance = min(_MOVE_M if axis < 3 else _MOVE_RAD, _TRAVEL_FRACTION * (high - low))
        return distance if position + distance <= high else -distance

    def _measured(self, mover: SlowMover, axis: int) -> float:
        """Return the true position of the axis, nan if only the technician can measure it."""
        return math.nan if self._true_position is None else self._true_position(axis, mover.now_s())

    def _scale_error(self, axis: int, distance: float, move: MoveResult, measured: float) -> float:
        """Return the relative scale error of the encoder; raise StepFailed if encoder or axis exceed the tolerance."""
        name = self._bench.axis_names[axis]
        error = float(move.travelled[axis]) / distance - 1.0
        allowed = f"{shown(axis, distance)} within {100.0 * SCALE_ERROR_MAX:g} %"
        advice = "set the counts per revolution in the drive, or the scale in the rig file"
        if abs(error) > SCALE_ERROR_MAX:
            observed = f"{shown(axis, float(move.travelled[axis]))} by the encoder"
            raise StepFailed(f"{name}: scale", allowed, observed, advice)
        observed = f"{shown(axis, measured)} measured"
        if measured * distance < 0.0:
            signs = "motor and encoder both have the wrong sign: invert both in the drive"
            raise StepFailed(f"{name}: sign", allowed, observed, signs)
        if abs(measured / distance - 1.0) > SCALE_ERROR_MAX:
            raise StepFailed(f"{name}: scale", allowed, observed, advice)
        return error

    def _limits(self, mover: SlowMover) -> None:
        self._title("limits")
        switches = [switch for group in self._bench.feedback for switch in group.limit]
        for axis in self._plan.axes:
            params = self._params
            low, high = shown(axis, float(params.low[axis])), shown(axis, float(params.high[axis]))
            rate = shown(axis, float(params.rate_max[axis])).removeprefix("+")
            acceleration = shown(axis, float(params.acceleration_max[axis])).removeprefix("+")
            self._prompt.show(
                f"{self._position_text(mover, axis)}, {_SWITCH_TEXTS[switches[axis]]}; travel {low} to {high}, "
                f"at most {rate}/s and {acceleration}/s2"
            )
        names = ", ".join(self._bench.axis_names[axis] for axis in self._plan.axes)
        question = "Is each limit switch beyond the travel by at least the braking distance?"
        self._require_yes(mover, names, "limits", question, "travel_m, travel_deg or the switches")
        for axis in self._plan.axes if self._plan.ends else ():
            self._approach_ends(mover, axis)

    def _approach_ends(self, mover: SlowMover, axis: int) -> None:
        name, start = self._bench.axis_names[axis], mover.setpoints()
        short, last = (_SHORT_OF_END_M, _LAST_M) if axis < 3 else (_SHORT_OF_END_RAD, _LAST_RAD)
        for end, inwards in ((float(self._params.low[axis]), 1.0), (float(self._params.high[axis]), -1.0)):
            near, target = start.copy(), start.copy()
            near[axis], target[axis] = end + inwards * last, end + inwards * short
            if (alarm := self._bench.safety.jog_guard.check_position(axes_record(target))) is not None:
                self._prompt.show(f"{name}: its end is within the guard volume and not approached: {alarm.text}")
                continue
            mover.slowly(near)
            mover.crawl(axis, target)
            question = f"{name} is {size(axis, short)} before the end of its travel. Is its limit switch still free?"
            self._require_yes(mover, name, "limits", question, "its travel in the rig file, or the limit switch")
        mover.slowly(start)

    def _dry_run(self, mover: SlowMover) -> Array:
        """Move to the start pose and a short distance towards the target, at a quarter of the speed limits."""
        self._title("dry run")
        if self._rig.floating is not None:
            self._prompt.show("the vehicle floats: no axis moves, its thrusters are not tested")
            return np.zeros(len(self._bench.axis_names))
        question = "The bench will move to the scenario's start pose at a quarter of its speed. Is its path clear?"
        self._require_yes(mover, "bench", "dry run", question, "the path of the axes")
        there = mover.slowly(self._axes_at(0.0))
        straight = mover.slowly(self._axes_at(_STRAIGHT_M))
        worst = np.maximum(there.error_max, straight.error_max)
        fastest = np.maximum(there.rate_max, straight.rate_max)
        for axis, name in enumerate(self._bench.axis_names):
            rms = max(float(there.error_rms[axis]), float(straight.error_rms[axis]))
            self._prompt.show(
                f"{name}: following error at most {size(axis, float(worst[axis]))}, rms {size(axis, rms)}, "
                f"fastest {size(axis, float(fastest[axis]))}/s"
            )
            if fastest[axis] > self._params.rate_max[axis]:
                limit = f"at most {size(axis, float(self._params.rate_max[axis]))}/s"
                observed = f"{size(axis, float(fastest[axis]))}/s"
                raise StepFailed(f"{name}: speed", limit, observed, "check the drive's speed limit and scale")
        return worst

    def _axes_at(self, on_m: float) -> Array:
        """Return the axes (6,) at the start pose, ``on_m`` closer to the target; raise SafetyTrip beyond the travel."""
        truth, rest, axes = self._runner.loop.now.truth, np.zeros(3), new(AXES)
        distance = float(np.linalg.norm(truth.r_CT_H))
        position = truth.r_CT_H * (1.0 - min(on_m / distance, 0.5))
        self._bench.axes_of(position, rest, truth.q_CH, rest, axes)
        positions = np.concatenate([axes.rail_m, axes.gimbal_rad])
        for axis, name in enumerate(self._bench.axis_names):
            low, high = float(self._params.low[axis]), float(self._params.high[axis])
            if not low <= positions[axis] <= high:
                allowed = f"{shown(axis, low)} to {shown(axis, high)}"
                raise table.DRY_RUN.trip(name, shown(axis, float(positions[axis])), allowed)
        return positions

    def _position_text(self, mover: SlowMover, axis: int) -> str:
        return f"{self._bench.axis_names[axis]} at {shown(axis, float(mover.encoders()[axis]))}"

    def _require_yes(self, mover: SlowMover, what: str, step: str, question: str, advice: str) -> None:
        """Ask the technician; raise StepFailed if the answer is no."""
        if not mover.ask(question):
            raise StepFailed(f"{what}: {step}", f'"{question}" yes', "no by the technician", f"check {advice}")

    def _title(self, text: str) -> None:
        self._prompt.show(f"-- {text}")
