"""Test of the emergency stop, before a drive has torque for the first time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from hil.commission.prompt import OperatorPrompt, StepFailed, ask_meanwhile
from hil.core.messages import IoInputs
from hil.errors import SafetyTrip
from hil.loop.rate_keeper import Rate
from hil.loop.safety_io_stage import CLOSING_TIME_S, SafetyIo, SafetyIoStage

_WHAT: Final = "io: emergency stop"
_OPERATOR_S: Final = 120.0  # bench time allowed to press or to release
_OPENING_S: Final = 1.0  # allowed from the input until the chain is open
_STAYS_OPEN_S: Final = 0.5  # required after the release, without a reset


class Button(Protocol):
    """Emergency stop of an emulated bench, pressed by software."""

    def press(self) -> None: ...

    def release(self) -> None: ...


class EmergencyStopTest:
    """Has the emergency stop pressed and released; checks input and safety chain, and that the chain stays open.

    button: presses it; None: the technician does. poll: called in each cycle with bench time, of an operator who may
    stop the test. Raises StepFailed, BenchError; all lines are off afterwards.
    """

    def __init__(
        self,
        safety_io: SafetyIo,
        rate: Rate,
        prompt: OperatorPrompt,
        button: Button | None,
        poll: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._safety_io = safety_io
        self._rate = rate
        self._prompt = prompt
        self._button = button
        self._poll_operator = poll

    def run(self) -> None:
        """Run the test."""
        if not isinstance(self._safety_io, SafetyIoStage):
            self._prompt.show("emergency stop: this bench has no digital lines; the stop removes the drives' power")
            self._require_yes("Press the emergency stop. Have all drives lost their power? Release it afterwards.")
            return
        try:
            self._test_lines(self._safety_io)
        finally:
            if self._button is not None:
                self._button.release()
            self._safety_io.stop(self._rate.now_s())
            self._safety_io.close()

    def _test_lines(self, lines: SafetyIoStage) -> None:
        lines.open(self._rate)
        self._prompt.show("io: coupler identified, emergency stop released, safety chain closed")
        if self._button is None:
            self._prompt.show("Press the emergency stop now.")
        else:
            self._button.press()
        self._wait(lines, lambda inputs: not inputs.estop_closed, _OPERATOR_S, "input opens", "still closed", "wiring")
        advice = "wiring: the stop must open the safety relay by itself"
        self._wait(lines, lambda inputs: not inputs.chain_closed, _OPENING_S, "chain opens", "still closed", advice)
        self._prompt.show("io: emergency stop detected, safety chain open")
        self._require_yes("Are all drives without power while the emergency stop is pressed?")
        if self._button is None:
            self._prompt.show("Release the emergency stop now.")
        else:
            self._button.release()
        self._wait(lines, lambda inputs: inputs.estop_closed, _OPERATOR_S, "input closes", "still open", "wiring")
        self._require_open_chain(lines)
        lines.stop(self._rate.now_s())
        lines.close()
        try:
            lines.open(self._rate)  # a new edge of enable is the reset
        except SafetyTrip as trip:
            expected = f"safety chain closes within {CLOSING_TIME_S:g} s of a reset"
            advice = "check safety relay, interlocks and the coupler's enable output"
            raise StepFailed(_WHAT, expected, str(trip), advice) from trip
        self._prompt.show("io: released, chain stayed open, closed again after the reset")

    def _wait(
        self,
        lines: SafetyIoStage,
        occurred: Callable[[IoInputs], bool],
        limit_s: float,
        expected: str,
        found: str,
        advice: str,
    ) -> None:
        start_s = now_s = self._rate.now_s()
        while not occurred(self._poll(lines, now_s)):
            if now_s - start_s > limit_s:
                raise StepFailed(
                    _WHAT, expected, f"{found} after {limit_s:g} s", f"check {advice} (docs/how-to/set-up-a-rig.md)"
                )
            now_s = self._next_cycle()

    def _require_open_chain(self, lines: SafetyIoStage) -> None:
        start_s = now_s = self._rate.now_s()
        while now_s - start_s < _STAYS_OPEN_S:
            if self._poll(lines, now_s).chain_closed:
                advice = "set the relay to manual or monitored reset: it must wait for an edge of enable"
                raise StepFailed(_WHAT, "safety chain stays open after the release", "closed without reset", advice)
            now_s = self._next_cycle()

    def _next_cycle(self) -> float:
        """Wait for the next cycle, and return its bench time."""
        now_s = self._rate.wait().now_s
        self._poll_operator(now_s)
        return now_s

    def _poll(self, lines: SafetyIoStage, now_s: float) -> IoInputs:
        lines.io.pulse(now_s)
        return lines.io.read(now_s)

    def _require_yes(self, question: str) -> None:
        """Ask, and keep the coupler's link alive meanwhile; raise StepFailed if the answer is no."""
        lines = self._safety_io

        def meanwhile() -> None:
            now_s = self._next_cycle()
            if isinstance(lines, SafetyIoStage):
                self._poll(lines, now_s)

        if not ask_meanwhile(self._prompt, question, meanwhile):
            advice = "no axis may move before the emergency stop removes the drives' power"
            raise StepFailed(_WHAT, "the drives lose their power", "no by the technician", advice)
