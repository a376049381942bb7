"""Docking monitor of a session: in a process of its own next to the loop, in the loop, or after a run in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hil.config.load import load_rig, load_scenario, load_scene
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import SCENE_FILE
from hil.core.clock import WallClock
from hil.errors import DeviceError
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import NoTelemetry, Ring
from hil.frmn.search_region import SearchRegion
from hil.loop.outcome import Outcome
from hil.loop.session_parts import PartResult, SessionParts
from hil.params.sensors import MONITOR, sensors_of
from hil.parts.monitor.portion_samples import PortionSamples, PortionSource
from hil.parts.monitor.results import PORTION, portion_row
from hil.recording.sinks import encoder
from hil.session import build

if TYPE_CHECKING:
    from hil.parts.monitor.setup import MonitorOutcome, MonitorProcess  # imports OpenCV

_PORTIONS = 64  # in the ring that the loop reads


class MonitorResults(NamedTuple):
    """Results of the monitor: of_run returns them after the run, source as they arrive."""

    of_run: Callable[[Outcome], MonitorOutcome]
    source: PortionSource | None = None


@contextmanager
def beside(job: build.Job, parts: SessionParts, telemetry: Ring, clock: WallClock) -> Iterator[MonitorResults]:
    """Run the scenario's docking monitor on the cycles in ``telemetry`` in a process of its own.

    clock: bench time. Raises DeviceError if that process, or the camera, does not start.
    """
    from hil.parts.monitor.setup import LiveClock, MonitorProcess, MonitorRings, RingPortions

    scenario = job.scenario.value
    scene = load_scene(scenario.monitor.scene).value
    images, recorded = _ring(parts, "monitor_images"), _ring(parts, "portions")
    portions = recorded or Ring.create(PORTION, _PORTIONS, "portions")
    run_time, search = RunTime(), SearchRegion()
    live = scenario.monitor.source == "camera"
    times = LiveClock(clock.epoch_ns, clock.speed, run_time.descriptor) if live else None
    rings = MonitorRings(telemetry, images, portions)
    parts.controls["search"] = search
    parts.on_run_zero.append(run_time.set_zero)
    try:
        with MonitorProcess(scenario, scene, job.rig.value, job.seed, rings, times, search) as process:
            parts.announce("starting the docking monitor; its first start compiles its kernels")
            process.wait_ready()
            parts.announce(f"docking monitor process {process.pid}")
            outcome = lambda _: _results(process, scenario.monitor.scene)  # noqa: E731
            yield MonitorResults(outcome, RingPortions(portions))
    finally:
        search.close()
        run_time.close()
        if recorded is None:
            portions.close()


def _ring(parts: SessionParts, name: str) -> Ring | None:
    """Return the ring of the sink ``name``, if a recorder reads it."""
    sink = parts.sinks.get(name)
    return sink if isinstance(sink, Ring) else None


@contextmanager
def attach(job: build.Job, parts: SessionParts) -> Iterator[None]:
    """Add the scenario's docking monitor on images to ``parts``."""
    number = _number(job.scenario.value)
    with _monitor_of(job, parts, number) as results:
        if results.source is not None and number is not None:
            parts.sample_sources.append(PortionSamples(results.source, number))
        parts.results.append(lambda outcome: part_result(job, outcome, results.of_run(outcome)))
        yield


def part_result(job: build.Job, outcome: Outcome, watched: MonitorOutcome) -> PartResult:
    """Return what the run of ``job`` has of the monitor: errors and sigmas, and its portions."""
    from hil.parts.monitor.report import judge_monitor  # slow imports

    numbers = judge_monitor(watched, outcome.history, job.scenario.value, job.rig.value)
    rows = np.concatenate([np.zeros(0, PORTION), *map(portion_row, watched.portions)])
    return PartResult("monitor", numbers, {"portions": rows})


@contextmanager
def _monitor_of(job: build.Job, parts: SessionParts, number: int | None) -> Iterator[MonitorResults]:
    """Give the results of the monitor. number: of its sensor in the loop, None if it is none of them."""
    scenario, rig, sinks = job.scenario.value, job.rig.value, parts.sinks
    if isinstance(parts.clock, WallClock) and isinstance(parts.telemetry, Ring):
        with beside(job, parts, parts.telemetry, parts.clock) as results:
            yield results
        return
    from hil.parts.monitor.setup import CameraMonitor, InLoopMonitor, MonitorSinks, monitor_recorded

    scene = load_scene(scenario.monitor.scene).value
    images, portions = sinks.get("monitor_images", NoTelemetry()), sinks.get("portions", NoTelemetry())
    outlets = MonitorSinks(encoder(images, rig), portions)
    if rig.kind != "mock" or job.paced or number is None:  # to render takes longer than a cycle
        yield MonitorResults(lambda o: monitor_recorded(scenario, scene, rig, job.seed, o.history, outlets))
        return
    in_loop = InLoopMonitor(CameraMonitor(scenario, scene, rig, job.seed, outlets))
    parts.layers.append(in_loop.over)
    yield MonitorResults(lambda _: in_loop.finish(), in_loop)


def compile_kernels() -> None:
    """Call the kernels of the docking monitor once."""
    from hil.parts.monitor.setup import warm_up

    scenario = load_scenario("scheme-1", ("monitor.source=rendered",)).value
    warm_up(scenario, load_scene(scenario.monitor.scene).value, load_rig("mock").value)


def attachments(scenario: Scenario, _: Rig) -> dict[str, str]:
    """Return the attachment of a recording: camera and target as the docking monitor assumes them."""
    return {SCENE_FILE: load_scene(scenario.monitor.scene).value.model_dump_json()}


def _number(scenario: Scenario) -> int | None:
    """Return the number of the docking monitor among the sensors of the loop, None if it is none of them."""
    names = list(sensors_of(scenario))
    return names.index(MONITOR) if MONITOR in names else None


def _results(process: MonitorProcess, scene: str) -> MonitorOutcome:
    """Return the monitor's results, or its failure: a monitor that fails does not end the run."""
    from hil.parts.monitor.setup import MonitorOutcome

    try:
        return process.finish()
    except DeviceError as error:
        return MonitorOutcome(scene, failure=str(error))
