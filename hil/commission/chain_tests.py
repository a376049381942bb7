"""Tests of the safety chain: time-out of the charge pump, watchdog process, torque of the drives, holding brakes."""

from __future__ import annotations

import os
import signal
import time
from typing import Final

from hil.commission.prompt import OperatorPrompt, StepFailed
from hil.config.rig import Rig
from hil.core.messages import IoOutputs
from hil.core.modes import Mode
from hil.drivers.base import AxisGroup
from hil.errors import DeviceError, DriveFault, SafetyTrip
from hil.loop.controlled_stop import BRAKE_CONFIRMED_S
from hil.loop.motion_sequences import MotionSequencer
from hil.loop.runner import Runner
from hil.loop.safety_io_stage import SafetyIoStage

_PAUSE_WALL_S: Final = 0.15  # of the watchdog process, beyond the relay's time-out
_LONGEST_PAUSE: Final = 0.8  # of the coupler's time-out: a longer pause ends its link
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
                    found = "closed" if released else "not closed"
                    advice = "check the brakes' supply, their contact, and close_s and open_s in the rig file"
                    raise StepFailed("io: holding brakes", expected, found, advice)
                now_s = sequencer.tick().now_s
            text = "open" if released else "closed"
            self._prompt.show(f"io: holding brakes read as {text} after {now_s - begun_s:.2f} s")

    def _test_torque(self, lines: SafetyIoStage) -> None:
        """Switch enable off: the drives must report that they have no torque."""
        begun_s = now_s = self._runner.rate.now_s()
        lines.io.write(IoOutputs(False, b""), now_s)
        for group in (self._runner.loop.bench.rails, self._runner.loop.bench.turntable):
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
