"""The steps of commissioning, in their order; the first one that fails ends it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hil.commission.emergency_stop import Button, EmergencyStopTrial
from hil.commission.identity import expected_identity, see_vision_unit
from hil.commission.prompt import OperatorPrompt, StepFailed
from hil.commission.slow_mover import MoveResult, SlowMover, shown, size
from hil.config.rig import Rig
from hil.core.messages import AXES, Array, new
from hil.errors import SafetyTrip
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner

SCALE_ERROR_MAX: Final = 0.02
_WAY_M, _WAY_RAD = 0.020, math.radians(2.0)
_SHARE_OF_TRAVEL: Final = 0.25  # that such a way may take
_SHORT_OF_END_M, _SHORT_OF_END_RAD = 0.005, math.radians(0.5)
_LAST_M, _LAST_RAD = 0.05, math.radians(5.0)  # before an end, at a crawl
_STRAIGHT_M: Final = 0.1  # of the dry run, from the start pose towards the target
_SHOWN: Final = {-1: "on the low switch", 0: "off its switches", 1: "on the high switch"}

Witness = Callable[[int, float], float]
"""Tells, on an emulated bench, where an axis truly is at a bench time: what a technician would see."""


@dataclass(frozen=True)
class AxisFound:
    """What was found of one axis: share by which its encoder goes too far, largest following error (m or rad)."""

    axis: int
    name: str
    scale_error: float
    following_error_max: float


@dataclass
class Found:
    """What commissioning found; dry_run: the largest following errors (6,), None where it was not flown."""

    axes: list[AxisFound] = field(default_factory=list)
    dry_run: Array | None = None


class Commissioning:
    """Takes ``axes`` (0..2 rails, 3..5 gimbals) of a bench through all steps.

    others: axes that were found in order before; with all six together there is a dry run. ends: whether the ends
    of the travels are approached. button, witness: of an emulated bench.
    """

    def __init__(
        self,
        runner: Runner,
        rig: Rig,
        dialogue: OperatorPrompt,
        axes: Sequence[int],
        others: Sequence[int] = (),
        ends: bool = False,
        button: Button | None = None,
        witness: Witness | None = None,
    ) -> None:
        self._runner = runner
        self._rig = rig
        self._dialogue = dialogue
        self._axes = axes
        self._whole = set(axes) | set(others) == set(range(6))
        self._ends = ends
        self._button = button
        self._witness = witness
        self._bench = runner.loop.bench
        self._params = self._bench.params

    def run(self) -> Found:
        """Go through all steps. Raises StepFailed, BenchError; the axes are stopped first."""
        found = Found()
        self._title("emergency stop")
        EmergencyStopTrial(self._runner.loop.safety_io, self._runner.rate, self._dialogue, self._button).run()
        self._title("identity of the devices")
        with self._runner.axes_only() as sequencer:
            see_vision_unit(self._runner, sequencer, self._rig, self._dialogue)
            for line in expected_identity(self._rig):
                self._dialogue.tell(line)
            crawler = self._under_command(sequencer)
            for axis in self._axes:
                found.axes.append(self._sign_and_scale(crawler, axis))
            self._limits(crawler)
            if self._whole:
                found.dry_run = self._dry_run(crawler)
            crawler.end()
        return found

    def _under_command(self, sequencer: MotionSequencer) -> SlowMover:
        crawler = SlowMover(sequencer, self._dialogue)
        homing = [state.name.lower().replace("_", " ") for group in self._bench.feedback for state in group.homing]
        needed = [name for name, state in zip(self._bench.axis_names, homing, strict=True) if state != "done"]
        if needed:
            self._title("homing")
            self._dialogue.tell(f"{', '.join(needed)}: not homed, will look for the home switch")
        crawler.begin()
        if needed:
            places = ", ".join(self._place(crawler, self._bench.axis_names.index(name)) for name in needed)
            self._insist(
                crawler,
                needed[0],
                "homing",
                f"Homed: {places}. Is that where they are?",
                "home_m or home_deg in the rig file, and at the home switch",
            )
        return crawler

    def _sign_and_scale(self, crawler: SlowMover, axis: int) -> AxisFound:
        name = self._bench.axis_names[axis]
        self._title(f"{name}: sign and scale")
        stood_at = crawler.stands_at()
        way = self._way(axis, float(stood_at[axis]))
        target = stood_at.copy()
        target[axis] += way
        truly = self._truly(crawler, axis)
        there = crawler.crawl(axis, target)
        truly = self._truly(crawler, axis) - truly
        error = self._scale_error(axis, way, there, truly)
        self._dialogue.tell(
            f"{name}: told {shown(axis, way)}, encoder {shown(axis, float(there.went[axis]))}, "
            f"following error {size(axis, float(there.error_max[axis]))}"
        )
        moved = "carriage" if axis < 3 else "turntable"
        question = f"Has the {moved} moved along {name} by {shown(axis, way)} (measure it; signs: docs/frames.md)?"
        self._insist(crawler, name, "sign and scale", question, "sign and scale of drive and rig file")
        back = crawler.crawl(axis, stood_at)
        return AxisFound(axis, name, error, float(max(there.error_max[axis], back.error_max[axis])))

    def _way(self, axis: int, place: float) -> float:
        """Return a short way that the axis has room for, towards positive where it can."""
        low, high = float(self._params.low[axis]), float(self._params.high[axis])
        way = min(_WAY_M if axis < 3 else _WAY_RAD, _SHARE_OF_TRAVEL * (high - low))
        return way if place + way <= high else -way

    def _truly(self, crawler: SlowMover, axis: int) -> float:
        """Return where the axis is seen to be, nan where only the technician can see it."""
        return math.nan if self._witness is None else self._witness(axis, crawler.now_s())

    def _scale_error(self, axis: int, way: float, followed: MoveResult, truly: float) -> float:
        """Return by which share the encoder went too far; StepFailed where it, or the axis itself, went wrong."""
        name = self._bench.axis_names[axis]
        error = float(followed.went[axis]) / way - 1.0
        allowed = f"{shown(axis, way)} within {100.0 * SCALE_ERROR_MAX:g} %"
        if abs(error) > SCALE_ERROR_MAX:
            found = f"{shown(axis, float(followed.went[axis]))} by the encoder"
            raise StepFailed(f"{name}: scale", allowed, found, "set the counts a turn, or the scale in the rig file")
        if truly * way < 0.0:
            found = f"{shown(axis, truly)} by the eye"
            advice = "motor and encoder are both the wrong way round: change both signs in the drive"
            raise StepFailed(f"{name}: sign", allowed, found, advice)
        if abs(truly / way - 1.0) > SCALE_ERROR_MAX:
            found = f"{shown(axis, truly)} by the eye"
            raise StepFailed(f"{name}: scale", allowed, found, "set the counts a turn, or the scale in the rig file")
        return error

    def _limits(self, crawler: SlowMover) -> None:
        self._title("limits")
        switches = [switch for group in self._bench.feedback for switch in group.limit]
        for axis in self._axes:
            params = self._params
            low, high = shown(axis, float(params.low[axis])), shown(axis, float(params.high[axis]))
            rate = shown(axis, float(params.rate_max[axis])).removeprefix("+")
            acceleration = shown(axis, float(params.acceleration_max[axis])).removeprefix("+")
            self._dialogue.tell(
                f"{self._place(crawler, axis)}, {_SHOWN[switches[axis]]}; travel {low} to {high}, "
                f"at most {rate}/s and {acceleration}/s2"
            )
        names = ", ".join(self._bench.axis_names[axis] for axis in self._axes)
        question = "Is each limit switch beyond its travel, with room to brake?"
        self._insist(crawler, names, "limits", question, "travel_m, travel_deg or the switches")
        for axis in self._axes if self._ends else ():
            self._approach_ends(crawler, axis)

    def _approach_ends(self, crawler: SlowMover, axis: int) -> None:
        name, stood_at = self._bench.axis_names[axis], crawler.stands_at()
        short, last = (_SHORT_OF_END_M, _LAST_M) if axis < 3 else (_SHORT_OF_END_RAD, _LAST_RAD)
        for end, inwards in ((float(self._params.low[axis]), 1.0), (float(self._params.high[axis]), -1.0)):
            near, target = stood_at.copy(), stood_at.copy()
            near[axis], target[axis] = end + inwards * last, end + inwards * short
            crawler.slowly(near)
            crawler.crawl(axis, target)
            question = f"{name} stands {size(axis, short)} before the end of its travel. Is its switch still free?"
            self._insist(crawler, name, "limits", question, "its travel in the rig file, or the switch")
        crawler.slowly(stood_at)

    def _dry_run(self, crawler: SlowMover) -> Array:
        """Move to the start pose and a short straight piece on, at a quarter of the speed limits."""
        self._title("dry run")
        question = "The bench will go to the scenario's start pose at a quarter of its speed. Is its way clear?"
        self._insist(crawler, "bench", "dry run", question, "its way")
        there = crawler.slowly(self._axes_at(0.0))
        straight = crawler.slowly(self._axes_at(_STRAIGHT_M))
        worst = np.maximum(there.error_max, straight.error_max)
        fastest = np.maximum(there.rate_max, straight.rate_max)
        for axis, name in enumerate(self._bench.axis_names):
            rms = max(float(there.error_rms[axis]), float(straight.error_rms[axis]))
            self._dialogue.tell(
                f"{name}: following error at most {size(axis, float(worst[axis]))}, rms {size(axis, rms)}, "
                f"fastest {size(axis, float(fastest[axis]))}/s"
            )
            if fastest[axis] > self._params.rate_max[axis]:
                limit = f"at most {size(axis, float(self._params.rate_max[axis]))}/s"
                found = f"{size(axis, float(fastest[axis]))}/s"
                raise StepFailed(f"{name}: speed", limit, found, "look at the drive's speed limit and scale")
        return worst

    def _axes_at(self, on_m: float) -> Array:
        """Return the axes (6,) at the start pose, ``on_m`` nearer to the target; SafetyTrip beyond the travel."""
        truth, rest, axes = self._runner.loop.now.truth, np.zeros(3), new(AXES)
        distance = float(np.linalg.norm(truth.r_CT_H))
        place = truth.r_CT_H * (1.0 - min(on_m / distance, 0.5))
        self._bench.axes_of(place, rest, truth.q_CH, rest, axes)
        found = np.concatenate([axes.rail_m, axes.gimbal_rad])
        for axis, name in enumerate(self._bench.axis_names):
            low, high = float(self._params.low[axis]), float(self._params.high[axis])
            if not low <= found[axis] <= high:
                allowed = f"{shown(axis, low)} to {shown(axis, high)}"
                raise SafetyTrip(name, "dry run", shown(axis, float(found[axis])), allowed)
        return found

    def _place(self, crawler: SlowMover, axis: int) -> str:
        return f"{self._bench.axis_names[axis]} at {shown(axis, float(crawler.encoders()[axis]))}"

    def _insist(self, crawler: SlowMover, what: str, step: str, question: str, advice: str) -> None:
        """Ask the technician; StepFailed at a no."""
        if not crawler.ask(question):
            raise StepFailed(f"{what}: {step}", f'"{question}" yes', "no by the technician", f"look at {advice}")

    def _title(self, text: str) -> None:
        self._dialogue.tell(f"-- {text}")
