"""Compilation of the loop's kernels before anything moves."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Final, Self

import numpy as np

from hil.bench.kinematics import MOTION
from hil.bench.stopping import brake_step
from hil.core.clock import SimulatedClock
from hil.core.kernel_folder import kernel_folder, kernel_folder_notice
from hil.core.messages import AXES, new
from hil.core.modes import Mode
from hil.core.sensor_records import SENSOR_SAMPLE
from hil.frmn.ring import NoTelemetry
from hil.loop import core
from hil.loop.bench_stage import Move
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.params import bench as bench_params
from hil.session.assembly import Job, start_axes
from hil.session.build import in_memory, runs_compiled
from hil.session.compiled import Kernels, kernels_are_cached, mark_kernels_cached

if TYPE_CHECKING:
    from hil.core.child_process import ChildProcess

FIRST_START = "first start: compiling the kernels for this computer, once"
_CYCLES = 10
_BESIDE: Final = ({"group": "gnc"}, {"group": "verdict", "niceness": 10})  # nothing waits for the verdict's
_CHILD_WALL_S = 600.0  # a computer that is busy takes several minutes


class Compilation:
    """Compilation of the kernels that ``job`` needs and that are not in the cache, on two cores.

    In simulated time these are the compiled shell's. In real time every kernel of the cycle is also called once:
    nothing is loaded once the bench is powered. As a context it compiles the GNC and the verdict in a child process
    from the start, while the job is checked; its end ends that process.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._group: Kernels = "loop" if runs_compiled(job) else "cycle"
        self._children: list[ChildProcess] = []
        self._notice = ""
        self._processes = ExitStack()

    def __enter__(self) -> Self:
        if not kernels_are_cached(self._group):
            self._notice = kernel_folder_notice()
            if kernel_folder() is not None:
                self._children = self._processes.enter_context(_compilers())
        return self

    def __exit__(self, *_: object) -> None:
        self._processes.close()

    def finish(self, announce: Callable[[str], None]) -> None:
        """Compile the others. announce: receives FIRST_START if there are any, and then the time that they took.

        Before that it receives why they are not in the user's folder, if so; those in memory are compiled by the run.
        """
        if self._notice:
            announce(self._notice)
        if self._children:
            announce(FIRST_START)
            started_s = time.perf_counter()
            _compile_beside(self._children, self._group, self._job)
            announce(f"kernels compiled in {time.perf_counter() - started_s:.1f} s")
        if self._group == "cycle" and (self._job.paced or self._job.rig.value.kind != "mock"):
            warm_up(self._job)


def compile_kernels(job: Job, announce: Callable[[str], None]) -> None:
    """Compile the kernels that a checked ``job`` needs and that are not in the cache, see ``Compilation``."""
    with Compilation(job) as compilation:
        compilation.finish(announce)


def compile_group(group: Kernels, job: Job) -> None:
    """Compile the kernels of ``group``: those of the GNC and of the verdict in a child process, the others here."""
    with _compilers() as children:
        _compile_beside(children, group, job)


def _compile_beside(children: list[ChildProcess], group: Kernels, job: Job) -> None:
    """Compile what ``children`` do not, and wait for them."""
    warm_up_all_but_gnc(job)
    if group == "loop":
        in_memory(_short_job(job, compiled=True), SimulatedRate(SimulatedClock(), job.tick_s)).run()
    else:
        warm_up(job)
    for child in children:
        child.wait_end(_CHILD_WALL_S)
    mark_kernels_cached(group)


@contextmanager
def _compilers() -> Iterator[list[ChildProcess]]:
    """Compile the GNC, and in the time that it leaves to others the verdict, until the end of the context."""
    from hil.core.child_process import ChildProcess  # compiled kernels need no process

    with ExitStack() as processes:
        children = [
            processes.enter_context(ChildProcess(f"precompile process, {each['group']}", "hil.cli.precompile", each))
            for each in _BESIDE
        ]
        try:
            yield children
        finally:
            for child in children:
                child.kill()


def warm_up(job: Job) -> None:
    """Call every kernel of the loop once, in memory: those of a run, and those that move the axes outside of one."""
    scenario, rig = job.scenario.value, job.rig.value
    limits, start = bench_params.bench(rig, scenario.step_s, scenario.bench), start_axes(scenario, rig)
    Move(limits, new(AXES), start).at(0.1, new(AXES))
    brake_step(limits, new(MOTION), new(AXES))
    runner = _short_run(job)
    core.limit_setpoint(limits, runner.loop.memory.state, start)
    runner.loop.bench.safety.jog_guard.check_position(start)
    runner.run()


class _OneSample:
    """A ``SampleSource`` of one sample in each cycle."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self.name, self.failure, self.last_s = "warm-up", "", math.inf

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        return np.zeros(1, SENSOR_SAMPLE)

    def close(self) -> None:
        """Do nothing."""


def warm_up_all_but_gnc(job: Job) -> None:
    """Call the kernels of every stage but the GNC's once."""
    loop = _short_run(job).loop
    loop.safety_io.open(SimulatedRate(SimulatedClock(), job.tick_s))
    loop.bench.open(0.0)
    loop.target.open(0.0)
    loop.vision.source.open(0.0)
    loop.bench.read(0.0)
    loop.bench.safety.modes.mode = Mode.RUNNING
    loop.bench.seed_for_run(0.0)
    loop.bench.check(0.0)
    loop.bench.brake(0.0)
    loop.bench.guard(0.0, 0.0)
    loop.vision.receive(0.0)
    if loop.sensors is not None:
        loop.sensors.receive(0.0, 0.0, 0.0, loop.gnc)
        loop.sensors.record(0)
    loop.dss.step(0)
    loop.bench.follow(0.0)


def _short_run(job: Job) -> Runner:
    """Return a short run of the cycle in Python on mocks, for any rig and any GNC of ``job``.

    Further sensors have a source of their own, as if they were on a wire.
    """
    parts = SessionParts(sample_sources=[_OneSample()], sinks={"sensor_samples": NoTelemetry()})
    return in_memory(_short_job(job, compiled=False), SimulatedRate(SimulatedClock(), job.tick_s), parts)


def _short_job(job: Job, compiled: bool) -> Job:
    """Return a short job on mocks with the built-in GNC, and with modelled poses in place of cameras."""
    scenario = job.scenario.value
    vmu = scenario.vmu.model_copy(update={"source": "model"}) if scenario.vmu.source == "cameras" else scenario.vmu
    builtin = scenario.model_copy(update={"gnc": scenario.gnc.built_in(), "vmu": vmu})
    loaded = replace(job.scenario, value=builtin)
    return Job(loaded, job.rig, 0, _CYCLES * scenario.step_s, 1.0, compiled=compiled)
