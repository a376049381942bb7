"""Compiler of one group of kernels into the kernel cache, in a process of its own.

``hil warm-up`` starts one per processor, a program that starts with an empty cache one for the GNC, and one for the
verdict that leaves the processors to the others. A process that needs an entry that another compiles waits for it.
"""

from __future__ import annotations

import gc
import os
import time
from collections.abc import Callable
from typing import Final

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.child_process import Parent
from hil.core.messages import CYCLE, IMU, MAX_POSES, POSE, TRUTH, new
from hil.core.part import declared, imported
from hil.core.surroundings import GARBAGE_THRESHOLD
from hil.params import dynamics as dynamics_params
from hil.session.assembly import Job, make_gnc
from hil.session.compiled import mark_kernels_cached


class _NoPoses:
    poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
    arrived = 0


def _job(*settings: str) -> Job:
    """Return a short run of scheme 1 on the mock rig."""
    return Job(load_scenario("scheme-1", settings), load_rig("mock", settings), 0, 0.2, 1.0)


def _compile_stages() -> None:
    from hil.core.clock import WallClock
    from hil.drivers.axes import axes_of
    from hil.loop.rate_keeper import WallClockRate
    from hil.session.warm_up import warm_up_all_but_gnc

    WallClockRate(WallClock(), _job().tick_s)
    warm_up_all_but_gnc(_job("monitor.source=model"))
    axes_of(load_rig("emulated-machine").value.rails).step(0.001)


def _compile_gnc() -> None:
    from hil.gnc.estimation import navigation
    from hil.loop.core_memory import CycleData

    gnc = make_gnc(load_scenario("scheme-1").value)
    gnc.step(0.0, CycleData(), _NoPoses())
    fusion, orbit = gnc.state.navigation.fusion, gnc.params.navigation.fusion.orbit
    navigation.normalised_errors(fusion.filters, orbit, new(TRUTH), new(IMU), np.empty(2))


def _compile_loop() -> None:
    from hil.core.clock import SimulatedClock
    from hil.loop.rate_keeper import SimulatedRate
    from hil.session import build

    job = _job()
    build.in_memory(job, SimulatedRate(SimulatedClock(), job.tick_s)).run()
    mark_kernels_cached("loop")


def _compile_verdict() -> None:
    from hil.checks.ephemeris import ephemeris_warnings
    from hil.checks.go_level import go_warnings
    from hil.report.summary import control_numbers
    from hil.report.tally import Tally

    job = _job()
    scenario, rig = job.scenario.value, job.rig.value
    rows = np.zeros(50, CYCLE)  # of a chaser that stands at its start
    rows["t_s"] = scenario.step_s * np.arange(len(rows))
    rows["sampled_s"] = rows["t_s"][:, np.newaxis]
    rows["truth"] = dynamics_params.initial_truth(scenario)
    rows["navigation"]["valid"] = 1
    for name in ("r_CT_H", "q_CH"):
        rows["navigation"][name] = rows["truth"][name]
    rows["pose"]["fresh"], rows["pose"]["t_s"] = 1, rows["t_s"]
    for name in ("covariance_position", "covariance_attitude"):
        rows["pose"][name] = np.eye(3)
    tally = Tally(scenario, rig)
    tally.add(rows)
    tally.numbers()
    control_numbers(rows, scenario)
    go_warnings(scenario, rig)
    ephemeris_warnings(scenario, rig, 1.0)


def _compile_checks() -> None:
    from hil.session import build

    build.check(_job())
    _compile_verdict()


_GROUPS: Final[dict[str, Callable[[], None]]] = {
    "gnc": _compile_gnc,
    "stages": _compile_stages,
    "loop": _compile_loop,
    "verdict": _compile_checks,
}


def groups() -> dict[str, Callable[[], None]]:
    """Return the groups of kernels: functions that call each kernel once, with the types that programs call it with.

    ``gnc`` and ``stages`` are those of the cycle; then the compiled ``loop``, and the checks before a run with its
    ``verdict``; the others are those of parts.
    """
    return _GROUPS | {name: lambda path=path: imported(path)() for name, path in declared("kernels").items()}


def main() -> None:
    """Compile the group that the parent names; send how long it took, s. The parent's end ends this process."""
    gc.set_threshold(GARBAGE_THRESHOLD)  # searches were a tenth of the compiler's time
    parent = Parent()
    os.nice(parent.configuration.get("niceness", 0))
    started_s = time.perf_counter()
    groups()[parent.configuration["group"]]()
    parent.send(seconds=time.perf_counter() - started_s)


if __name__ == "__main__":
    main()
