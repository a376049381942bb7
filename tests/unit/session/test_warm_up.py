"""Compilation before a run: a run waits for the kernels that it calls, and for no others."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace

import pytest

from hil.session import warm_up
from hil.session.warm_up import FIRST_START, compile_kernels
from hil.setup.assembly import Job
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
        monkeypatch.setattr(warm_up, "_compiler_of_the_gnc", lambda: nullcontext("a process"))
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


def test_first_simulated_run_compiles_the_loop_and_says_so(cache_with: CacheWith, job: Job) -> None:
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
