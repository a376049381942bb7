"""Whole runs on the emulated rig: real drivers, real wires, emulators in processes of their own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import hil
from tests.support.run_settings import NEAR, UNHURRIED, typed

OTHERS = ("vmu", "turntable", "io")
GENEROUS_EXIT_S = 3.0  # the product's own figure is 0.5 s; this one holds on a machine that does other things too


@contextmanager
def _started(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, int]]]:
    """Start ``hil run --rig emulated``; give it with its emulators' process ids once they are up."""
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", "emulated", *typed(*UNHURRIED), *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            pids: dict[str, int] = {}
            while len(pids) < 4:
                line = process.stderr.readline()
                assert line, "ended before the emulators were up"
                found = re.match(r"emulator process (\d+): (\w+)", line)
                if found:
                    pids[found[2]] = int(found[1])
            yield process, pids
        finally:
            process.kill()


def _wait_until_it_moves(process: subprocess.Popen[str]) -> None:
    """Wait until the bench is open, and a second more: it is placed then."""
    assert process.stderr is not None
    while not (line := process.stderr.readline()).startswith("watchdog process"):
        assert line, "ended before the bench was open"
    time.sleep(1.0)


def _alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def _none_left(pids: dict[str, int]) -> bool:
    deadline = time.monotonic() + 5.0
    while any(_alive(pid) for pid in pids.values()):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


@pytest.mark.parametrize("turntable", ["cia402", pytest.param("ascii", marks=pytest.mark.slow)])
def test_approach_passes_over_real_wires_and_its_lateness_is_null(turntable: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    arguments = ("--set", f"rig.turntable.driver={turntable}", "--duration", "28", "--lock-step")
    files = ("--record", str(tmp_path), "--json", str(path))
    with _started(*typed(*NEAR), *arguments, *files) as (process, pids):
        out, err = process.communicate(timeout=120)
    result = json.loads(path.read_text())
    assert process.returncode == 0, out + err
    assert result["passed"]
    assert result["rig"] == "emulated"
    assert result["vision"]["frames"] > 100
    assert max(result["bench"]["rail_error_max_m"]) < 0.005
    assert _none_left(pids)
    assert set(result["timing"]["lateness_us"].values()) == {None}
    assert result["timing"]["overruns"] == result["timing"]["skipped_periods"] == 0
    assert result["recording"]["dropped"] == 0
    assert hil.open(result["recording"]["file"]).replay().identical


@pytest.mark.slow
@pytest.mark.parametrize("turntable", ["cia402", "ascii"])
def test_whole_scheme_passes_over_real_wires(turntable: str, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    with _started("--set", f"rig.turntable.driver={turntable}", "--lock-step", "--json", str(path)) as (process, pids):
        out, err = process.communicate(timeout=200)
    assert process.returncode == 0, out + err
    assert json.loads(path.read_text())["passed"]
    assert _none_left(pids)


@pytest.mark.parametrize("device", ["rails", *(pytest.param(each, marks=pytest.mark.slow) for each in OTHERS)])
def test_killed_device_ends_a_run_in_lock_step_as_a_safe_stop_that_names_it(device: str) -> None:
    with _started(*typed(*NEAR), "--lock-step") as (process, pids):
        _wait_until_it_moves(process)
        os.kill(pids[device], signal.SIGKILL)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 3
    assert err.strip().splitlines()[-1].startswith(f"safe stop: {device}"), err
    assert _none_left(pids)


@pytest.mark.slow
@pytest.mark.parametrize("plug", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
@pytest.mark.parametrize("device", ["rails", *OTHERS])
@pytest.mark.wires
def test_unplugged_device_ends_the_run_as_a_safe_stop_that_names_it(device: str, plug: signal.Signals) -> None:
    with _started(*typed(*NEAR)) as (process, pids):
        _wait_until_it_moves(process)
        os.kill(pids[device], plug)
        unplugged_s = time.monotonic()
        _, err = process.communicate(timeout=20)
        took_s = time.monotonic() - unplugged_s
    assert process.returncode == 3
    last = err.strip().splitlines()[-1]
    assert last.startswith(f"safe stop: {device}"), err
    assert took_s < GENEROUS_EXIT_S
    assert _none_left(pids)


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "clock", ["lock step", pytest.param("wall clock", marks=[pytest.mark.slow, pytest.mark.wires])]
)
def test_operator_ends_the_run_as_a_safe_stop_and_nothing_is_left(number: signal.Signals, clock: str) -> None:
    with _started(*typed(*NEAR), *(["--lock-step"] if clock == "lock step" else [])) as (process, pids):
        _wait_until_it_moves(process)
        process.send_signal(number)
        _, err = process.communicate(timeout=120)
    assert process.returncode == 3
    assert "stopped by the operator" in err
    assert _none_left(pids)


@pytest.mark.slow
def test_emulators_do_not_outlive_a_controller_that_is_killed() -> None:
    with _started(*typed(*NEAR)) as (process, pids):
        time.sleep(1.0)
        process.kill()
        process.wait()
    assert _none_left(pids)


def test_emulate_prints_the_address_of_each_device_and_ends_on_ctrl_c() -> None:
    command = [sys.executable, "-m", "hil", "emulate"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            lines = [process.stdout.readline() for _ in range(11)]
            pids = {line.split()[0]: int(found[1]) for line in lines if (found := re.search(r"process (\d+)", line))}
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=20)
        finally:
            process.kill()
    assert process.returncode == 0
    wires = {"rails.x", "rails.y", "rails.z", "turntable", "vmu", "io"}
    assert set(pids) == wires | {"rails.faults", "turntable.faults", "vmu.faults", "io.faults"}
    assert _none_left(pids)
