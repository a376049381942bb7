"""A bench for a scenario and a rig, ready to run: in memory, or as the part for its kind of rig opens it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from hil.checks import compatibility
from hil.checks.abort import check_abort
from hil.checks.bodies import check_bodies
from hil.checks.ephemeris import check_length
from hil.checks.faults import check_faults, check_sensors
from hil.checks.floating import check_floating
from hil.checks.lock_step import check_lock_step
from hil.checks.observability import check_observability
from hil.checks.truth import check_truth
from hil.checks.wired_imu import check_wired_imu
from hil.core.clock import SimulatedClock, WallClock
from hil.core.operator_commands import Operator
from hil.core.part import hooks, provided
from hil.core.realtime import RealTime
from hil.errors import BadInput, Problem
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.rate_keeper import Rate, SimulatedRate, WallClockRate
from hil.loop.runner import Runner
from hil.loop.session_parts import RunSinks, SessionParts
from hil.session.assembly import Job as Job
from hil.session.assembly import assemble, core_memory, library_problems, mocks
from hil.session.compiled import compiled_cycles
from hil.session.compiled import runs_compiled as runs_compiled

if TYPE_CHECKING:
    from hil.core.camera_images import ImageSink


def check(job: Job) -> None:
    """Raise BadInput with every problem of the scenario on the rig."""
    problems = [
        *_found_by_parts("check_run", job),
        *check_floating(job.scenario, job.rig),
        *check_wired_imu(job.scenario, job.rig),
        *(check_truth(job.scenario) or compatibility.check_plan(job.scenario, job.rig)),
        *check_length(job.scenario, job.cycles * job.scenario.value.step_s),
        *(compatibility.check_approach(job.scenario) or check_abort(job.scenario)),
        *compatibility.check_scenario_limits(job.scenario, job.rig),
        *(compatibility.check_keep_out(job.scenario) or check_bodies(job.scenario, job.rig)),
        *compatibility.check_monitor(job.scenario, job.rig),
        *check_faults(job.scenario, job.rig),
        *check_observability(job.scenario, job.rig),
        *check_sensors(job.scenario, job.rig),
        *_rig_problems(job),
    ]
    problems = problems or library_problems(job.scenario, job.own) or compatibility.check_sign_off(job.rig)
    if not problems and job.rig.value.kind == "hardware":
        from hil.checks.signed_record import check_preflight

        problems = check_preflight(job.rig, job.scenario.value.step_s)
    if problems:
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
    sinks: RunSinks | None = None,
) -> Iterator[Runner]:
    """Give a Runner for ``job``; see ``opened``.

    announce: receives a line for each process that is started. operator: gives the commands; None: the run goes through
    unattended. sinks: sinks of a recording.
    """
    with opened(job, SessionParts(operator, on_progress, announce), sinks) as made:
        yield made


@contextmanager
def opened(job: Job, parts: SessionParts, sinks: RunSinks | None = None) -> Iterator[Runner]:
    """Give a Runner for ``job``, built from ``parts``; the processes that it needs run as long as this lasts.

    Devices and ``sinks`` of a recording add to ``parts``, then the parts of the program that the job uses. Raises
    DeviceError if a process does not start.
    """
    rig = job.rig.value
    with ExitStack() as stack:
        if rig.kind != "mock":
            bench = stack.enter_context(wired_bench(job, parts.announce, sinks))
            bench.connect(parts)
            attach_parts(job, parts, sinks, stack)
            yield bench.built(parts)
            return
        rate: Rate = SimulatedRate(SimulatedClock(), job.tick_s)
        if job.paced:
            rate = WallClockRate(WallClock(speed=job.speed), job.tick_s)
            parts.scheduling = stack.enter_context(RealTime(rig.host.fifo, rig.host.cpu))
        parts.telemetry = sinks["cycles"] if sinks else None
        attach_parts(job, parts, sinks, stack)
        yield in_memory(job, rate, parts, sinks.image_encoder(rig) if sinks else None)


def attach_parts(job: Job, parts: SessionParts, sinks: RunSinks | None, stack: ExitStack) -> None:
    """Let the recording and each part that ``job`` uses add to ``parts``; ``stack`` ends what they have started."""
    if sinks:
        sinks.attach(parts)
    for attach in hooks("attach", job.scenario.value, job.rig.value):
        stack.enter_context(attach(job, parts))


def wired_bench(
    job: Job, announce: Callable[[str], None] = lambda _: None, sinks: RunSinks | None = None
) -> AbstractContextManager[Any]:
    """Return the ``WiredBench`` of ``job``'s rig, which is not a mock; its processes run as long as its context lasts.

    announce: receives a line for each that is started. sinks: sinks of a recording. Raises DeviceError if a process
    does not start.
    """
    rig = job.rig
    bench: AbstractContextManager[Any] = provided(f"rig.kind={rig.value.kind}", rig.source)(job, announce, sinks)
    return bench


def in_memory(job: Job, rate: Rate, parts: SessionParts | None = None, images: ImageSink | None = None) -> Runner:
    """Return a Runner of ``job`` on mocks of any rig's devices, timed by ``rate``.

    In simulated time and without an operator its closed loop is the compiled one, if that has all parts of the job.
    images: sink of a rendered vision unit's images; with a paced ``rate`` it must not wait.
    """
    rig, parts = job.rig.value, parts or SessionParts()
    memory = core_memory(job, rig)
    made_of = mocks(job.truth, rig, job.seed, memory, images)
    compiled = parts.operator is None and isinstance(rate, SimulatedRate)
    cycles = compiled_cycles(job, rate, made_of) if compiled else None  # type: ignore[arg-type]
    return assemble(job, rig, rate, made_of.devices, parts, memory, cycles)
