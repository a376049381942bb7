"""Tests of emergency stop and safety chain, the former before a drive has torque for the first time.

Of the chain: time-out of the charge pump, watchdog process, torque of the drives, holding brakes.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from typing import Final, Protocol

from hil.config.rig import Rig
from hil.core.messages import IoInputs, IoOutputs
from hil.core.modes import Mode
from hil.drivers.base import AxisGroup
from hil.errors import DeviceError, DriveFault, SafetyTrip
from hil.loop.controlled_stop import BRAKE_CONFIRMED_S
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.rate_keeper import Rate
from hil.loop.runner import Runner
from hil.loop.safety_io_stage import CLOSING_TIME_S, SafetyIo, SafetyIoStage
from hil.parts.commissioning.prompt import OperatorPrompt, StepFailed, ask_meanwhile

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
        observed: str,
        advice: str,
    ) -> None:
        start_s = now_s = self._rate.now_s()
        while not occurred(self._poll(lines, now_s)):
            if now_s - start_s > limit_s:
                raise StepFailed(
                    _WHAT, expected, f"{observed} after {limit_s:g} s", f"check {advice} (docs/how-to/set-up-a-rig.md)"
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


_PAUSE_WALL_S: Final = 0.15  # pause of the watchdog process beyond the relay's time-out
_LONGEST_PAUSE: Final = 0.8  # fraction of the coupler's time-out: a longer pause ends its link
_RESUMED_WALL_S: Final = 0.08
_TORQUE_OFF_S: Final = 0.5  # until both devices report it


class ChainTests:
    """Opens the safety chain in each way that the program relies on, and reads it back. All axes stand.

    watchdog_pid: process that pulses the charge pump; None: the program itself does.
    """

    def __init__(self, runner: Runner, rig: Rig, prompt: OperatorPrompt, watchdog_pid: int | None) -> None:
        self._runner = runner
        self._rig = rig
        self._prompt = prompt
        self._watchdog_pid = watchdog_pid

    def run(self) -> None:
        """Run the tests that this bench permits; the drives have no torque then. Raises StepFailed, BenchError."""
        lines, rate = self._runner.loop.safety_io, self._runner.rate
        if not isinstance(lines, SafetyIoStage) or self._rig.io is None:
            self._prompt.show("safety chain: this bench has no digital lines")
            return
        try:
            lines.open(rate)
            self._test_pump(lines, self._rig.io.pump_timeout_s)
            if self._watchdog_pid is not None:
                lines.open(rate)
                self._test_watchdog(lines, self._watchdog_pid, self._rig.io.pump_timeout_s, self._rig.io.timeout_s)
        finally:
            lines.stop(rate.now_s())
            lines.close()
        with self._runner.axes_only() as sequencer:
            self._test_brakes(lines, sequencer)
            self._test_torque(lines)
        self._runner.safety.modes.go(Mode.OFF)

    def _test_pump(self, lines: SafetyIoStage, timeout_s: float) -> None:
        try:
            took_s = lines.test_pump(self._runner.rate, timeout_s)
        except SafetyTrip as trip:
            advice = "set the relay's time-out to io.pump_timeout_s; check that it monitors the pump"
            raise StepFailed(
                "io: charge pump", f"chain opens {timeout_s:g} s after the last pulse", str(trip), advice
            ) from trip
        self._prompt.show(f"io: chain read as open {took_s:.2f} s after the last pulse, time-out {timeout_s:g} s")

    def _test_watchdog(self, lines: SafetyIoStage, pid: int, pump_s: float, link_s: float) -> None:
        pause_s = pump_s + _PAUSE_WALL_S
        if pause_s > _LONGEST_PAUSE * link_s:
            self._prompt.show(f"watchdog process: not tested, io.timeout_s {link_s:g} is too short for it")
            return
        os.kill(pid, signal.SIGSTOP)
        try:
            time.sleep(pause_s)
        finally:
            os.kill(pid, signal.SIGCONT)
        time.sleep(_RESUMED_WALL_S)
        if lines.io.read(self._runner.rate.now_s()).chain_closed:
            expected = "chain opens while the watchdog process is stopped, and stays open"
            advice = "check that the relay monitors the pump, and needs an edge of enable to close"
            raise StepFailed("io: watchdog process", expected, "closed", advice)
        self._prompt.show(f"io: chain opened while the watchdog process was stopped for {pause_s:.2f} s")

    def _test_brakes(self, lines: SafetyIoStage, sequencer: MotionSequencer) -> None:
        """Let the holding brakes close and release them again; the drives hold the axes."""
        if self._rig.io is None or self._rig.io.inputs.brakes_closed is None:
            self._prompt.show("holding brakes: no contact (io.inputs.brakes_closed), not tested")
            return
        for released, time_s in ((False, self._rig.brake_close_s), (True, self._rig.brake_open_s)):
            begun_s = now_s = self._runner.rate.now_s()
            lines.release_brakes(released, now_s)
            while lines.brakes_closed(now_s) is released:
                if now_s - begun_s > time_s + BRAKE_CONFIRMED_S:
                    expected = f"{'open' if released else 'closed'} within {time_s:g} s"
                    state = "closed" if released else "not closed"
                    advice = "check the brakes' supply, their contact, and close_s and open_s in the rig file"
                    raise StepFailed("io: holding brakes", expected, state, advice)
                now_s = sequencer.tick().now_s
            text = "open" if released else "closed"
            self._prompt.show(f"io: holding brakes read as {text} after {now_s - begun_s:.2f} s")

    def _test_torque(self, lines: SafetyIoStage) -> None:
        """Switch enable off: the drives must report that they have no torque."""
        begun_s = now_s = self._runner.rate.now_s()
        lines.io.write(IoOutputs(False, b""), now_s)
        bench, rig = self._runner.loop.bench, self._rig
        driven = [axes for axes, table in ((bench.rails, rig.rails), (bench.turntable, rig.turntable)) if table.driven]
        for group in driven:
            while (report := _fault(group, now_s)) is None:
                if now_s - begun_s > _TORQUE_OFF_S:
                    expected = f"drives without torque {_TORQUE_OFF_S:g} s after enable is off"
                    advice = "wire the relay's contacts to the torque-off inputs of all drives"
                    raise StepFailed(f"{group.name}: torque", expected, "drives report no fault", advice)
                now_s = self._runner.rate.wait().now_s
                lines.keep_closed(now_s)
            self._prompt.show(f"{report}, {now_s - begun_s:.2f} s after enable was switched off")


def _fault(group: AxisGroup, now_s: float) -> DriveFault | None:
    """Return the fault that the drives of ``group`` report, None if there is none."""
    try:
        group.read(now_s)
    except DriveFault as fault:
        return fault
    except DeviceError:
        return None
    return None
