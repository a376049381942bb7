"""From scenario and rig to a bench that can run: the only place that knows which rig it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace

from hil.bench.kinematics import MOTION
from hil.bench.stopping import brake_step
from hil.checks.compatibility import (
    approach_problems,
    driver_problems,
    driver_warnings,
    flight_computer_problems,
    flight_problems,
    host_problems,
    line_problems,
    monitor_problems,
    port_problems,
    sign_off_problems,
)
from hil.checks.truth import truth_problems
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.core.camera_images import MakesPictures
from hil.core.clock import SimulatedClock, WallClock
from hil.core.messages import AXES, CYCLE, new
from hil.core.modes import Mode
from hil.core.operator_commands import Operator
from hil.core.realtime import REAL_TIME, RealTime, SchedulingPolicy
from hil.errors import BadInput, Problem
from hil.frmn.ring import Ring, Telemetry
from hil.loop.bench_stage import Move
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.rate_keeper import Rate, SimulatedRate, WallRate
from hil.loop.runner import Runner
from hil.params import gnc as gnc_params
from hil.processes.emulators import EmulatedDevices
from hil.processes.io_client import TITLES, HostProcesses
from hil.recording.taps import EventRecorder, RecordingSinks
from hil.setup.assembly import Job as Job
from hil.setup.assembly import assemble, library_problems, make_gnc, mocks, start_axes

_FRAMES_TO_ARM = 2
_WARM_UP_CYCLES = 10
FIRST_START = "first start: compiling the kernels for this computer, once, about a minute"  # said before warm_up
TELEMETRY_ROWS = 2048  # 41 s at 50 Hz: how long a reader may look away before it misses something


def check(job: Job) -> None:
    """Raise BadInput with every fault that shows only when scenario and rig meet."""
    problems = [
        *(truth_problems(job.scenario) or flight_problems(job.scenario, job.rig)),
        *approach_problems(job.scenario),
        *monitor_problems(job.scenario),
        *_rig_problems(job),
    ]
    if problems := problems or library_problems(job.scenario) or sign_off_problems(job.rig):
        raise BadInput(problems)


def check_rig(job: Job) -> None:
    """Raise BadInput with every fault that keeps the rig's axes from being moved, whatever for."""
    problems = _rig_problems(job)
    if job.rig.value.kind == "mock":  # stands at the start pose from the beginning
        problems += flight_problems(job.scenario, job.rig)
    if problems:
        raise BadInput(problems)


def _rig_problems(job: Job) -> list[Problem]:
    problems = [
        *port_problems(job.rig),
        *host_problems(job.rig),
        *line_problems(job.scenario, job.rig),
        *driver_problems(job.rig),
        *flight_computer_problems(job.rig),
    ]
    if job.rig.value.kind == "mock" and job.speed != 1.0 and not job.paced:
        problems.append(Problem("--speed", f"{job.speed:g}", "a mock rig has no wall clock: leave --speed away"))
    return problems


@contextmanager
def runner(
    job: Job,
    on_progress: ProgressCallback,
    announce: Callable[[str], None],
    operator: Operator | None = None,
    taps: RecordingSinks | None = None,
) -> Iterator[Runner]:
    """Give a Runner for ``job``; emulators that it needs are started before and ended after.

    announce: told in a line what is being started. operator: gives the orders; None: the run goes
    through by itself. taps: who records it. Raises DeviceError when an emulator does not come up.
    """
    scenario, rig = job.scenario.value, job.rig.value
    if rig.kind == "mock":
        telemetry = taps.cycles if taps else None
        pictures = taps.maker(rig) if taps else None
        with ExitStack() as stack:
            rate: Rate = SimulatedRate(SimulatedClock(), scenario.step_s)
            precedence = None
            if job.paced:
                rate = WallRate(WallClock(speed=job.speed), scenario.step_s)
                precedence = stack.enter_context(RealTime(rig.host.fifo, rig.host.cpu))
            made = in_memory(job, rate, on_progress, precedence, telemetry, operator, pictures)
            if taps:
                taps.attach(made)
            yield made
        return
    with wired_bench(job, announce, taps) as bench:
        yield bench.runner(on_progress, operator)


class WiredBench:
    """A bench on wires with all its processes up; each ``runner`` is a session at it, one after the other.

    pids: of every process, by the name of its device, or HOST and GUARD. addresses: where the emulators
    listen, with the ports where their faults are switched. board: where the emulated axes are. telemetry: each
    cycle's row, for other processes to read.
    """

    def __init__(
        self,
        job: Job,
        rig: Rig,
        clock: WallClock,
        realtime: RealTime,
        hosts: HostProcesses,
        telemetry: Ring,
        taps: RecordingSinks | None,
        emulated: EmulatedDevices | None,
        addresses: dict[str, str],
    ) -> None:
        self.addresses = addresses
        self.board = emulated.board if emulated else None
        self.pids = {**(emulated.pids if emulated else {}), **hosts.pids}
        self._job = job
        self._rig = rig
        self._clock = clock
        self._realtime = realtime
        self._devices = hosts.devices()
        self.telemetry = telemetry
        self._taps = taps
        self.notes: EventRecorder | None = None
        """Where to put down what an operator changes, while a run is recorded."""

    def runner(self, on_progress: ProgressCallback = lambda *_: None, operator: Operator | None = None) -> Runner:
        """Return a Runner of the job."""
        rate = WallRate(self._clock, self._job.scenario.value.step_s)
        made = assemble(
            self._job,
            self._rig,
            rate,
            *self._devices,
            _FRAMES_TO_ARM,
            on_progress,
            operator,
            self._realtime,
            self.telemetry,
        )
        if self._taps:
            self.notes = self._taps.attach(made)
        return made


@contextmanager
def wired_bench(
    job: Job, announce: Callable[[str], None] = lambda _: None, taps: RecordingSinks | None = None
) -> Iterator[WiredBench]:
    """Give the bench of ``job``'s rig, which is not a mock; its processes are ended after.

    announce: told in a line what is being started. taps: who records it. Raises DeviceError when a process does
    not come up.
    """
    rig = job.rig.value
    with RealTime(rig.host.fifo, rig.host.cpu) as realtime:
        _insist_on_realtime(job.rig, realtime)
        for grant in realtime.refused():
            announce(str(grant))
        for line in driver_warnings(rig):
            announce(line)
        wall = WallClock(speed=job.speed)
        with (
            _emulated(job, wall, announce, taps) as (wired, emulated, addresses),
            HostProcesses(wired, wall) as hosts,
            telemetry_ring(taps) as telemetry,
        ):
            hosts.wait_ready()
            for name, pid in hosts.pids.items():
                announce(f"{TITLES[name]} {pid}")
            yield WiredBench(job, wired, wall, realtime, hosts, telemetry, taps, emulated, addresses)


def _insist_on_realtime(rig: Loaded[Rig], realtime: RealTime) -> None:
    """Raise BadInput where hardware would be run by a loop that is not in real time."""
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
def telemetry_ring(taps: RecordingSinks | None) -> Iterator[Ring]:
    """Give the ring that each cycle's row is put into, for other processes to read; a recorder brings its own."""
    if taps:
        if not isinstance(taps.cycles, Ring):
            raise TypeError("a bench on the wall clock is recorded from a ring: its recorder is another process")
        yield taps.cycles
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
    precedence: SchedulingPolicy | None = None,
    telemetry: Telemetry | None = None,
    operator: Operator | None = None,
    pictures: MakesPictures | None = None,
) -> Runner:
    """Return a Runner of ``job`` on mocks, whatever its rig, kept in time by ``rate``.

    pictures: takes those of a rendered vision unit; where ``rate`` keeps the time of the wall it must not wait.
    """
    devices = mocks(job.truth, job.rig.value, job.seed, pictures)
    return assemble(job, job.rig.value, rate, *devices, 0, on_progress, operator, precedence, telemetry)


@contextmanager
def _emulated(
    job: Job, clock: WallClock, announce: Callable[[str], None], taps: RecordingSinks | None
) -> Iterator[tuple[Rig, EmulatedDevices | None, dict[str, str]]]:
    """Give the rig with all its wires; an emulated one gets its emulators for as long as this lasts."""
    rig = job.rig.value
    if rig.kind == "hardware":
        yield rig, None, {}
        return
    pictures = taps.picture_memory() if taps else None
    with EmulatedDevices(job.truth, rig, clock, job.seed, pictures) as emulated:
        wired, addresses = emulated.wait_ready()
        for process in emulated.processes:
            wires = ", ".join(f"{n} on {a}" for n, a in addresses.items() if n.split(".")[0] == process.name)
            announce(f"emulator process {process.pid}: {wires}")
        yield wired, emulated, addresses


def warm_up(job: Job) -> None:
    """Call every kernel of the loop once, in memory: nothing compiles once the bench is powered."""
    scenario, rig = job.scenario.value, job.rig.value
    Move(gnc_params.bench(rig, scenario.step_s), new(AXES), start_axes(scenario, rig)).at(0.1, new(AXES))
    brake_step(gnc_params.bench(rig, scenario.step_s), new(MOTION), new(AXES))
    _a_few_cycles(job).run()


def warm_up_all_but_navigation(job: Job) -> None:
    """Call the kernels of every stage but navigation once."""
    loop = _a_few_cycles(job).loop
    loop.safety_io.open(SimulatedRate(SimulatedClock(), job.scenario.value.step_s))
    now = loop.now
    loop.bench.open(0.0)
    loop.vision.source.open(0.0)
    loop.bench.read(0.0, now.feedback)
    loop.bench.safety.modes.mode = Mode.RUNNING
    loop.bench.seed_for_run(0.0, now.feedback)
    loop.bench.check(0.0, now.feedback)
    loop.bench.brake(0.0, now.setpoint)
    loop.vision.receive(0.0, 0.0, now.row[0])
    gnc = make_gnc(job.scenario.value)
    gnc.guide(0.0, now.supervision, now.reference)
    gnc.supervise(0.0, now.navigation, now.reference, now.supervision)
    gnc.control(now.navigation, now.reference, now.command)
    loop.dss.step(now.truth, now.command)
    loop.dss.sample_imu(now.truth, now.imu)
    loop.bench.follow(now.truth, loop.dss.rate_against_hill(now.truth), 0.0, now.setpoint)


def _a_few_cycles(job: Job) -> Runner:
    """Return a short run of ``job`` on mocks, whatever its rig, and by the GNC here, whoever is to fly it."""
    scenario = job.scenario.value
    flown_here = scenario.model_copy(update={"gnc": scenario.gnc.model_copy(update={"library": None})})
    few = Job(replace(job.scenario, value=flown_here), job.rig, 0, _WARM_UP_CYCLES * scenario.step_s, 1.0)
    return in_memory(few, SimulatedRate(SimulatedClock(), scenario.step_s))
