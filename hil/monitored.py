"""A run with the docking monitor watching, where the scenario wants it: beside the loop, or after a run in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hil import build
from hil.config.load import load_scene
from hil.errors import DeviceError
from hil.handling import Watch
from hil.monitor_beside import MonitorProcess, Watched, watch_recorded
from hil.orders import Operator
from hil.recording.taps import Taps
from hil.runner import Outcome, Runner

Look = Callable[[Outcome], Watched | None]
"""Gives what the monitor saw of the run that has ended; None where there is no monitor."""


@contextmanager
def runner(
    job: build.Job,
    watch: Watch,
    announce: Callable[[str], None],
    taps: Taps | None = None,
    operator: Operator | None = None,
) -> Iterator[tuple[Runner, Look]]:
    """Give a Runner for ``job`` as ``build.runner`` does, and what to ask for the monitor afterwards.

    Raises DeviceError when an emulator, or the monitor's process, does not come up.
    """
    scenario, rig, seed = job.scenario.value, job.rig.value, job.seed
    if scenario.monitor.source == "none":
        with build.runner(job, watch, announce, operator, taps) as plain:
            yield plain, lambda _: None
        return
    scene = load_scene(scenario.monitor.scene).value
    if rig.kind == "mock":
        with build.runner(job, watch, announce, operator, taps) as in_memory:
            yield in_memory, lambda outcome: watch_recorded(scenario, scene, rig, seed, outcome.history)
        return
    with (
        build.wired_bench(job, announce, taps) as bench,
        MonitorProcess(scenario, scene, rig, seed, bench.telemetry) as process,
    ):
        announce("starting the docking monitor; its first start compiles its kernels")
        process.wait_ready()
        announce(f"docking monitor process {process.pid}")
        yield bench.runner(watch, operator), lambda _: _what_is_left(process, scenario.monitor.scene)


def _what_is_left(process: MonitorProcess, scene: str) -> Watched:
    """Return what the monitor saw; a monitor that failed spoils no run, and says so."""
    try:
        return process.finish()
    except DeviceError as error:
        return Watched(scene, failure=str(error))
