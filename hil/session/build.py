"""A bench for a scenario and a rig, ready to run: the only place that depends on the kind of the rig."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass

from hil.checks import compatibility
from hil.checks.abort import check_abort
from hil.checks.bodies import check_bodies
from hil.checks.faults import check_faults, check_sensors
from hil.checks.lock_step import check_lock_step
from hil.checks.signed_record import check_preflight
from hil.checks.truth import check_truth
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.core.camera_images import ImageSink
from hil.core.clock import BenchClock, SimulatedClock, WallClock
from hil.core.lock_step import LockStepConductor
from hil.core.messages import CYCLE
from hil.core.operator_commands import Operator
from hil.core.part import hooks
from hil.core.realtime import REAL_TIME, DefaultScheduling, RealTime, SchedulingPolicy, short_turns, speed_held
from hil.drivers.emulated_devices import EmulatedDevices
from hil.drivers.remote.processes import IoProcesses
from hil.drivers.shared_state import SharedAxisState
from hil.drivers.wire_lock import locked_wires
from hil.errors import BadInput, Problem
from hil.frmn.ring import Ring, Telemetry
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.rate_keeper import LockStepRate, Rate, SimulatedRate, WallClockRate
from hil.loop.runner import Runner
from hil.recording.sinks import EventRecorder, RecordingSinks
from hil.setup.assembly import Devices, RunContext, assemble, core_memory, library_problems, mocks
from hil.setup.assembly import Job as Job
from hil.setup.compiled import compiled_cycles
from hil.setup.compiled import runs_compiled as runs_compiled
from hil.setup.meters import ClockWatch, ExchangeRates, TrueAxesWatch
from hil.setup.sample_sources import wired_sensors

_FRAMES_TO_ARM = 2
_GRID_S = 0.02  # lock-step: longest time between two steps of emulators and servers
TELEMETRY_ROWS = 2048  # 41 s at 50 Hz: a reader that comes later misses rows


def check(job: Job) -> None:
    """Raise BadInput with every problem of the scenario on the rig."""
    problems = [
        *_found_by_parts("check_run", job),
        *(check_truth(job.scenario) or compatibility.check_plan(job.scenario, job.rig)),
        *(compatibility.check_approach(job.scenario) or check_abort(job.scenario)),
        *compatibility.check_scenario_limits(job.scenario, job.rig),
        *(compatibility.check_keep_out(job.scenario) or check_bodies(job.scenario, job.rig)),
        *compatibility.check_monitor(job.scenario, job.rig),
        *check_faults(job.scenario, job.rig),
        *check_sensors(job.scenario, job.rig),
        *_rig_problems(job),
    ]
    problems = problems or library_problems(job.scenario, job.own) or compatibility.check_sign_off(job.rig)
    if problems := problems or check_preflight(job.rig, job.scenario.value.step_s):
        raise BadInput(problems)


def check_rig(job: Job) -> None:
    """Raise BadInput with every problem that prevents any motion of the rig's axes."""
    problems = _rig_problems(job)
    if job.rig.value.kind == "mock":  # its axes start at the start pose
        problems += compatibility.check_plan(job.scenario, job.rig)
    if problems:
        raise BadInput(problems)


def _found_by_parts(name: str, job: Job) -> list[Problem]:
    """Return the problems that the check ``name`` of each part that ``job`` uses has found."""
    scenario, rig = job.scenario, job.rig
    return [each for check in hooks(name, scenario.value, rig.value) for each in check(scenario, rig)]


def _rig_problems(job: Job) -> list[Problem]:
    problems = [
        *compatibility.check_ports(job.rig),
        *compatibility.check_host(job.rig),
        *_found_by_parts("check_rig", job),
        *compatibility.check_io(job.scenario, job.rig),
        *compatibility.check_rates(job.scenario, job.rig),
        *compatibility.check_memory(job.scenario, job.rig),
        *compatibility.check_budget(job.scenario, job.rig),
        *compatibility.check_drivers(job.rig),
        *compatibility.check_flight_computer(job.scenario, job.rig),
        *check_lock_step(job.scenario, job.rig, job.speed),
    ]
    if job.rig.value.kind == "mock" and job.speed != 1.0 and not job.paced:
        problems.append(Problem("--speed", f"{job.speed:g}", "a mock rig does not run in real time: omit --speed"))
    return problems


@contextmanager
def runner(
    job: Job,
    on_progress: ProgressCallback = lambda *_: None,
    announce: Callable[[str], None] = lambda _: None,
    operator: Operator | None = None,
    sinks: RecordingSinks | None = None,
) -> Iterator[Runner]:
    """Give a Runner for ``job``; the processes that it needs run as long as this lasts.

    announce: receives a line for each that is started. operator: gives the commands; None: the run goes through
    unattended. sinks: sinks of a recording. Raises DeviceError if a process does not start.
    """
    if job.rig.value.kind != "mock":
        with wired_bench(job, announce, sinks) as bench:
            yield bench.runner(on_progress, operator)
        return
    rig = job.rig.value
    telemetry, images = (sinks.cycles, sinks.image_encoder(rig)) if sinks else (None, None)
    with ExitStack() as stack:
        rate: Rate = SimulatedRate(SimulatedClock(), job.tick_s)
        scheduling = None
        if job.paced:
            rate = WallClockRate(WallClock(speed=job.speed), job.tick_s)
            scheduling = stack.enter_context(RealTime(rig.host.fifo, rig.host.cpu))
        made = in_memory(job, rate, on_progress, scheduling, telemetry, operator, images)
        if sinks:
            sinks.attach(made)
        yield made


@dataclass
class WiredBench:
    """A bench on wires with all its processes; each ``runner`` is one session at it, one after the other.

    rig: with the wires in use. telemetry: CYCLE of each cycle, for other processes. pids: of every process, by the
    name of its device, or IO and WATCHDOG. pauses: returns those of IO and WATCHDOG by the host, s. addresses: of the
    emulators' wires and control ports. board: state of the emulated axes. event_recorder: of the last runner.
    """

    job: Job
    rig: Rig
    clock: BenchClock
    scheduling: SchedulingPolicy
    devices: Devices
    telemetry: Telemetry
    sinks: RecordingSinks | None
    pids: dict[str, int]
    addresses: dict[str, str]
    board: SharedAxisState | None
    pauses: Callable[[], dict[str, float]] = dict
    event_recorder: EventRecorder | None = None

    def axes_runner(self, on_progress: ProgressCallback = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner without recording, which only moves the axes."""
        step_s = self.job.tick_s
        clock = self.clock
        rate = WallClockRate(clock, step_s) if isinstance(clock, WallClock) else LockStepRate(clock, step_s)
        context = RunContext(
            operator, on_progress, self.scheduling, self.telemetry, _FRAMES_TO_ARM, clock=self.clock
        )  # fmt: skip
        made = assemble(self.job, self.rig, rate, self.devices, context)
        made.process_pauses = self.pauses
        return made

    def runner(self, on_progress: ProgressCallback = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner of the job."""
        made = self.axes_runner(on_progress, operator)
        if self.sinks:
            self.event_recorder = self.sinks.attach(made)
        made.meters["clocks"] = ClockWatch(self.rig.clock).numbers
        rates = ExchangeRates(made.loop.telemetry, {"rails": self.devices.rails, "turntable": self.devices.turntable})
        made.loop.telemetry = rates
        made.meters["exchanges"] = rates.numbers
        if self.board is not None:
            step_s, shown = self.job.scenario.value.step_s, self.job.scenario.value.bench
            watch = TrueAxesWatch(made.loop.telemetry, self.board, self.rig, made.now_s, step_s, shown)
            made.loop.telemetry = watch
            made.meters["bench"] = watch.numbers
        return made


@contextmanager
def wired_bench(
    job: Job, announce: Callable[[str], None] = lambda _: None, sinks: RecordingSinks | None = None
) -> Iterator[WiredBench]:
    """Give the bench of ``job``'s rig, which is not a mock; its processes run as long as this lasts.

    announce: receives a line for each that is started. sinks: sinks of a recording. Raises DeviceError if a process
    does not start.
    """
    rig = job.rig.value
    with (
        _timed(job, announce) as (clock, scheduling),
        _emulators(job, clock, announce, sinks) as (wired, emulated, addresses),
        IoProcesses(wired, clock, emulated.server if emulated else None) as io,
        telemetry_ring(sinks) as telemetry,
    ):
        for line in compatibility.driver_warnings(rig):
            announce(line)
        io.wait_ready()
        for name, pid in io.pids.items():
            announce(f"{name} process {pid}")
        pids = {**(emulated.pids if emulated else {}), **io.pids}
        board = emulated.board if emulated else None
        devices = Devices(*io.devices())
        yield WiredBench(job, wired, clock, scheduling, devices, telemetry, sinks, pids, addresses, board, io.pauses)


@contextmanager
def _timed(job: Job, announce: Callable[[str], None]) -> Iterator[tuple[BenchClock, SchedulingPolicy]]:
    """Give the clock of a bench on wires, and the privileges of its loop, which lock-step does not need."""
    host = job.rig.value.host
    if host.time == "lock_step":
        conductor = LockStepConductor(min(_GRID_S, job.tick_s), host.lock_step_timeout_s)
        with closing(conductor), short_turns():
            yield conductor, DefaultScheduling()
        return
    with RealTime(host.fifo, host.cpu) as realtime:
        _require_realtime(job.rig, realtime)
        for grant in realtime.refused():
            announce(str(grant))
        if job.rig.value.kind == "emulated" and job.speed > speed_held():
            announce(f"--speed {job.speed:g}: this computer keeps the time of an emulated rig up to {speed_held():g}")
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
    """Give the sink of CYCLE: that of a recording, or a ring that other processes read."""
    if sinks:
        yield sinks.cycles
        return
    ring = Ring.create(CYCLE, TELEMETRY_ROWS)
    try:
        yield ring
    finally:
        ring.close()


def in_memory(
    job: Job,
    rate: Rate,
    on_progress: ProgressCallback = lambda *_: None,
    scheduling: SchedulingPolicy | None = None,
    telemetry: Telemetry | None = None,
    operator: Operator | None = None,
    images: ImageSink | None = None,
) -> Runner:
    """Return a Runner of ``job`` on mocks of any rig's devices, timed by ``rate``.

    In simulated time and without an operator its closed loop is the compiled one, if that has all parts of the job.
    images: sink of a rendered vision unit's images; with a paced ``rate`` it must not wait.
    """
    rig = job.rig.value
    memory = core_memory(job, rig)
    made_of = mocks(job.truth, rig, job.seed, memory, images)
    runner = assemble(job, rig, rate, made_of.devices, RunContext(operator, on_progress, scheduling, telemetry), memory)
    if operator is None and isinstance(rate, SimulatedRate) and runs_compiled(job):
        runner.cycles = compiled_cycles(job, runner, rate, made_of)
    return runner


@contextmanager
def _emulators(
    job: Job, clock: BenchClock, announce: Callable[[str], None], sinks: RecordingSinks | None
) -> Iterator[tuple[Rig, EmulatedDevices | None, dict[str, str]]]:
    """Give the rig with all its wires; the emulators of an emulated rig run as long as this lasts."""
    rig = job.rig.value
    if rig.kind == "hardware":
        with locked_wires(rig):
            yield rig, None, {}
        return
    images = sinks.image_memory() if sinks else None
    with EmulatedDevices(job.truth, rig, clock, job.seed, images, wired_sensors(job.truth, rig)) as emulated:
        wired, addresses = emulated.wait_ready()
        for device, pid in emulated.pids.items():
            wires = ", ".join(f"{n} on {a}" for n, a in addresses.items() if emulated.process_of(n) == device)
            announce(f"emulator process {pid}: {wires}")
        yield wired, emulated, addresses
