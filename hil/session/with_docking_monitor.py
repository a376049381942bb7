"""A run with the docking monitor of its scenario: in a process of its own, in the loop or after a run in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from hil.config.load import load_scene
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import SCENE_FILE
from hil.core.clock import WallClock
from hil.core.operator_commands import Operator
from hil.errors import DeviceError
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import Ring
from hil.frmn.search_region import SearchRegion
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.runner import Outcome, Runner
from hil.monitor.results import PORTION
from hil.params.sensors import MONITOR, sensors_of
from hil.recording.sinks import RecordingSinks
from hil.session import build
from hil.setup.portion_samples import PortionSamples, PortionSource

if TYPE_CHECKING:
    from hil.setup.docking_monitor import MonitorOutcome, MonitorProcess  # imports OpenCV

_PORTIONS = 64  # in the ring that the loop reads


class MonitorResults:
    """Results of the monitor: of_run returns those of the run that has ended, source those that arrive during it.

    number: of its sensor in the loop, None if it is none. search: sets its region of search, None if it cannot be set.
    """

    def __init__(
        self,
        of_run: Callable[[Outcome], MonitorOutcome | None],
        source: PortionSource | None = None,
        number: int | None = None,
        run_time: RunTime | None = None,
        search: SearchRegion | None = None,
    ) -> None:
        self.search = search
        self._of_run = of_run
        self._source, self._number = source, number
        self._run_time = run_time

    def __call__(self, outcome: Outcome) -> MonitorOutcome | None:
        """Return the results for the run that has ended; None without images."""
        return self._of_run(outcome)

    def attach(self, runner: Runner) -> None:
        """Connect the sensor of the runner's loop, if there is one, and the run's time for a live camera."""
        if self._run_time is not None:
            runner.loop.run_zero.on_change = self._run_time.set_zero
        if runner.loop.sensors is not None and self._source is not None and self._number is not None:
            runner.loop.sensors.sources.append(PortionSamples(self._source, self._number))


@contextmanager
def beside(
    job: build.Job,
    telemetry: Ring,
    clock: WallClock,
    announce: Callable[[str], None],
    sinks: RecordingSinks | None = None,
) -> Iterator[MonitorResults]:
    """Run the scenario's docking monitor, if it has one, on the cycles in ``telemetry`` in a process of its own.

    clock: bench time. Raises DeviceError if that process, or the camera, does not start.
    """
    scenario = job.scenario.value
    if not scenario.monitor.has_images:
        yield MonitorResults(lambda _: None)
        return
    from hil.setup.docking_monitor import LiveClock, MonitorProcess, MonitorRings, RingPortions

    scene = load_scene(scenario.monitor.scene).value
    images, recorded = _rings(sinks)
    portions = recorded or Ring.create(PORTION, _PORTIONS, "portions")
    recorded_time = sinks.run_time if sinks else None
    run_time = recorded_time or RunTime.create()
    live = scenario.monitor.source == "camera"
    rings = MonitorRings(telemetry, images, portions)
    times = LiveClock(clock.epoch_ns, clock.speed, run_time.descriptor) if live else None
    search = SearchRegion.create()
    try:
        with MonitorProcess(scenario, scene, job.rig.value, job.seed, rings, times, search) as process:
            announce("starting the docking monitor; its first start compiles its kernels")
            process.wait_ready()
            announce(f"docking monitor process {process.pid}")
            zero = run_time if recorded_time is None else None
            outcome = lambda _: _results(process, scenario.monitor.scene)  # noqa: E731
            yield MonitorResults(outcome, RingPortions(portions), _number(scenario), zero, search)
    finally:
        search.close()
        if recorded_time is None:
            run_time.close()
        if recorded is None:
            portions.close()


@contextmanager
def runner(
    job: build.Job,
    on_progress: ProgressCallback = lambda *_: None,
    announce: Callable[[str], None] = lambda _: None,
    sinks: RecordingSinks | None = None,
    operator: Operator | None = None,
    prepare: Callable[[build.WiredBench, Runner], None] = lambda *_: None,
) -> Iterator[tuple[Runner, MonitorResults]]:
    """Give a Runner for ``job`` as ``build.runner`` does, and the source of the monitor's results.

    prepare: receives a bench on wires and its Runner. Raises DeviceError if a process does not start.
    """
    scenario, rig, seed = job.scenario.value, job.rig.value, job.seed
    if rig.kind == "mock" and not scenario.monitor.has_images:
        with build.runner(job, on_progress, announce, operator, sinks) as plain:
            yield plain, MonitorResults(lambda _: None)
        return
    if rig.kind == "mock":
        from hil.setup.docking_monitor import CameraMonitor, InLoopMonitor, MonitorSinks

        scene = load_scene(scenario.monitor.scene).value
        with build.runner(job, on_progress, announce, operator, sinks) as in_memory:
            if (number := _number(scenario)) is None or job.paced:  # to render takes longer than a cycle
                yield in_memory, _after_the_run(job, sinks)
                return
            outlets = MonitorSinks(sinks.monitor_image_encoder(rig), sinks.portions) if sinks else MonitorSinks()
            in_loop = InLoopMonitor(CameraMonitor(scenario, scene, rig, seed, outlets), in_memory.loop.telemetry)
            in_memory.loop.telemetry = in_loop
            results = MonitorResults(lambda _: in_loop.finish(), in_loop, number)
            results.attach(in_memory)
            yield in_memory, results
        return
    if job.waits_for_all:
        with build.wired_bench(job, announce, sinks) as bench:
            made = bench.runner(on_progress, operator)
            prepare(bench, made)
            yield made, _after_the_run(job, sinks)
        return
    with ExitStack() as stack:
        bench = stack.enter_context(build.wired_bench(job, announce, sinks))
        assert isinstance(bench.clock, WallClock)
        assert isinstance(bench.telemetry, Ring)
        results = stack.enter_context(beside(job, bench.telemetry, bench.clock, announce, sinks))
        made = bench.runner(on_progress, operator)
        prepare(bench, made)
        results.attach(made)
        yield made, results


def attachments(scenario: Scenario, _: Rig) -> dict[str, str]:
    """Return the attachment of a recording: camera and target as the docking monitor assumes them."""
    return {SCENE_FILE: load_scene(scenario.monitor.scene).value.model_dump_json()}


def _number(scenario: Scenario) -> int | None:
    """Return the number of the docking monitor among the sensors of the loop, None if it is none of them."""
    names = list(sensors_of(scenario))
    return names.index(MONITOR) if MONITOR in names else None


def _after_the_run(job: build.Job, sinks: RecordingSinks | None) -> MonitorResults:
    """Return the results of a docking monitor that looks at the recorded run."""
    scenario, rig = job.scenario.value, job.rig.value
    if not scenario.monitor.has_images:
        return MonitorResults(lambda _: None)
    from hil.setup.docking_monitor import MonitorSinks, monitor_recorded

    scene = load_scene(scenario.monitor.scene).value
    outlets = MonitorSinks(sinks.monitor_image_encoder(rig), sinks.portions) if sinks else MonitorSinks()
    return MonitorResults(lambda outcome: monitor_recorded(scenario, scene, rig, job.seed, outcome.history, outlets))


def _rings(sinks: RecordingSinks | None) -> tuple[Ring | None, Ring | None]:
    """Return the rings of the monitor's images and portions, if a recorder reads them."""
    if sinks is None:
        return None, None
    images, portions = (sink if isinstance(sink, Ring) else None for sink in (sinks.monitor_images, sinks.portions))
    return images, portions


def _results(process: MonitorProcess, scene: str) -> MonitorOutcome:
    """Return the monitor's results, or its failure: a monitor that fails does not end the run."""
    from hil.setup.docking_monitor import MonitorOutcome

    try:
        return process.finish()
    except DeviceError as error:
        return MonitorOutcome(scene, failure=str(error))
