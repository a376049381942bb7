"""Slow, supervised moves for commissioning: an axis that does not follow is stopped early."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.commission.prompt import OperatorPrompt, StepFailed, ask_meanwhile
from hil.core.messages import AXES, Array, new
from hil.core.modes import Mode
from hil.errors import SafetyTrip
from hil.loop.bench_stage import Move
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.rate_keeper import Tick

CRAWL_MPS: Final = 0.02
CRAWL_RADPS: Final = math.radians(2.0)
CRAWL_SHARE: Final = 0.1  # of an axis' speed limit, at most
QUARTER: Final = 0.25
_DEVIATION_M: Final = 0.005  # between command and encoder at a crawl, before the axis is stopped
_DEVIATION_RAD: Final = math.radians(0.5)
_SETTLE_S: Final = 3.0
_REST_S: Final = 0.2


@dataclass(frozen=True)
class MoveResult:
    """How the axes (6,) followed a move: m and m/s, rad and rad/s.

    error_max, error_rms: setpoint against encoder. rate_max: by the encoders. went: from start to end.
    """

    error_max: Array
    error_rms: Array
    rate_max: Array
    went: Array


def shown(axis: int, value: float) -> str:
    """Return a way or an error of an axis with its unit: mm or deg."""
    return f"{1e3 * value:+.2f} mm" if axis < 3 else f"{math.degrees(value):+.3f} deg"


def size(axis: int, value: float) -> str:
    """Return the same for what has no direction."""
    return shown(axis, value).removeprefix("+")


class SlowMover:
    """Moves the axes of an open, homed bench. Raises BenchError, StepFailed; whoever opened the bench stops it then."""

    def __init__(self, sequencer: MotionSequencer, dialogue: OperatorPrompt) -> None:
        self._sequencer = sequencer
        self._bench = sequencer.loop.bench
        self._now = sequencer.loop.now
        self._dialogue = dialogue
        self._wanted = new(AXES)
        self._before = np.zeros(6)
        self.dt_s = float(self._bench.params.dt_s)
        self._tick: Tick

    def begin(self) -> None:
        """Home what needs it, then take the axes under command where they stand."""
        self._sequencer.home()
        self._sequencer.begin()
        self._tick = self._sequencer.seed_for_run()
        self._sequencer.modes.go(Mode.PLACING)  # every check of the supervisor is on in this mode
        self._aim_at(self.stands_at())

    def end(self) -> None:
        """Go back to standby."""
        self._sequencer.modes.go(Mode.STANDBY)

    def stands_at(self) -> Array:
        """Return where the setpoints are, (6,)."""
        return np.array(self._bench.motion.position)

    def encoders(self) -> Array:
        """Return where the encoders are, (6,)."""
        return np.concatenate([self._now.feedback.rail_m, self._now.feedback.gimbal_rad])

    def now_s(self) -> float:
        """Return the bench time of the last cycle."""
        return self._tick.now_s

    def ask(self, question: str) -> bool:
        """Ask, and keep the axes where they are until the answer comes; Ctrl-C is heard meanwhile."""
        return ask_meanwhile(self._dialogue, question, self._step)

    def crawl(self, axis: int, target: Array) -> MoveResult:
        """Move at a crawl; StepFailed as soon as ``axis`` (0..2 rails, 3..5 gimbals) does not follow."""
        rates = CRAWL_SHARE * self._bench.params.rate_max
        rates = np.minimum(rates, [CRAWL_MPS] * 3 + [CRAWL_RADPS] * 3)
        return self._go(target, rates, axis)

    def slowly(self, target: Array) -> MoveResult:
        """Move at a quarter of the speed limits."""
        return self._go(target, QUARTER * self._bench.params.rate_max, None)

    def _go(self, target: Array, rates: Array, watched: int | None) -> MoveResult:
        start, begun = self.stands_at(), self.encoders()
        move = self._move(start, target, rates)
        errors, fastest, begun_s = [], np.zeros(6), self._tick.now_s
        while (moved_s := self._tick.now_s - begun_s) < move.duration_s + 2.0 * self.dt_s or not self._stands():
            if moved_s > move.duration_s + _SETTLE_S:
                raise SafetyTrip("bench", "standstill", "not reached", f"{_SETTLE_S:g} s after a move")
            move.at(moved_s + self.dt_s, self._wanted)
            self._step()
            errors.append(self._before - self.encoders())
            feedback = self._now.feedback
            fastest = np.maximum(fastest, np.abs([*feedback.rail_mps, *feedback.gimbal_radps]))
            if watched is not None:
                self._insist_on_following(watched, start, begun)
        deviations = np.array(errors)
        self._rest()
        return MoveResult(
            np.abs(deviations).max(axis=0),
            np.sqrt(np.mean(deviations**2, axis=0)),
            fastest,
            self.encoders() - begun,
        )

    def _rest(self) -> None:
        """Give the servos a moment at the end of a move: a standstill is slow, not settled."""
        begun_s = self._tick.now_s
        while self._tick.now_s - begun_s < _REST_S:
            self._step()

    def _move(self, start: Array, target: Array, rates: Array) -> Move:
        """Return a move whose axes go no faster than ``rates`` (6,)."""
        params = self._bench.params.copy()
        params.rate_max = rates / Move.FRACTION_OF_LIMITS
        ends = new(AXES), new(AXES)
        for record, place in zip(ends, (start, target), strict=True):
            record.rail_m, record.gimbal_rad = place[:3], place[3:]
        return Move(params, *ends)

    def _step(self) -> None:
        """Send the present wish and take the next cycle, supervised as in a run."""
        self._bench.command(self._wanted, self._tick.now_s, self._now.setpoint)
        self._before = np.concatenate([self._now.setpoint.rail_m, self._now.setpoint.gimbal_rad])
        self._tick = self._sequencer.tick()
        self._sequencer.hold_requested(Mode.PLACING)

    def _stands(self) -> bool:
        return self._bench.at_rest(self._tick.now_s, self._now.feedback)

    def _aim_at(self, place: Array) -> None:
        self._wanted.rail_m, self._wanted.gimbal_rad = place[:3], place[3:]
        self._wanted.rail_mps = 0.0
        self._wanted.gimbal_radps = 0.0

    def _insist_on_following(self, axis: int, start: Array, begun: Array) -> None:
        told = float(self._before[axis] - start[axis])
        went = float(self.encoders()[axis] - begun[axis])
        if abs(went - told) <= (_DEVIATION_M if axis < 3 else _DEVIATION_RAD):
            return
        name = self._bench.axis_names[axis]
        found = f"{shown(axis, went)} by the encoder"
        if told * went < 0.0:
            advice = "encoder and motor do not turn the same way: change one of both signs in the drive"
            raise StepFailed(f"{name}: sign", shown(axis, told), found, advice)
        advice = "the axis does not follow: look at brake, coupling, encoder and the drive's own message"
        raise StepFailed(f"{name}: following", shown(axis, told), found, advice)
