"""Fault matrix: each fault of each emulated device in each applicable mode, with the reaction of the bench.

    python sims/fault_matrix.py [running|standby|armed|hold ...] [--lock-step] [--console|--unattended] [KEY=VALUE ...]

--lock-step: the same reactions to the bit whatever the load; their digest is printed. --console: the commands come
from an operator at the console; --unattended: only running.
Each case runs a session on the emulated bench up to a mode, switches one fault on, and reports the time of detection,
the reached mode, the text of the alarm and the time until the axes are at rest (docs/explanation/safety.md).
Exit code 1 if a reaction is not as expected.
"""

from __future__ import annotations

import hashlib
import json
import re
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from hil.api.jobs import IN_LOCK_STEP
from hil.config.load import load_rig, load_scenario
from hil.config.tables.faults import EMULATED
from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.frmn.mailbox import MailboxBlock
from hil.loop.rate_keeper import Tick
from hil.loop.runner import Runner
from hil.parts.console.remote_operator import OutgoingMessages, RemoteOperator
from hil.parts.console.status import CELLS
from hil.parts.emulation.fault_injection import FaultControl
from hil.parts.wires.wired import WiredBench
from hil.session.build import Job, check, wired_bench
from hil.session.warm_up import warm_up


class Attendance(Enum):
    """Who commands the session."""

    SCRIPT = "script"  # of an operator who is present
    CONSOLE = "console"
    UNATTENDED = "unattended"


TRIPS, CONTINUES = "trips", "continues"
_ADDRESS: Final = re.compile(r"127\.0\.0\.1:\d+|/dev/pts/\d+")  # given by the system
_CYCLE_S: Final = 0.02
STANDSTILL: Final = 2e-3  # m/s or rad/s
_PLANS: Final = {
    Mode.STANDBY: (OperatorCommand.HOME,),
    Mode.ARMED: (OperatorCommand.HOME, OperatorCommand.ARM),
    Mode.RUNNING: (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
    Mode.HOLD: (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
}
_MODE_TIMEOUT_S: Final = 60.0
_IN_MODE_S: Final = 0.4  # before the fault is switched on
_REST_TIMEOUT_S: Final = 8.0  # from the fault
_LEASE_WALL_S: Final = 2.0
_PRESENCE_WALL_S: Final = 0.05
_BETWEEN_ORDERS_WALL_S: Final = 0.3  # the mode follows an order in the next cycle


@dataclass(frozen=True)
class FaultCase:
    """One fault. line: command to the control port of ``device``. watched_s: time allowed for the alarm."""

    device: str
    line: str
    mode: Mode = Mode.RUNNING
    expected: str = TRIPS
    watched_s: float = 3.0

    @property
    def name(self) -> str:
        return f"{self.device} {self.line.removeprefix('on ')} in {self.mode.value}"


@dataclass(frozen=True)
class FaultReaction:
    """Reaction. detected_s, at_rest_s: bench time from the fault to the alarm, and until all axes were at rest."""

    case: FaultCase
    reached: Mode
    alarm: str
    detected_s: float | None
    at_rest_s: float | None

    @property
    def as_expected(self) -> bool:
        if self.case.expected == CONTINUES:
            return self.detected_s is None and not self.alarm
        return self.reached is Mode.SAFE_STOP and self.detected_s is not None and self.at_rest_s is not None


class ConsoleLine:
    """Line of a console with an operator who has the command: sends the commands of a plan as they are allowed.

    operator: the end in the loop.
    """

    def __init__(self, plan: Sequence[OperatorCommand]) -> None:
        self._here, self._there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._here.setblocking(False)
        self._status = MailboxBlock.create(CELLS, "console")
        self.operator = RemoteOperator(OutgoingMessages(self._there), self._status["status"], "hold", _LEASE_WALL_S)
        self._plan = list(plan)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._talk, name="console", daemon=True)

    def begin(self, runner: Runner) -> None:
        """Attach the runner and begin to send."""
        self.operator.attach(runner)
        self._runner = runner
        self._thread.start()

    def close(self) -> None:
        """End the line."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        for each in (self._here, self._there, self._status):
            each.close()

    def _talk(self) -> None:
        number, sent_s = 0, 0.0
        while not self._ended.wait(_PRESENCE_WALL_S):
            self._send(present=True)
            with suppress(BlockingIOError):
                while self._here.recv(1 << 18):
                    pass
            allowed = self._plan and self._runner.safety.modes.mode in self._plan[0].modes
            if allowed and time.monotonic() - sent_s > _BETWEEN_ORDERS_WALL_S:
                number, sent_s = number + 1, time.monotonic()
                self._send(order=self._plan.pop(0).value, confirmed=True, id=number)

    def _send(self, **message: Any) -> None:
        with suppress(BlockingIOError):
            self._here.send(json.dumps(message).encode())


def run_case(bench: WiredBench, case: FaultCase, by: Attendance = Attendance.SCRIPT) -> FaultReaction:
    """Run a session at ``bench`` up to ``case.mode`` and switch the fault on; all faults are off afterwards.

    Raises RuntimeError if the mode was not reached.
    """
    plan = _PLANS[case.mode]
    if by is not Attendance.CONSOLE:
        return _run(bench, case, Operator(plan, attended=by is Attendance.SCRIPT))
    line = ConsoleLine(plan)
    try:
        return _run(bench, case, line.operator, line.begin)
    finally:
        line.close()


def _run(
    bench: WiredBench, case: FaultCase, operator: Operator, begin: Callable[[Runner], None] = lambda _: None
) -> FaultReaction:
    runner = bench.runner(operator=operator)
    begin(runner)
    injection = _Injection(bench, runner, operator, case)
    wait = runner.rate.wait

    def wait_and_act() -> Tick:
        tick = wait()
        injection.act(tick.now_s)
        return tick

    runner.rate.wait = wait_and_act  # type: ignore[method-assign]
    stop = runner.run().stop
    end_s = runner.now_s() + _REST_TIMEOUT_S
    while injection.reaction is None and runner.now_s() < end_s:  # axes without torque may still move
        injection.act(runner.now_s())
        bench.clock.sleep(_CYCLE_S)
    if injection.reaction is None:
        clear_faults(bench)
        raise RuntimeError(injection.failure or f"{case.mode.value} was not reached: {stop}")
    return injection.reaction


class _Injection:
    """What is done in each cycle of a session: the fault is switched on, its reaction awaited, the session ended."""

    def __init__(self, bench: WiredBench, runner: Runner, operator: Operator, case: FaultCase) -> None:
        self.reaction: FaultReaction | None = None
        self.failure = ""
        self._bench, self._runner, self._operator, self._case = bench, runner, operator, case
        self._steps = self._script()
        self._now_s = 0.0

    def act(self, now_s: float) -> None:
        """Do what is due at ``now_s`` of bench time."""
        self._now_s = now_s
        next(self._steps, None)

    def _script(self) -> Iterator[None]:
        """Yield until the next cycle."""
        case, modes = self._case, self._runner.safety.modes
        first = Mode.RUNNING if case.mode is Mode.HOLD else case.mode
        yield from self._await(first)
        if case.mode is Mode.HOLD and not self.failure:
            self._operator.submit(OperatorCommand.HOLD)
            yield from self._await(case.mode)
        if not self.failure:
            start_s = self._now_s
            _send(self._bench.addresses[f"{case.device}.faults"], case.line)
            while modes.mode is not Mode.SAFE_STOP and self._now_s - start_s < case.watched_s:
                yield
            yield from self._judge(start_s)
        clear_faults(self._bench)
        if " delay " in case.line:  # delayed messages still arrive
            yield from self._pass(float(case.line.split()[-1]))
        self._operator.submit(OperatorCommand.STOP)

    def _await(self, mode: Mode) -> Iterator[None]:
        end_s = self._now_s + _MODE_TIMEOUT_S
        while self._runner.safety.modes.mode is not mode:
            alarms = "; ".join(alarm.text for alarm in self._runner.safety.alarms.all())
            if alarms or self._now_s > end_s:
                found = alarms or self._runner.safety.modes.mode.value
                self.failure = f"{mode.value} was not reached: {found}"
                return
            yield
        yield from self._pass(_IN_MODE_S)

    def _pass(self, duration_s: float) -> Iterator[None]:
        end_s = self._now_s + duration_s
        while self._now_s < end_s:
            yield

    def _judge(self, start_s: float) -> Iterator[None]:
        reached = self._runner.safety.modes.mode
        at_rest_s = None
        while reached is Mode.SAFE_STOP and at_rest_s is None and self._now_s - start_s < _REST_TIMEOUT_S:
            if self._is_at_rest():
                at_rest_s = self._now_s - start_s
            else:
                yield
        alarms = self._runner.safety.alarms.all()
        detected_s = alarms[0].t_s - start_s if alarms else None
        text = alarms[0].text if alarms else ""
        self.reaction = FaultReaction(self._case, reached, text, detected_s, at_rest_s if alarms else None)

    def _is_at_rest(self) -> bool:
        board = self._bench.board
        assert board is not None
        return all(
            float(np.abs(board.read(device, self._now_s)[1]).max()) < STANDSTILL for device in ("rails", "turntable")
        )


def clear_faults(bench: WiredBench) -> None:
    """Switch all faults of all emulators off."""
    for name, address in bench.addresses.items():
        if name.endswith(".faults"):
            _send(address, "clear")


def _send(address: str, line: str) -> None:
    control = FaultControl(address)
    try:
        control.send(line)
    finally:
        control.close()


_AXES: Final = {"rails": ("x", "y", "z"), "turntable": ("roll", "pitch", "yaw")}
_STILL: Final = (Mode.STANDBY, Mode.ARMED, Mode.HOLD)
_WIRE: Final = ("on drop 1", "on corrupt 1", "on delay 0.7", "on link_down")


def matrix(modes: Sequence[Mode] = (Mode.RUNNING, *_STILL)) -> list[FaultCase]:
    """Return each fault of each device in each applicable mode of ``modes``; motion faults only in RUNNING."""
    cases = []
    for mode in modes:
        for device, axes in _AXES.items():
            cases += [FaultCase(device, line, mode) for line in _WIRE]
            cases += [FaultCase(device, f"on drive_fault {axis}", mode) for axis in axes]
            cases += [FaultCase(device, line, mode, CONTINUES, 1.5) for line in ("on duplicate 1", "on drop 0.01")]
            if mode is Mode.RUNNING:
                cases += [FaultCase(device, "on freeze", mode)]
                cases += [FaultCase(device, f"on stuck {axis}", mode, TRIPS, 6.0) for axis in axes]
                cases += [FaultCase(device, f"on reversed {axis}", mode, TRIPS, 6.0) for axis in axes]
            if mode is not Mode.STANDBY:
                size = "0.05" if device == "rails" else "3"
                cases += [FaultCase(device, f"on jump {axis} {size}", mode) for axis in axes]
        cases += [FaultCase("vmu", line, mode) for line in (*_WIRE, "on freeze")]
        cases += [FaultCase("vmu", line, mode, CONTINUES, 1.5) for line in ("on duplicate 1", "on delay 0.1")]
        cases += [FaultCase("io", line, mode) for line in (*_WIRE, "on estop")]
        cases += [FaultCase("io", "on duplicate 1", mode, CONTINUES, 1.5)]
    return cases


def representatives() -> list[FaultCase]:
    """Return one case for each fault and class of device in RUNNING: axes, vision unit, digital lines.

    The turntable represents the faults of any link, the rails' y axis those of axes and drives; vision unit and
    digital lines have the faults that lose or delay their messages.
    """
    of_any_link = ("corrupt", "duplicate")

    def represents(case: FaultCase) -> bool:
        kind, _, rest = case.line.removeprefix("on ").partition(" ")
        if case.device == "rails":
            return kind in EMULATED["drive"] and rest.startswith("y")
        return kind in EMULATED["wire"] if case.device == "turntable" else kind not in of_any_link

    return [case for case in matrix((Mode.RUNNING,)) if represents(case)]


TIGHT: Final = (
    "initial.position_m=[2.0, -0.12, 0.12]",
    "initial.attitude_deg=[5.0, 5.0, -5.0]",
    "rig.rails.x.park_m=1.9",
    "rig.rails.following_error_max_m=0.002",
    "rig.rails.following_error_per_speed_s=0.06",
    "rig.turntable.following_error_max_deg=0.15",
    "rig.turntable.following_error_per_speed_s=0.1",
)
"""Settings in which all axes move from the start, with following-error limits as tight as the servos allow."""


def main(arguments: list[str]) -> int:
    by = next((each for each in Attendance if f"--{each.value}" in arguments), Attendance.SCRIPT)
    lock_step = "--lock-step" in arguments
    named = [Mode(word) for word in arguments if "=" not in word and not word.startswith("--")]
    modes = named or ([Mode.RUNNING] if by is Attendance.UNATTENDED else [Mode.RUNNING, *_STILL])
    settings = (*TIGHT, *(IN_LOCK_STEP if lock_step else ()), *(word for word in arguments if "=" in word))
    job = Job(load_scenario("scheme-1", settings), load_rig("emulated", settings), 0, 60.0, 1.0)
    check(job)
    warm_up(job)
    console = Console()
    reactions: list[FaultReaction] = []
    with wired_bench(job) as bench:
        clear_faults(bench)
        for case in matrix(modes):
            try:
                reaction = run_case(bench, case, by)
            except RuntimeError as error:
                console.print(f"NOT RUN {case.name}: {error}", highlight=False, soft_wrap=True)
                reactions.append(FaultReaction(case, Mode.OFF, str(error), None, None))
                continue
            reactions.append(reaction)
            status = "ok  " if reaction.as_expected else "MISSED"
            console.print(f"{status} {case.name}: {reaction.alarm or 'continues'}", highlight=False, soft_wrap=True)
    for mode in modes:
        console.print(_table(reactions, mode))
    missed = [reaction.case.name for reaction in reactions if not reaction.as_expected]
    console.print(f"{len(reactions)} cases, {len(missed)} not as expected {missed or ''}")
    if lock_step:
        text = _ADDRESS.sub("", repr(reactions))
        console.print(f"digest {hashlib.sha256(text.encode()).hexdigest()[:16]}", highlight=False)
    return 1 if missed else 0


def _table(reactions: list[FaultReaction], mode: Mode) -> Table:
    """Return a table of faults by device: milliseconds until detection, and until all axes were at rest."""
    here = {(f.case.device, f.case.line.removeprefix("on ")): f for f in reactions if f.case.mode is mode}
    devices = list(dict.fromkeys(device for device, _ in here))
    table = Table("fault", *devices, title=f"{mode.value}: detected / at rest, ms")
    for line in dict.fromkeys(line for _, line in here):
        table.add_row(line, *(_cell(here[d, line]) if (d, line) in here else "" for d in devices))
    return table


def _cell(reaction: FaultReaction) -> str:
    if reaction.detected_s is None:
        return "continues" if reaction.as_expected else "MISSED"
    at_rest = "moving" if reaction.at_rest_s is None else f"{1e3 * reaction.at_rest_s:.0f}"
    return f"{1e3 * reaction.detected_s:.0f} / {at_rest}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
