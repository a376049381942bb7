"""Compilation before a run: a run waits for the kernels that it calls, and for no others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from hil.session import warm_up
from hil.session.warm_up import compile_kernels
from hil.setup.assembly import Job
from tests.support.run_settings import make_job

Steps = list[str]
CacheWith = Callable[..., Steps]


@pytest.fixture
def cache_with(monkeypatch: pytest.MonkeyPatch) -> CacheWith:
    """Return a function that fills the kernel cache with parts; it returns the list of what is done from then on."""

    def fill(*parts: str) -> Steps:
        done: Steps = []
        monkeypatch.setattr(warm_up, "kernels_are_cached", lambda: "cycle" in parts)
        monkeypatch.setattr(warm_up, "loop_is_compiled", lambda: "loop" in parts)
        monkeypatch.setattr(warm_up, "_compile", lambda *_: done.append("compile the cycle"))
        monkeypatch.setattr(warm_up, "start_in_background", lambda *_: done.append("compile the loop in background"))
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


def test_first_simulated_run_leaves_the_loop_to_the_background(cache_with: CacheWith, job: Job) -> None:
    done = cache_with()
    compile_kernels(job, lambda _: None)
    assert done == ["compile the cycle", "compile the loop in background"]


@pytest.mark.parametrize("parts", [("cycle",), ("cycle", "loop")])
def test_run_in_real_time_calls_all_kernels_beforehand(cache_with: CacheWith, job: Job, parts: Steps) -> None:
    done = cache_with(*parts)
    compile_kernels(replace(job, paced=True), lambda _: None)
    assert done == ["call all kernels"]
