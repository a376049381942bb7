"""Compiler of one group of kernels into the kernel cache, in a process of its own.

``hil warm-up`` starts one per processor. A program that starts with an empty cache starts one for the GNC, and one of
lowest priority, which may outlive the program, for the compiled loop.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.child_process import Parent
from hil.core.jit import COMPILED_LOOP, mark_kernels_cached, only_one_process
from hil.core.messages import IMU, MAX_POSES, POSE, TRUTH, new
from hil.setup.assembly import Job, make_gnc

_LOWEST_PRIORITY: Final = 19


class _NoPoses:
    poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
    arrived = 0


def _job(*settings: str) -> Job:
    """Return a short run of scheme 1 on the mock rig."""
    return Job(load_scenario("scheme-1", settings), load_rig("mock", settings), 0, 0.2, 1.0)


def _compile_stages() -> None:
    from hil.drivers.axes import axes_of
    from hil.session.warm_up import warm_up_all_but_gnc

    warm_up_all_but_gnc(_job())
    axes_of(load_rig("emulated-machine").value.rails).step(0.001)


def _compile_gnc() -> None:
    from hil.gnc import navigation
    from hil.loop.cycle import CycleData

    gnc = make_gnc(load_scenario("scheme-1").value)
    gnc.step(0.0, CycleData(), _NoPoses())
    fusion, orbit = gnc.state.navigation.fusion, gnc.params.navigation.fusion.orbit
    navigation.normalised_errors(fusion.filters, orbit, new(TRUTH), new(IMU), np.empty(2))


def _compile_loop() -> None:
    from hil.monte_carlo.case_runner import CaseRunner

    job = _job()
    CaseRunner(job.scenario.value, job.rig.value, job.duration_s).run(job.scenario.value, 0)
    mark_kernels_cached(COMPILED_LOOP)


def _compile_checks() -> None:
    from hil.core.clock import SimulatedClock
    from hil.loop.rate_keeper import SimulatedRate
    from hil.report.summary import summarise
    from hil.session import build

    job = _job()
    scenario, rig = job.scenario.value, job.rig.value
    build.check(job)
    outcome = build.in_memory(job, SimulatedRate(SimulatedClock(), job.tick_s)).run()
    summarise(outcome, scenario, rig, rig.name, job.seed, 1.0 / scenario.step_s)


def _compile_study() -> None:
    from hil.monte_carlo.fusion import Study

    Study((), "swapped", 0).bound()


def _compile_vision_unit() -> None:
    from hil.cameras.pose_sensor import make_pose_sensor
    from hil.setup.assembly import start_axes
    from hil.vmu.geometry import geometry_of_rig
    from hil.vmu.unit import VisionUnit

    job = _job("vmu.source=rendered")
    scenario, rig = job.scenario.value, job.rig.value
    VisionUnit(geometry_of_rig(rig)).warm_up()
    sensor, start = make_pose_sensor(scenario, rig, 0), start_axes(scenario, rig)
    for k in range(3):
        sensor.measure(start.rail_m, start.gimbal_rad, k / rig.vmu.rate_hz)


def _compile_docking_monitor() -> None:
    from hil.config.load import load_scene
    from hil.setup.docking_monitor import warm_up

    job = _job("monitor.source=rendered")
    warm_up(job.scenario.value, load_scene(job.scenario.value.monitor.scene).value, job.rig.value)


GROUPS: Final[Mapping[str, Callable[[], None]]] = {
    "gnc": _compile_gnc,
    "stages": _compile_stages,
    "vmu": _compile_vision_unit,
    "monitor": _compile_docking_monitor,
    "loop": _compile_loop,
    "verdict": _compile_checks,
    "fusion": _compile_study,
}
"""Group of kernels -> function that calls each of them once, with the types that programs call them with.

``gnc`` and ``stages`` are those of the cycle, ``vmu`` those of the vision unit, ``monitor`` those of the docking
monitor. The compiled ``loop``, the checks before a run and its ``verdict``, and the ``fusion`` study use kernels of
``CYCLE_GROUPS``, which they take from the cache.
"""
CYCLE_GROUPS: Final = ("gnc", "stages")
USE_CYCLE_GROUPS: Final = ("loop", "verdict", "fusion")


def main() -> None:
    """Compile the group on the command line, or that of the parent; the parent's end ends this process."""
    if len(sys.argv) > 2:
        _compile_in_background(sys.argv[2])
    else:
        _compile_for_parent()


def _compile_in_background(group: str) -> None:
    """Compile ``group`` unless another process does so."""
    os.nice(_LOWEST_PRIORITY)
    with only_one_process(group) as alone:
        if alone:
            GROUPS[group]()


def _compile_for_parent() -> None:
    """Compile the group that the parent names; send how long it took, s."""
    parent = Parent()
    started_s = time.perf_counter()
    GROUPS[parent.configuration["group"]]()
    parent.send(seconds=time.perf_counter() - started_s)


if __name__ == "__main__":
    main()
