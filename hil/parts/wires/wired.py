"""A bench on wires with all its processes, and the runners of its sessions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from hil.checks import compatibility
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.core.clock import BenchClock, WallClock
from hil.core.fork_server import ForkServer
from hil.core.messages import CYCLE
from hil.core.operator_commands import Operator
from hil.core.realtime import REAL_TIME, RealTime, SchedulingPolicy
from hil.drivers.remote.processes import IoProcesses
from hil.drivers.wire_lock import locked_wires
from hil.errors import BadInput, Problem
from hil.frmn.ring import Ring, Telemetry
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.rate_keeper import LockStepRate, Rate, WallClockRate
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.parts.wires.line_sensors import line_sensors
from hil.parts.wires.meters import ClockWatch, ExchangeRates
from hil.recording.sinks import EventRecorder, RecordingSinks
from hil.session.assembly import Devices, Job, assemble

_FRAMES_TO_ARM: Final = 2
TELEMETRY_ROWS: Final = 2048  # 41 s at 50 Hz: a reader that comes later misses rows


class Wires(NamedTuple):
    """Wires of a bench and what serves their other ends.

    rig: with the wires in use. server: forks the I/O processes; None: they are started. pids: by the names of devices.
    addresses: of the wires and control ports. board: state of emulated axes, None of real ones. watch: adds to a
    session what is measured of these.
    """

    rig: Rig
    server: ForkServer | None = None
    pids: Mapping[str, int] = MappingProxyType({})
    addresses: Mapping[str, str] = MappingProxyType({})
    board: Any = None
    watch: Callable[[SessionParts, Rate], None] = lambda *_: None


@dataclass
class WiredBench:
    """A bench on wires with all its processes; each ``runner`` is one session at it, one after the other.

    rig: with the wires in use. telemetry: CYCLE of each cycle, for other processes. pids: of every process, by the
    name of its device, or IO and WATCHDOG. pauses: returns those of IO and WATCHDOG by the host, s. addresses: of the
    emulators' wires and control ports. board: state of the emulated axes.
    """

    job: Job
    wires: Wires
    clock: BenchClock
    scheduling: SchedulingPolicy
    devices: Devices
    telemetry: Telemetry
    sinks: RecordingSinks | None
    pids: dict[str, int]
    pauses: Callable[[], dict[str, float]] = field(default=dict)

    def __post_init__(self) -> None:
        self.rig, self.addresses, self.board = self.wires.rig, dict(self.wires.addresses), self.wires.board

    @property
    def event_recorder(self) -> EventRecorder | None:
        """Recorder of events of the last runner, None without a recording."""
        return self.sinks.events if self.sinks else None

    def connect(self, parts: SessionParts) -> None:
        """Add the connections of this bench to ``parts``."""
        parts.scheduling, parts.telemetry, parts.clock, parts.bench = self.scheduling, self.telemetry, self.clock, self
        parts.frames_to_arm, parts.process_pauses = _FRAMES_TO_ARM, self.pauses

    def axes_runner(self, on_progress: ProgressCallback = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner without recording, which only moves the axes."""
        parts = SessionParts(operator, on_progress)
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
        parts.sample_sources[:0] = line_sensors(self.job.scenario.value, self.rig, self.clock)
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
        pids = {**wires.pids, **io.pids}
        yield WiredBench(job, wires, clock, scheduling, Devices(*io.devices()), telemetry, sinks, pids, io.pauses)


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
