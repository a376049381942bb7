"""Emulated rig in lock-step: the same seed gives the same run, whatever the computer does meanwhile."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.api.jobs import IN_LOCK_STEP
from hil.cli.main import execute
from hil.core.messages import CYCLE
from hil.errors import BadInput
from hil.session.build import check, wired_bench
from hil.session.warm_up import warm_up
from sims.fault_matrix import TIGHT, FaultCase, FaultReaction, run_case
from tests.support.run_settings import HARDWARE_WIRES, NEAR, make_job

LOCK_STEP = {"rig.host.time": "lock_step"}
TRACKER = {"rig.tracker.driver": "text", "rig.tracker.chaser.body": 1, "rig.tracker.frame.position_m": [1.0, 0.5, 0.2]}
RIGS: dict[str, dict[str, Any]] = {
    "emulated": {},
    "emulated-rtu": {"rig.turntable.driver": "ascii", "sensors.s.kind": "range_finder", **TRACKER},  # the other wires
}


@contextmanager
def load(processes: int) -> Iterator[None]:
    """Keep the computer busy."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for each in busy:
            each.kill()
            each.wait()


def run_of(rig: str, seconds: float, seed: int = 1) -> hil.Run:
    """Return a run in lock-step."""
    run = hil.run("scheme-1", rig, seed, seconds, LOCK_STEP | RIGS[rig])
    assert run.stop == "completed"
    return run


@pytest.mark.parametrize("rig", RIGS)
def test_same_seed_gives_the_same_bits_on_a_busy_computer(rig: str) -> None:
    quiet = run_of(rig, 0.5)
    with load(os.cpu_count() or 1):
        busy = run_of(rig, 0.5)
    assert quiet.history.dtype == CYCLE
    assert quiet.history.tobytes() == busy.history.tobytes()
    assert np.isnan(quiet.history["lateness_s"]).all()
    assert quiet.summary.get("bench_truth") == busy.summary.get("bench_truth")


def test_mounting_that_is_off_is_refused_before_motion() -> None:
    off = {"rig.bench.errors.reference_m": [0.0, 0.015, 0.0]}
    run = hil.run("scheme-1", "emulated", 1, 1.0, LOCK_STEP | TRACKER | off)
    assert run.stop.startswith("tracker: bench against tracker off by 0.01")
    assert not len(run.history)


def test_faults_of_wires_strike_at_the_same_time_each_time() -> None:
    job = make_job(60.0, (*TIGHT, *IN_LOCK_STEP), rig="emulated")
    check(job)
    warm_up(job)
    cases = [FaultCase("rails", "on drop 0.6"), FaultCase("turntable", "on corrupt 0.5"), FaultCase("io", "on estop")]

    def reactions() -> list[FaultReaction]:
        with wired_bench(job) as made:
            return [run_case(made, case) for case in cases]

    first = reactions()
    assert all(reaction.as_expected for reaction in first), first
    assert reactions() == first


@pytest.mark.parametrize(
    ("deed", "expected"),
    [
        pytest.param(lambda pid: os.kill(pid, signal.SIGKILL), "rails", id="killed"),
        pytest.param(lambda pid: os.kill(pid, signal.SIGSTOP), "rails emulator", id="silent"),
    ],
)
def test_process_that_does_not_do_its_part_is_named(deed: Callable[[int], None], expected: str) -> None:
    settings = (*NEAR, *IN_LOCK_STEP, "rig.host.lock_step_timeout_s=0.5")
    job = make_job(10.0, settings, rig="emulated")
    check(job)
    warm_up(job)
    with wired_bench(job) as made:
        runner = made.runner(lambda mode, done: deed(made.pids["rails"]) if done > 0.2 else None)
        outcome = runner.run()
    assert outcome.stop.startswith(expected), outcome.stop


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--rig", "mock"], "a mock rig runs in simulated time, only an emulated one has wires"),
        (["--rig", "emulated", "--speed", "2"], "in lock-step a rig is as fast as its wires: omit --speed"),
        (["--rig", "emulated", "--set", "vmu.source=cameras"], '"cameras": reads the wall clock'),
        (["--rig", "emulated", "--set", "monitor.source=camera"], '"camera": a camera reads the wall clock'),
    ],
)
def test_what_has_a_time_of_its_own_is_rejected_in_one_line(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["run", "scheme-1", "--lock-step", *arguments]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert len(lines) == 1, lines
    assert text in lines[0]


def test_hardware_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}')
    with pytest.raises(BadInput, match="hardware does not wait, only an emulated rig can be in lock-step"):
        check(make_job(1.0, IN_LOCK_STEP, rig=str(path)))
