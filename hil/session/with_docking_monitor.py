"""A run with the docking monitor of its scenario: in a process of its own, or after a run in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hil.config.load import load_scene
from hil.core.operator_commands import Operator
from hil.errors import DeviceError
from hil.frmn.ring import Ring
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.runner import Outcome, Runner
from hil.recording.sinks import RecordingSinks
from hil.session import build

if TYPE_CHECKING:
    from hil.setup.docking_monitor import MonitorOutcome, MonitorProcess  # imports OpenCV

MonitorResults = Callable[[Outcome], "MonitorOutcome | None"]
"""Returns the monitor's results for the run that has ended; None if the scenario has no monitor."""


@contextmanager
def beside(
    job: build.Job, telemetry: Ring, announce: Callable[[str], None], sinks: RecordingSinks | None = None
) -> Iterator[MonitorResults]:
    """Run the scenario's docking monitor, if it has one, on the cycles in ``telemetry`` in a process of its own.

    Raises DeviceError if that process does not start.
    """
    scenario = job.scenario.value
    if scenario.monitor.source == "none":
        yield lambda _: None
        return
    from hil.setup.docking_monitor import MonitorProcess

    scene = load_scene(scenario.monitor.scene).value
    with MonitorProcess(scenario, scene, job.rig.value, job.seed, telemetry, *_rings(sinks)) as process:
        announce("starting the docking monitor; its first start compiles its kernels")
        process.wait_ready()
        announce(f"docking monitor process {process.pid}")
        yield lambda _: _results(process, scenario.monitor.scene)


@contextmanager
def runner(
    job: build.Job,
    on_progress: ProgressCallback = lambda *_: None,
    announce: Callable[[str], None] = lambda _: None,
    sinks: RecordingSinks | None = None,
    operator: Operator | None = None,
) -> Iterator[tuple[Runner, MonitorResults]]:
    """Give a Runner for ``job`` as ``build.runner`` does, and the source of the monitor's results.

    Raises DeviceError if a process does not start.
    """
    scenario, rig, seed = job.scenario.value, job.rig.value, job.seed
    if scenario.monitor.source == "none":
        with build.runner(job, on_progress, announce, operator, sinks) as plain:
            yield plain, lambda _: None
        return
    if rig.kind == "mock":
        from hil.setup.docking_monitor import monitor_recorded

        scene = load_scene(scenario.monitor.scene).value
        with build.runner(job, on_progress, announce, operator, sinks) as in_memory:
            outlets = (sinks.monitor_image_encoder(rig), sinks.portions) if sinks else ()
            yield in_memory, lambda outcome: monitor_recorded(scenario, scene, rig, seed, outcome.history, *outlets)
        return
    with (
        build.wired_bench(job, announce, sinks) as bench,
        beside(job, bench.telemetry, announce, sinks) as results,
    ):
        yield bench.runner(on_progress, operator), results


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
