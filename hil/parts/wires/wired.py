"""A bench on wires with all its processes, and the runners of its sessions."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from hil.checks import compatibility
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.core.child_process import ChildProcess
from hil.core.clock import BenchClock, WallClock
from hil.core.fork_server import ForkServer
from hil.core.messages import CYCLE
from hil.core.operator_commands import Operator
from hil.core.plug_ins import place_in
from hil.core.realtime import REAL_TIME, RealTime, SchedulingPolicy
from hil.drivers.imu.driver import WiredImu
from hil.drivers.remote.io_layout import IO
from hil.drivers.remote.processes import IoProcesses
from hil.drivers.wire_lock import locked_wires
from hil.errors import BadInput, BenchError, LinkLost, LinkTimeout, Problem, SafetyTrip
from hil.frmn.ring import Ring, Telemetry
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.rate_keeper import LockStepRate, Rate, WallClockRate
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.parts.wires.meters import ClockWatch, ExchangeRates
from hil.parts.wires.sensors import line_sensors, open_datagrams
from hil.recording.sinks import EventRecorder, RecordingSinks
from hil.session.assembly import Devices, Job, assemble

_FRAMES_TO_ARM: Final = 2
TELEMETRY_ROWS: Final = 2048  # 41 s at 50 Hz: a reader that comes later misses rows


class Wires(NamedTuple):
    """Wires of a bench and what serves their other ends.

    rig: with the wires in use. server: forks the I/O processes; None: they are started. emulators: processes by the
    names of devices. addresses: of the wires and control ports. board: state of emulated axes, None of real ones.
    watch: adds to a session what is measured of these.
    """

    rig: Rig
    server: ForkServer | None = None
    emulators: Mapping[str, ChildProcess] = MappingProxyType({})
    addresses: Mapping[str, str] = MappingProxyType({})
    board: Any = None
    watch: Callable[[SessionParts, Rate], None] = lambda *_: None


@dataclass
class WiredBench:
    """A bench on wires with all its processes; each ``runner`` is one session at it, one after the other.

    rig: with the wires in use. telemetry: CYCLE of each cycle, for other processes. processes: by the names of their
    devices, or IO and WATCHDOG. calls: returns what IO or WATCHDOG calls of plug-ins. pauses: returns those of IO and
    WATCHDOG by the host, s. addresses: of the emulators' wires and control ports. board: state of the emulated axes.
    """

    job: Job
    wires: Wires
    clock: BenchClock
    scheduling: SchedulingPolicy
    devices: Devices
    telemetry: Telemetry
    sinks: RecordingSinks | None
    processes: dict[str, ChildProcess]
    calls: Callable[[str], list[str]]
    pauses: Callable[[], dict[str, float]] = field(default=dict)
    _inquiry: tuple[threading.Thread, list[str]] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.rig, self.addresses, self.board = self.wires.rig, dict(self.wires.addresses), self.wires.board

    @property
    def pids(self) -> dict[str, int]:
        """Numbers of ``processes``."""
        return {name: process.pid for name, process in self.processes.items()}

    @property
    def event_recorder(self) -> EventRecorder | None:
        """Recorder of events of the last runner, None without a recording."""
        return self.sinks.events if self.sinks else None

    def connect(self, parts: SessionParts) -> None:
        """Add the connections of this bench to ``parts``."""
        parts.scheduling, parts.telemetry, parts.clock, parts.bench = self.scheduling, self.telemetry, self.clock, self
        parts.frames_to_arm, parts.process_pauses = _FRAMES_TO_ARM if self.rig.has_vmu else 0, self.pauses
        parts.process_failures = self.failures

    def failures(self, fault: BenchError) -> str | None:
        """Return which processes have ended, and where code of a plug-in hangs, as an addition to ``fault``.

        "" if nothing is known. None while it is being found out, in a thread: a process may take time to answer.
        """
        if not isinstance(self.clock, WallClock):  # in lock-step time stands meanwhile
            return self._found(fault)
        if self._inquiry is None:
            found: list[str] = []
            thread = threading.Thread(target=lambda: found.append(self._found(fault)), name="inquiry", daemon=True)
            self._inquiry = thread, found
            thread.start()
        thread, found = self._inquiry
        if thread.is_alive():
            return None
        self._inquiry = None
        return found[0] if found else ""

    def _found(self, fault: BenchError) -> str:
        """Return what ``failures`` does; the tracebacks that the processes have written go to the log."""
        text, calls = str(fault), [f"calling {each}" for each in self.calls(IO)]
        ended = [each for each in self._all_processes.values() if each.exit_status()]
        if isinstance(fault, LinkTimeout) and fault.device in (IO, *(each.name for each in ended)):  # by lock-step
            texts = calls
        elif ended:  # unless the others have ended because of the one that the fault names
            known = any(each.end_text() in text for each in ended)
            texts = [] if known else [f"{each.name} {each.end_text()}" for each in ended]
        elif isinstance(fault, LinkLost | LinkTimeout | SafetyTrip):
            device = text.partition(":")[0].partition(".")[0]
            of_device = [each for name, each in self.wires.emulators.items() if name.partition(".")[0] == device]
            silent = [each for name, each in self._all_processes.items() if f"{name} process" in text]
            stands = [(each.name, place_in(each.stack(), waits_count=False)) for each in of_device]
            stands += [(each.name, place_in(each.stack())) for each in silent]
            texts = [f"{name} stands {where}" for name, where in stands if where and where not in text]
            texts += calls if f"{IO} process" in text and "calling" not in text else []
        else:
            texts = []
        self.log_tracebacks()
        return f" ({'; '.join(texts)})" if texts else ""

    @property
    def _all_processes(self) -> dict[str, ChildProcess]:
        vision: dict[str, ChildProcess] = getattr(self.devices.source, "processes", {})
        return self.processes | vision

    def log_tracebacks(self) -> None:
        """Write the tracebacks that the processes have written since the last call to the log."""
        for process in self._all_processes.values():
            process.log_traceback()

    def axes_runner(self) -> Runner:
        """Return a Runner without recording, which only moves the axes."""
        parts = SessionParts()
        self.connect(parts)
        return self._assembled(parts, self._rate())

    def runner(self, on_progress: ProgressCallback = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner of the job."""
        parts = SessionParts(operator, on_progress)
        self.connect(parts)
        if self.sinks:
            self.sinks.attach(parts)
        return self.built(parts)

    def built(self, parts: SessionParts) -> Runner:
        """Return a Runner of the job from the connected ``parts``."""
        rate = self._rate()
        parts.meters["clocks"] = ClockWatch(self.rig.clock).numbers
        rates = ExchangeRates({"rails": self.devices.rails, "turntable": self.devices.turntable})
        parts.layers.insert(0, rates.over)
        parts.meters["exchanges"] = rates.numbers
        self.wires.watch(parts, rate)
        return self._assembled(parts, rate)

    def _rate(self) -> Rate:
        clock, step_s = self.clock, self.job.tick_s
        return WallClockRate(clock, step_s) if isinstance(clock, WallClock) else LockStepRate(clock, step_s)

    def _assembled(self, parts: SessionParts, rate: Rate) -> Runner:
        scenario = self.job.scenario.value
        parts.sample_sources[:0] = [
            *open_datagrams(scenario, self.clock),
            *line_sensors(scenario, self.rig, self.clock),
        ]
        if self.rig.imu is not None:
            parts.imu = imu = WiredImu(self.rig.imu, scenario.step_s, self.clock)
            parts.before_open.append(imu.wait_first)
            parts.meters["imu"] = imu.numbers
        return assemble(self.job, self.rig, rate, self.devices, parts)


Timed = AbstractContextManager[tuple[BenchClock, SchedulingPolicy]]
OpenWires = Callable[[Job, BenchClock, Callable[[str], None], RecordingSinks | None], AbstractContextManager[Wires]]


@contextmanager
def wired_bench(
    job: Job,
    announce: Callable[[str], None] = lambda _: None,
    sinks: RecordingSinks | None = None,
    timed: Timed | None = None,
    open_wires: OpenWires | None = None,
) -> Iterator[WiredBench]:
    """Give the bench of ``job``'s rig, which is not a mock; its processes run as long as this lasts.

    announce: receives a line for each that is started. sinks: sinks of a recording. timed: gives clock and privileges
    of the loop; None: in real time. open_wires: gives the wires; None: those of the rig file. Raises DeviceError if a
    process does not start.
    """
    step_s = job.scenario.value.step_s
    with (
        timed or in_real_time(job, announce) as (clock, scheduling),
        (open_wires or _locked)(job, clock, announce, sinks) as wires,
        IoProcesses(wires.rig, clock, wires.server, step_s / wires.rig.ticks(step_s)) as io,
        telemetry_ring(sinks) as telemetry,
    ):
        for line in compatibility.driver_warnings(job.rig.value):
            announce(line)
        io.wait_ready()
        for name, pid in io.pids.items():
            announce(f"{name} process {pid}")
        processes = {**wires.emulators, **io.children}
        devices = Devices(*io.devices())
        bench = WiredBench(job, wires, clock, scheduling, devices, telemetry, sinks, processes, io.calls, io.pauses)
        try:
            yield bench
        finally:
            bench.log_tracebacks()


@contextmanager
def _locked(job: Job, *_: object) -> Iterator[Wires]:
    """Give the wires of a rig of hardware, which no other process may hold."""
    with locked_wires(job.rig.value):
        yield Wires(job.rig.value)


@contextmanager
def in_real_time(job: Job, announce: Callable[[str], None]) -> Iterator[tuple[BenchClock, SchedulingPolicy]]:
    """Give the wall clock and the privileges of the loop."""
    host = job.rig.value.host
    with RealTime(host.fifo, host.cpu) as realtime:
        _require_realtime(job.rig, realtime)
        for grant in realtime.refused():
            announce(str(grant))
        yield WallClock(speed=job.speed), realtime


def _require_realtime(rig: Loaded[Rig], realtime: RealTime) -> None:
    """Raise BadInput if the rig is hardware, requires real time, and the loop is refused it."""
    host = rig.value.host
    if rig.value.kind != "hardware" or not host.require_realtime:
        return
    key = "host.require_realtime"
    problems = [
        Problem(rig.where(key), f"rig.{key}", f"true, but {grant}")
        for grant in realtime.refused()
        if grant.name in REAL_TIME
    ]
    if problems:
        raise BadInput(problems)


@contextmanager
def telemetry_ring(sinks: RecordingSinks | None) -> Iterator[Telemetry]:
    """Give the sink of CYCLE: a recording's, or a ring that other processes read."""
    if sinks:
        yield sinks["cycles"]
        return
    ring = Ring.create(CYCLE, TELEMETRY_ROWS)
    try:
        yield ring
    finally:
        ring.close()
