"""A run with the docking monitor watching, where the scenario wants it: beside the loop, or after a run in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil.config.load import load_scene
from hil.core.operator_commands import Operator
from hil.errors import DeviceError
from hil.frmn.ring import Ring
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.runner import Outcome, Runner
from hil.processes.docking_monitor import MonitorProcess, Watched, watch_recorded
from hil.recording.taps import RecordingSinks
from hil.session import build

Look = Callable[[Outcome], Watched | None]
"""Gives what the monitor saw of the run that has ended; None where there is no monitor."""


@contextmanager
def beside(
    job: build.Job, telemetry: Ring, announce: Callable[[str], None], taps: RecordingSinks | None = None
) -> Iterator[Look]:
    """Let the docking monitor watch the cycles in ``telemetry`` from a process of its own, where the scenario wants it.

    Raises DeviceError when that process does not come up.
    """
    scenario = job.scenario.value
    if scenario.monitor.source == "none":
        yield lambda _: None
        return
    scene = load_scene(scenario.monitor.scene).value
    with MonitorProcess(scenario, scene, job.rig.value, job.seed, telemetry, *_rings(taps)) as process:
        announce("starting the docking monitor; its first start compiles its kernels")
        process.wait_ready()
        announce(f"docking monitor process {process.pid}")
        yield lambda _: _what_is_left(process, scenario.monitor.scene)


@contextmanager
def runner(
    job: build.Job,
    on_progress: ProgressCallback,
    announce: Callable[[str], None],
    taps: RecordingSinks | None = None,
    operator: Operator | None = None,
) -> Iterator[tuple[Runner, Look]]:
    """Give a Runner for ``job`` as ``build.runner`` does, and what to ask for the monitor afterwards.

    Raises DeviceError when an emulator, or the monitor's process, does not come up.
    """
    scenario, rig, seed = job.scenario.value, job.rig.value, job.seed
    if scenario.monitor.source == "none":
        with build.runner(job, on_progress, announce, operator, taps) as plain:
            yield plain, lambda _: None
        return
    if rig.kind == "mock":
        scene = load_scene(scenario.monitor.scene).value
        with build.runner(job, on_progress, announce, operator, taps) as in_memory:
            outlets = (taps.monitor_maker(rig), taps.portions) if taps else ()
            yield in_memory, lambda outcome: watch_recorded(scenario, scene, rig, seed, outcome.history, *outlets)
        return
    with (
        build.wired_bench(job, announce, taps) as bench,
        beside(job, bench.telemetry, announce, taps) as look,
    ):
        yield bench.runner(on_progress, operator), look


def _rings(taps: RecordingSinks | None) -> tuple[Ring | None, Ring | None]:
    """Return the rings for the monitor's pictures and portions, where a recorder reads some."""
    if taps is None:
        return None, None
    pictures, portions = (tap if isinstance(tap, Ring) else None for tap in (taps.monitor_pictures, taps.portions))
    return pictures, portions


def _what_is_left(process: MonitorProcess, scene: str) -> Watched:
    """Return what the monitor saw; a monitor that failed spoils no run, and says so."""
    try:
        return process.finish()
    except DeviceError as error:
        return Watched(scene, failure=str(error))
