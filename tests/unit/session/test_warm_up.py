"""Compilation before a run: a run waits for the kernels that it calls, and for no others."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import pytest

from hil.parts.console.session import Choice
from hil.session import warm_up
from hil.session.assembly import Job
from hil.session.warm_up import FIRST_START, compile_kernels
from tests.support.run_settings import make_job

Steps = list[str]
CacheWith = Callable[..., Steps]


@pytest.fixture
def cache_with(monkeypatch: pytest.MonkeyPatch) -> CacheWith:
    """Return a function that fills the kernel cache with groups; it returns the list of what is done from then on."""

    def fill(*groups: str) -> Steps:
        done: Steps = []
        monkeypatch.setattr(warm_up, "kernels_are_cached", lambda group: group in groups)
        monkeypatch.setattr(warm_up, "_compile_beside", lambda _, group, __: done.append(f"compile the {group}"))
        monkeypatch.setattr(warm_up, "_compilers", lambda: nullcontext(["a process"]))
        monkeypatch.setattr(warm_up, "warm_up", lambda *_: done.append("call all kernels"))
        return done

    return fill


@pytest.fixture
def job() -> Job:
    return make_job(1.0)


def test_simulated_run_with_the_loop_in_the_cache_waits_for_nothing(cache_with: CacheWith, job: Job) -> None:
    done = cache_with("loop")
    compile_kernels(job, lambda _: None)
    assert done == []


def test_first_simulated_run_compiles_the_loop_with_a_notice(cache_with: CacheWith, job: Job) -> None:
    done, words = cache_with("cycle"), []
    compile_kernels(job, words.append)
    assert done == ["compile the loop"]
    assert words[0] == FIRST_START
    assert words[1].startswith("kernels compiled in ")


def test_first_run_in_real_time_compiles_the_cycle(cache_with: CacheWith, job: Job) -> None:
    done = cache_with("loop")
    compile_kernels(replace(job, paced=True), lambda _: None)
    assert done == ["compile the cycle", "call all kernels"]


def test_run_in_real_time_calls_all_kernels_beforehand(cache_with: CacheWith, job: Job) -> None:
    done = cache_with("cycle")
    compile_kernels(replace(job, paced=True), lambda _: None)
    assert done == ["call all kernels"]


MOVES = """
import hil
from hil.core.jit import KernelCache
from hil.session.warm_up import warm_up
from tests.support.run_settings import make_job

near = {"initial.position_m": [0.5, 0.01, -0.01], "duration_s": 2.0}
near |= {f"rig.rails.{axis}.park_m": place for axis, place in zip("xyz", near["initial.position_m"])}
bench, loaded, load = hil.Bench("mock", "scheme-1", overrides=near), [], KernelCache.load_overload
warm_up(make_job(1.0))
with bench:
    KernelCache.load_overload = lambda self, *rest: loaded.append(self._function.__qualname__) or load(self, *rest)
    bench.home()
    bench.jog("rails.x", 1, 0.2)
    bench.arm()
    print("loaded:", loaded)
"""


def test_axes_move_outside_of_a_run_without_another_kernel() -> None:
    """A kernel that is compiled while the bench is powered keeps the loop silent for longer than its drives wait."""
    done = subprocess.run([sys.executable, "-c", MOVES], capture_output=True, text=True, check=False)
    assert done.stdout.endswith("loaded: []\n"), done.stdout + done.stderr


RUN = """
import collections, math, sys
from dataclasses import replace
import numpy as np
from hil.core.jit import KernelCache
from hil.core.operator_commands import Operator, OperatorCommand
from hil.core.sensor_records import SENSOR_SAMPLE
from hil.frmn.ring import NoTelemetry
from hil.session.build import runner
from hil.session.warm_up import compile_kernels
from tests.support.run_settings import make_job

class Wire:
    name, failure, last_s, refused = "wire", "", math.inf, collections.Counter()
    def poll(self, *_):
        return np.zeros(1, SENSOR_SAMPLE)
    def close(self):
        pass

class Holding(Operator):
    count = 0
    def poll(self, now_s):
        self.count += 1
        if self.count in (20, 40):
            self.submit(OperatorCommand.HOLD if self.count == 20 else OperatorCommand.RESUME)

job = replace(make_job(1.0, sys.argv[2:], scenario=sys.argv[1]), paced=True)
compile_kernels(job, print)
with runner(job, operator=Holding(attended=True)) as bench:
    if bench.loop.sensors:
        bench.loop.sensors.sources.append(Wire())
        bench.loop.sensors.sink = NoTelemetry()
    loaded, load = [], KernelCache.load_overload
    KernelCache.load_overload = lambda self, *rest: loaded.append(self._function.__qualname__) or load(self, *rest)
    print(bench.run().stop, "loaded:", loaded)
"""


@pytest.mark.parametrize("settings", [("scheme-1",), ("far-approach", "monitor.source=model")])
def test_run_in_real_time_loads_no_kernel_while_it_runs(settings: tuple[str, ...]) -> None:
    done = subprocess.run([sys.executable, "-c", RUN, *settings], capture_output=True, text=True, check=False)
    assert done.stdout.endswith("loaded: []\n"), done.stdout + done.stderr


def test_session_of_the_console_on_a_mock_rig_is_one_in_real_time() -> None:
    """Its kernels are those of the cycle, and all of them are called before anything is powered."""
    assert Choice(scenario="scheme-1", rig="mock").job().paced
    assert not Choice(scenario="scheme-1", rig="emulated").job().paced
