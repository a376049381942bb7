"""Privileges of the loop from the operating system, messages about refusals, and their return at the end."""

from __future__ import annotations

import errno
import os
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core import realtime
from hil.core.realtime import CPU, FIFO, MEMORY, NICE, SLACK, SLICE, RealTime
from hil.session import build

pytestmark = pytest.mark.wires

HARDWARE = """
extends = "emulated"
kind = "hardware"
sign_off.waived = true
[rails.modbus]
x = { port = 1 }
y = { port = 2 }
z = { port = 3 }
[turntable.cia402]
channel = "/dev/null"
[vmu.rs422]
port = "/dev/null"
[io]
port = 4
"""


def state() -> dict[str, object]:
    """Return everything of the calling thread and this process that may be changed."""
    locked = re.search(r"VmLck:\s+(\d+)", Path("/proc/self/status").read_text())
    return {
        "policy": os.sched_getscheduler(0),
        "priority": os.sched_getparam(0).sched_priority,
        "nice": os.getpriority(os.PRIO_PROCESS, 0),
        "cpus": os.sched_getaffinity(0),
        "slack": realtime._call("prctl", realtime._PR_GET_TIMERSLACK),
        "switch interval": sys.getswitchinterval(),
        "locked": locked and locked[1],
    }


def in_a_thread(body: Callable[[], None]) -> None:
    """Run ``body`` in a thread of its own: niceness may go down and not up again where privileges are few."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            body()
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join(60.0)
    assert not thread.is_alive()
    if failures:
        raise failures[0]


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the operating system refuse whatever needs a privilege."""
    call = realtime._call

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EPERM, "Operation not permitted")

    def call_or_refuse(name: str, *arguments: object) -> int:
        if name == "mlockall":
            raise OSError(errno.ENOMEM, "Cannot allocate memory")
        return call(name, *arguments)

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "setpriority", refuse)
    monkeypatch.setattr(realtime, "_call", call_or_refuse)


def test_everything_is_taken_back_at_the_end_whatever_was_granted() -> None:
    def body() -> None:
        before = state()
        cpu = max(os.sched_getaffinity(0))
        with RealTime(cpu=cpu) as real_time:
            outside = state()
            assert outside["policy"] == before["policy"]
            with real_time.realtime_priority():
                inside = state()
                assert inside["cpus"] == {cpu}
                assert (inside["policy"] & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO) == real_time.granted(FIFO)
                assert (inside["locked"] != "0") == real_time.granted(MEMORY)
            assert state() == outside
        assert state() == before
        assert [g.name for g in real_time.grants if g.name != SLICE] == [MEMORY, FIFO, NICE, CPU, SLACK]

    in_a_thread(body)


def test_threads_and_processes_of_the_loop_do_not_inherit_its_policy() -> None:
    found: list[int] = []

    def body() -> None:
        with RealTime() as real_time, real_time.realtime_priority():
            child = threading.Thread(target=lambda: found.append(os.sched_getscheduler(0)))
            child.start()
            child.join()
            program = "import os; print(os.sched_getscheduler(0))"
            found.append(int(subprocess.check_output([sys.executable, "-c", program])))

    in_a_thread(body)
    assert found == [os.SCHED_OTHER, os.SCHED_OTHER]


@pytest.mark.usefixtures("refused")
def test_refusals_are_reported_with_reason_and_remedy_and_the_body_runs() -> None:
    told: dict[str, str] = {}

    def body() -> None:
        before = state()
        with RealTime() as real_time, real_time.realtime_priority():
            told.update({grant.name: str(grant) for grant in real_time.refused()})
            assert real_time.granted(SLACK)
            if real_time.granted(SLICE):
                assert realtime._slice_ns() == 100_000
        assert state() == before

    in_a_thread(body)
    assert re.match(r"sched_fifo refused: Operation not permitted \(EPERM\); would help: .*limits\.conf", told[FIFO])
    assert re.match(r"mlockall refused: Cannot allocate memory \(ENOMEM\); would help: memlock", told[MEMORY])
    assert NICE in told


def test_fifo_that_is_switched_off_is_not_used_and_reported() -> None:
    def body() -> None:
        with RealTime(fifo=False) as real_time, real_time.realtime_priority():
            assert os.sched_getscheduler(0) == os.SCHED_OTHER
            assert "sched_fifo refused: switched off by host.fifo" in map(str, real_time.refused())

    in_a_thread(body)


@pytest.fixture
def hardware(tmp_path: Path) -> str:
    path = tmp_path / "lab.toml"
    path.write_text(HARDWARE)
    return str(path)


@pytest.mark.usefixtures("refused")
def test_hardware_is_refused_without_real_time(hardware: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1", "--rig", hardware]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if "require_realtime" in line]
    assert len(lines) == 2
    assert "mlockall refused: Cannot allocate memory (ENOMEM)" in lines[0]
    assert "sched_fifo refused: Operation not permitted (EPERM)" in lines[1]


@pytest.mark.usefixtures("refused")
def test_hardware_runs_without_real_time_on_request(hardware: str) -> None:
    rig = load_rig(hardware, ["rig.host.require_realtime=false"])
    told: list[str] = []
    job = build.Job(load_scenario("scheme-1"), rig, 0, 1.0, 1.0)
    with build.runner(job, lambda *_: None, told.append) as runner:
        assert runner.overrun_monitor._action == "safe_stop"
    assert any("sched_fifo refused" in line for line in told)


def test_cpu_that_is_not_there_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1", "--set", "rig.host.cpu=4711"]) == 2
    assert re.search(r"^--set: rig\.host\.cpu: 4711: this computer has \d", capsys.readouterr().err)
