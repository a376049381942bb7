"""The emergency stop, tried before a drive has torque for the first time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from hil.commission.prompt import OperatorPrompt, StepFailed, ask_meanwhile
from hil.core.messages import IoInputs
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import Rate
from hil.loop.safety_io_stage import CLOSING_TIME_S, SafetyIo, SafetyIoStage

_WHAT: Final = "io: emergency stop"
_PERSON_S: Final = 120.0  # bench time that somebody may take to press or to release
_OPENING_S: Final = 1.0  # from the input until the chain must be open
_STAYS_OPEN_S: Final = 0.5  # after the release, without a reset


class Button(Protocol):
    """The emergency stop of an emulated bench, which nobody can press by hand."""

    def press(self) -> None: ...

    def release(self) -> None: ...


class EmergencyStopTrial:
    """Has the emergency stop pressed and released; sees the input, the chain, and that it stays open.

    button: presses it; None: the technician does. Raises StepFailed, BenchError; all lines are off afterwards.
    """

    def __init__(self, lines: SafetyIo, rate: Rate, dialogue: OperatorPrompt, button: Button | None) -> None:
        self._lines = lines
        self._rate = rate
        self._dialogue = dialogue
        self._button = button

    def run(self) -> None:
        """Go through it."""
        if not isinstance(self._lines, SafetyIoStage):
            self._dialogue.tell("emergency stop: this bench has no digital lines; it cuts the drives by itself")
            self._insist("Press the emergency stop. Have all drives lost their power? Release it after.")
            return
        try:
            self._with_lines(self._lines)
        finally:
            if self._button is not None:
                self._button.release()
            self._lines.stop(self._rate.now_s())
            self._lines.close()

    def _with_lines(self, lines: SafetyIoStage) -> None:
        lines.open(self._rate)
        self._dialogue.tell("io: coupler identified, emergency stop released, safety chain closed")
        if self._button is None:
            self._dialogue.tell("Press the emergency stop now.")
        else:
            self._button.press()
        self._wait(lines, lambda seen: not seen.estop_closed, _PERSON_S, "input opens", "still closed", "its wire")
        advice = "the stop must open the safety relay by itself: its wiring"
        self._wait(lines, lambda seen: not seen.chain_closed, _OPENING_S, "safety chain opens", "still closed", advice)
        self._dialogue.tell("io: emergency stop seen, safety chain open")
        self._insist("Have the drives no power while the emergency stop is pressed?")
        if self._button is None:
            self._dialogue.tell("Release the emergency stop now.")
        else:
            self._button.release()
        self._wait(lines, lambda seen: seen.estop_closed, _PERSON_S, "input closes", "still open", "its wire")
        self._insist_on_staying_open(lines)
        lines.stop(self._rate.now_s())
        lines.close()
        try:
            lines.open(self._rate)  # a new edge of enable is the reset
        except SafetyTrip as trip:
            advice = "safety relay, interlocks and the coupler's enable output"
            expected = f"safety chain closes within {CLOSING_TIME_S:g} s of a reset"
            raise StepFailed(_WHAT, expected, str(trip), f"look at {advice}") from trip
        self._dialogue.tell("io: released, chain stayed open, closed again at the reset")

    def _wait(
        self,
        lines: SafetyIoStage,
        happened: Callable[[IoInputs], bool],
        limit_s: float,
        expected: str,
        found: str,
        advice: str,
    ) -> None:
        begun_s = now_s = self._rate.now_s()
        while not happened(self._look(lines, now_s)):
            if now_s - begun_s > limit_s:
                raise StepFailed(_WHAT, expected, f"{found} after {limit_s:g} s", f"look at {advice} (docs/rig.md)")
            now_s = self._rate.wait().now_s

    def _insist_on_staying_open(self, lines: SafetyIoStage) -> None:
        begun_s = now_s = self._rate.now_s()
        while now_s - begun_s < _STAYS_OPEN_S:
            if self._look(lines, now_s).chain_closed:
                advice = "the relay must wait for an edge of enable: set it to manual or monitored reset"
                raise StepFailed(_WHAT, "safety chain stays open after the release", "closed by itself", advice)
            now_s = self._rate.wait().now_s

    def _look(self, lines: SafetyIoStage, now_s: float) -> IoInputs:
        lines.io.pulse(now_s)
        return lines.io.read(now_s)

    def _insist(self, question: str) -> None:
        """Ask, in touch with the coupler meanwhile; raise StepFailed at a no."""
        lines = self._lines

        def meanwhile() -> None:
            now_s = self._rate.wait().now_s
            if isinstance(lines, SafetyIoStage):
                self._look(lines, now_s)

        if not ask_meanwhile(self._dialogue, question, meanwhile):
            advice = "nothing may move before the emergency stop takes the drives' power"
            raise StepFailed(_WHAT, "the drives lose their power", "the technician said no", advice)
