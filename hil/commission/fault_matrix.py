"""Rehearsing faults on an emulated bench: switch one on in a chosen mode, see what the bench makes of it.

Every protection that stands in ``docs/safety.md`` is exercised by this on real wires: time of detection,
mode that was reached, words of the alarm, and whether the axes stand.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.drivers.fault_injection import AXIS, WIRE, FaultControl
from hil.loop.runner import Runner
from hil.session.build import WiredBench

TRIPS, GOES_ON = "trips", "goes on"
STANDSTILL: Final = 2e-3  # m/s or rad/s
_PLANS: Final = {
    Mode.STANDBY: (OperatorCommand.HOME,),
    Mode.ARMED: (OperatorCommand.HOME, OperatorCommand.ARM),
    Mode.RUNNING: (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
    Mode.HOLD: (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
}
_REACH_WALL_S: Final = 30.0
_IN_MODE_WALL_S: Final = 0.4  # before the fault is switched on
_STANDS_WALL_S: Final = 2.0
_LOOK_WALL_S: Final = 0.001


@dataclass(frozen=True)
class FaultCase:
    """One fault. line: what is said to the control port of ``device``. watched_s: how long to wait for the alarm."""

    device: str
    line: str
    mode: Mode = Mode.RUNNING
    expected: str = TRIPS
    watched_s: float = 3.0

    @property
    def name(self) -> str:
        return f"{self.device} {self.line.removeprefix('on ')} in {self.mode.value}"


@dataclass(frozen=True)
class FaultFinding:
    """What happened. detected_s, standing_s: bench time from the fault to the alarm, and until the last axis stood."""

    case: FaultCase
    reached: Mode
    alarm: str
    detected_s: float | None
    standing_s: float | None

    @property
    def as_expected(self) -> bool:
        if self.case.expected == GOES_ON:
            return self.detected_s is None and not self.alarm
        return self.reached is Mode.SAFE_STOP and self.detected_s is not None and self.standing_s is not None


def rehearse(bench: WiredBench, case: FaultCase) -> FaultFinding:
    """Run a session at ``bench`` up to ``case.mode``, switch the fault on, and look; all faults are off afterwards.

    Raises RuntimeError where the mode was not reached.
    """
    operator = Operator(_PLANS[case.mode], attended=True)
    runner = bench.runner(operator=operator)
    findings: list[FaultFinding] = []
    failures: list[RuntimeError] = []

    def play() -> None:
        try:
            findings.append(_play(bench, runner, operator, case))
        except RuntimeError as failure:
            failures.append(failure)
        finally:
            operator.submit(OperatorCommand.STOP)

    player = threading.Thread(target=play, name="rehearsal")
    player.start()
    runner.run()
    player.join()
    if failures:
        raise failures[0]
    return findings[0]


def clear_faults(bench: WiredBench) -> None:
    """Switch all faults of all emulators off."""
    for name, address in bench.addresses.items():
        if name.endswith(".faults"):
            _say(address, "clear")


def _play(bench: WiredBench, runner: Runner, operator: Operator, case: FaultCase) -> FaultFinding:
    modes, now_s = runner.safety.modes, runner.now_s
    if case.mode is Mode.HOLD:
        _await(runner, Mode.RUNNING)
        time.sleep(_IN_MODE_WALL_S)
        operator.submit(OperatorCommand.HOLD)
    _await(runner, case.mode)
    time.sleep(_IN_MODE_WALL_S)
    begun_s = now_s()
    try:
        _say(bench.addresses[f"{case.device}.faults"], case.line)
        while modes.mode is not Mode.SAFE_STOP and now_s() - begun_s < case.watched_s:
            time.sleep(_LOOK_WALL_S)
        reached = modes.mode
        alarms = runner.safety.alarms.all()
        standing_s = _standing_s(bench, runner, begun_s) if reached is Mode.SAFE_STOP else None
        if not alarms:
            return FaultFinding(case, reached, "", None, None)
        return FaultFinding(case, reached, alarms[0].text, alarms[0].t_s - begun_s, standing_s)
    finally:
        clear_faults(bench)
        if " delay " in case.line:  # what is under way arrives yet
            time.sleep(float(case.line.split()[-1]))


def _await(runner: Runner, mode: Mode) -> None:
    end_s = time.monotonic() + _REACH_WALL_S
    while runner.safety.modes.mode is not mode:
        alarms = "; ".join(alarm.text for alarm in runner.safety.alarms.all())
        if alarms or time.monotonic() > end_s:
            raise RuntimeError(f"{mode.value} was not reached: {alarms or runner.safety.modes.mode.value}")
        time.sleep(_LOOK_WALL_S)


def _standing_s(bench: WiredBench, runner: Runner, begun_s: float) -> float | None:
    """Return when, after ``begun_s``, the emulated axes stood; None where they do not."""
    assert bench.board is not None
    end_s = time.monotonic() + _STANDS_WALL_S
    while time.monotonic() < end_s:
        now_s = runner.now_s()
        rates = [np.abs(bench.board.read(device, now_s)[1]).max() for device in ("rails", "turntable")]
        if max(rates) < STANDSTILL:
            return now_s - begun_s
        time.sleep(_LOOK_WALL_S)
    return None


def _say(address: str, line: str) -> None:
    control = FaultControl(address)
    try:
        control.send(line)
    finally:
        control.close()


_AXES: Final = {"rails": ("x", "y", "z"), "turntable": ("roll", "pitch", "yaw")}
_STILL: Final = (Mode.STANDBY, Mode.ARMED, Mode.HOLD)
_WIRE: Final = ("on drop 1", "on corrupt 1", "on delay 0.7", "on link_down")


def matrix(modes: Sequence[Mode] = (Mode.RUNNING, *_STILL)) -> list[FaultCase]:
    """Return every fault of every device in every one of ``modes`` that can have it; motion faults where axes move."""
    cases = []
    for mode in modes:
        for device, axes in _AXES.items():
            cases += [FaultCase(device, line, mode) for line in _WIRE]
            cases += [FaultCase(device, f"on drive_fault {axis}", mode) for axis in axes]
            cases += [FaultCase(device, line, mode, GOES_ON, 1.5) for line in ("on duplicate 1", "on drop 0.02")]
            if mode is Mode.RUNNING:
                cases += [FaultCase(device, "on freeze", mode)]
                cases += [FaultCase(device, f"on stuck {axis}", mode, TRIPS, 6.0) for axis in axes]
                cases += [FaultCase(device, f"on reversed {axis}", mode, TRIPS, 6.0) for axis in axes]
            if mode is not Mode.STANDBY:
                size = "0.05" if device == "rails" else "3"
                cases += [FaultCase(device, f"on jump {axis} {size}", mode) for axis in axes]
        cases += [FaultCase("vmu", line, mode) for line in (*_WIRE, "on freeze")]
        cases += [FaultCase("vmu", line, mode, GOES_ON, 1.5) for line in ("on duplicate 1", "on delay 0.1")]
        cases += [FaultCase("io", line, mode) for line in (*_WIRE, "on estop")]
        cases += [FaultCase("io", "on duplicate 1", mode, GOES_ON, 1.5)]
    return cases


def representatives() -> list[FaultCase]:
    """Return one case for each fault and class of device, in running: axes, eye, lines.

    The turntable stands for what any wire can do to single packets and for the axes' wire, the rails' y axis for what
    axes and drives can do; eye and lines have what makes them miss, late or silent.
    """
    of_any_wire = ("corrupt", "duplicate")

    def stands_for_others(case: FaultCase) -> bool:
        kind, _, rest = case.line.removeprefix("on ").partition(" ")
        if case.device == "rails":
            return kind in AXIS and rest.startswith("y")
        return kind in WIRE if case.device == "turntable" else kind not in of_any_wire

    return [case for case in matrix((Mode.RUNNING,)) if stands_for_others(case)]


TIGHT: Final = (
    "initial.position_m=[2.0, -0.12, 0.12]",
    "initial.attitude_deg=[5.0, 5.0, -5.0]",
    "rig.rails.x.park_m=1.9",
    "rig.rails.following_error_max_m=0.002",
    "rig.rails.following_error_per_speed_s=0.06",
    "rig.turntable.following_error_max_deg=0.15",
    "rig.turntable.following_error_per_speed_s=0.1",
)
"""Settings in which every axis moves from the start, and following errors are as tight as the servos allow."""
