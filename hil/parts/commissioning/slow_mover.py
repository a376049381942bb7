"""Slow moves for commissioning under the safety monitor; an axis that does not follow is stopped early."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core import alarm_table as table
from hil.core.messages import AXES, Array, new
from hil.core.modes import Mode
from hil.drivers.base import LimitsTorque
from hil.loop.bench_stage import Move
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.rate_keeper import Tick
from hil.parts.commissioning.prompt import OperatorPrompt, StepFailed, ask_meanwhile

CRAWL_MPS: Final = 0.02
CRAWL_RADPS: Final = math.radians(2.0)
CRAWL_FRACTION: Final = 0.1  # largest, of an axis' speed limit
QUARTER: Final = 0.25
_DEVIATION_M: Final = 0.005  # between command and encoder at crawl speed; beyond it the axis is stopped
_DEVIATION_RAD: Final = math.radians(0.5)
_CATCH_UP: Final = 1.5  # speed over that of the move, for an axis that lags: its deviation is monitored
_SETTLE_S: Final = 3.0
_SETTLING_S: Final = 0.2


@dataclass(frozen=True)
class MoveResult:
    """Tracking of the axes (6,) in a move: m and m/s, rad and rad/s.

    error_max, error_rms: setpoint minus encoder. rate_max: largest measured speed. travelled: from start to end.
    """

    error_max: Array
    error_rms: Array
    rate_max: Array
    travelled: Array


def shown(axis: int, value: float) -> str:
    """Return a signed distance of an axis with its unit, mm or deg."""
    return f"{1e3 * value:+.2f} mm" if axis < 3 else f"{math.degrees(value):+.3f} deg"


def size(axis: int, value: float) -> str:
    """Return an unsigned distance of an axis with its unit."""
    return shown(axis, value).removeprefix("+")


class SlowMover:
    """Moves the axes of an open, homed bench. Raises BenchError, StepFailed; the caller then stops the bench."""

    def __init__(self, sequencer: MotionSequencer, prompt: OperatorPrompt) -> None:
        self._sequencer = sequencer
        self._bench = sequencer.loop.bench
        self._now = sequencer.loop.now
        self._prompt = prompt
        self._target = new(AXES)
        self._sent = np.zeros(6)
        self.dt_s = float(self._bench.params.dt_s)
        self._tick: Tick

    def begin(self) -> None:
        """Home the axes that need it, then seed the setpoints at the present positions."""
        self._sequencer.home()
        self._sequencer.begin()
        self._tick = self._sequencer.seed_for_run()
        self._sequencer.modes.go(Mode.PLACING)  # all safety checks are active in this mode
        self._set_target(self.setpoints())

    def end(self) -> None:
        """Go back to standby."""
        self._sequencer.modes.go(Mode.STANDBY)

    def setpoints(self) -> Array:
        """Return the present setpoints, (6,)."""
        return np.array(self._bench.motion.position)

    def encoders(self) -> Array:
        """Return the encoder positions, (6,)."""
        return np.concatenate([self._now.feedback.rail_m, self._now.feedback.gimbal_rad])

    def now_s(self) -> float:
        """Return the bench time of the last cycle."""
        return self._tick.now_s

    def ask(self, question: str) -> bool:
        """Ask, and hold the axes until the answer arrives; Ctrl-C still works."""
        return ask_meanwhile(self._prompt, question, self._step)

    def limit_torque(self, group: LimitsTorque, axis: int, reduced: bool) -> str:
        """Reduce the torque limit of an axis of ``group``, or restore it, holding meanwhile; return the result."""
        group.limit_torque(axis, reduced)
        start_s = self._tick.now_s
        while not (result := group.torque_limit(axis)):
            if self._tick.now_s - start_s > _SETTLE_S:
                return "its torque limit is not confirmed"
            self._step()
        return result

    def crawl(self, axis: int, target: Array) -> MoveResult:
        """Move at crawl speed; raise StepFailed as soon as ``axis`` (0..2 rails, 3..5 gimbals) does not follow."""
        rates = CRAWL_FRACTION * self._bench.params.rate_max
        rates = np.minimum(rates, [CRAWL_MPS] * 3 + [CRAWL_RADPS] * 3)
        return self._move(target, rates, axis)

    def slowly(self, target: Array) -> MoveResult:
        """Move at a quarter of the speed limits."""
        return self._move(target, QUARTER * self._bench.params.rate_max, None)

    def _move(self, target: Array, rates: Array, followed: int | None) -> MoveResult:
        start, encoders = self.setpoints(), self.encoders()
        move = self._profile(start, target, rates)
        errors: list[Array] = []
        fastest = np.zeros(6)
        while (moved_s := len(errors) * self.dt_s) < move.duration_s + 2.0 * self.dt_s or not self._at_rest():
            if moved_s > move.duration_s + _SETTLE_S:
                raise table.STANDSTILL.trip("bench", "not reached", _SETTLE_S)
            move.at(moved_s + self.dt_s, self._target)
            self._step(move.limits)
            errors.append(self._sent - self.encoders())
            feedback = self._now.feedback
            fastest = np.maximum(fastest, np.abs([*feedback.rail_mps, *feedback.gimbal_radps]))
            if followed is not None:
                self._require_following(followed, start, encoders)
        deviations = np.array(errors)
        self._settle()
        return MoveResult(
            np.abs(deviations).max(axis=0),
            np.sqrt(np.mean(deviations**2, axis=0)),
            fastest,
            self.encoders() - encoders,
        )

    def _settle(self) -> None:
        """Let the servos settle after a move: an axis at rest by its speed may not have settled."""
        start_s = self._tick.now_s
        while self._tick.now_s - start_s < _SETTLING_S:
            self._step()

    def _profile(self, start: Array, target: Array, rates: Array) -> Move:
        """Return a move with speeds of at most ``rates`` (6,)."""
        params = self._bench.params.copy()
        params.rate_max = rates / Move.FRACTION_OF_LIMITS
        ends = new(AXES), new(AXES)
        for record, position in zip(ends, (start, target), strict=True):
            record.rail_m, record.gimbal_rad = position[:3], position[3:]
        move = Move(params, *ends)
        move.limits.rate_max = np.minimum(_CATCH_UP * rates, self._bench.params.rate_max)
        return move

    def _step(self, limits: np.record | None = None) -> None:
        """Send the present target and wait for the next cycle, with the safety checks of a run."""
        self._bench.command(self._target, self._tick.now_s, limits)
        self._sent = np.concatenate([self._now.setpoint.rail_m, self._now.setpoint.gimbal_rad])
        self._tick = self._sequencer.tick()
        if self._sequencer.hold_requested(Mode.PLACING):
            text = self._sequencer.safety.hold_reason or "commanded by the operator"
            raise table.HOLD.trip("bench", f"({text})", "not during a commissioning")

    def _at_rest(self) -> bool:
        return self._bench.at_rest(self._tick.now_s)

    def _set_target(self, position: Array) -> None:
        self._target.rail_m, self._target.gimbal_rad = position[:3], position[3:]
        self._target.rail_mps = 0.0
        self._target.gimbal_radps = 0.0

    def _require_following(self, axis: int, start: Array, encoders: Array) -> None:
        commanded = float(self._sent[axis] - start[axis])
        measured = float(self.encoders()[axis] - encoders[axis])
        if abs(measured - commanded) <= (_DEVIATION_M if axis < 3 else _DEVIATION_RAD):
            return
        name = self._bench.axis_names[axis]
        observed = f"{shown(axis, measured)} by the encoder"
        if commanded * measured < 0.0:
            advice = "encoder and motor have opposite signs: invert one of them in the drive"
            raise StepFailed(f"{name}: sign", shown(axis, commanded), observed, advice)
        advice = "the axis does not follow: check brake, coupling, encoder and the drive's error message"
        raise StepFailed(f"{name}: following", shown(axis, commanded), observed, advice)
