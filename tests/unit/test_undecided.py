"""Tests by the wall clock on a computer that pauses: repeated, undecided, and red all the same by their own fault."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support import pauses
from tests.support.pauses import PERIOD_S, Pause, ProcessTree, Usage, pause_between
from tests.support.pytest_runs import environment

PAUSED = Pause(0.0, 0.05, 0.8)
CONFTEST = """
from tests.support.pauses import Pause, Pauses
from tests.support.undecided import WiresTests

class Scripted(Pauses):
    def begin(self): pass
    def longest(self): return PAUSE

PAUSE = {pause}
def pytest_configure(config):
    config.addinivalue_line("markers", "wires: by the wall clock")
    config.addinivalue_line("markers", "xdist_group: of one worker")
    config.pluginmanager.register(WiresTests({pauses}))
"""
TESTS = """
import itertools
import pytest

pytestmark = pytest.mark.xdist_group("all")
tries = itertools.count(1)

@pytest.fixture(scope="module")
def bench():
    return next(tries)

@pytest.mark.wires
def test_always_late(): assert False

@pytest.mark.wires(limit_s=0.1)
def test_with_a_longer_limit(): assert False

@pytest.mark.wires
def test_late_once(bench): assert bench == 2

@pytest.mark.wires
def test_on_time(bench): assert bench == 2

def test_of_no_wires(): assert False
"""


def started(folder: Path, tests: str, *options: str, pause: Pause | None = None) -> subprocess.Popen[str]:
    """Start ``tests`` on a computer that pauses by ``pause``, by default as this one does."""
    (folder / "conftest.py").write_text(CONFTEST.format(pause=repr(pause), pauses="Scripted()" if pause else ""))
    (folder / "test_late.py").write_text(tests)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-c",
        os.devnull,
        "--rootdir",
        folder,
        *options,
    ]
    return subprocess.Popen(command, cwd=folder, env=environment(), stdout=subprocess.PIPE, text=True)


def run(folder: Path, tests: str, *options: str, pause: Pause = PAUSED) -> tuple[str, list[str], int]:
    """Return the summary of ``tests``, all lines and the exit code."""
    return ended(started(folder, tests, *options, pause=pause))


def ended(process: subprocess.Popen[str]) -> tuple[str, list[str], int]:
    lines = process.communicate()[0].splitlines()
    return lines[-1].strip("= ").rpartition(" in ")[0], lines, process.returncode


@pytest.mark.parametrize("options", [(), ("-p", "xdist", "-n", "2", "--dist", "loadgroup")], ids=["one", "xdist"])
def test_what_a_pause_fails_is_repeated_then_undecided_and_both_are_counted(tmp_path: Path, options) -> None:
    summary, lines, _ = run(tmp_path, TESTS, *options)
    lines = [line.replace("@all", "") for line in lines]  # xdist adds the group to a test's name
    assert summary == "2 failed, 2 passed, 1 undecided"
    paused = "40 ms (50 ms late, others had 80%)"
    assert "1 undecided: the computer paused" in lines
    assert "1 repeated: the computer paused" in lines
    assert f"REPEATED test_late.py::test_late_once: pauses of {paused}" in lines
    (undecided,) = (line for line in lines if line.startswith("UNDECIDED"))
    assert undecided.startswith(f"UNDECIDED test_late.py::test_always_late: pauses of {paused}, {paused}, {paused}")
    assert [line.split()[1] for line in lines if line.startswith("FAILED")] == [
        "test_late.py::test_with_a_longer_limit",
        "test_late.py::test_of_no_wires",
    ]
    assert any("longest pause of the computer" in line for line in lines)


@pytest.mark.parametrize(("count", "code"), [(3, 0), (4, 1)])
def test_more_than_three_undecided_tests_fail_the_run(tmp_path: Path, count: int, code: int) -> None:
    late = (
        f"import pytest\n@pytest.mark.wires\n@pytest.mark.parametrize('k', range({count}))\ndef test_late(k): assert 0"
    )
    assert run(tmp_path, late)[::2] == (f"{count} undecided", code)


def test_a_test_that_hangs_is_not_repeated(tmp_path: Path) -> None:
    hangs = "import pytest, time\n@pytest.mark.wires\n@pytest.mark.timeout(0.3)\ndef test_hangs(): time.sleep(60)"
    assert run(tmp_path, hangs, "-p", "pytest_timeout")[0] == "1 failed"


LOADED = """
import pathlib, subprocess, sys, time
import pytest

@pytest.mark.wires(limit_s=0.03)
def test_work_of_50_ms():
    hogs = [subprocess.Popen([sys.executable, "-IS", "-c", "while True: pass"]) for _ in range({hogs})]
    pathlib.Path("ready").touch()
    try:
        time.sleep(0.5)
        begin, used = time.monotonic(), time.process_time()
        while time.process_time() < used + 0.05: pass
        assert time.monotonic() - begin < 0.055
    finally:
        for hog in hogs: hog.kill(); hog.wait()
"""
HOGS = 8 * len(os.sched_getaffinity(0))


@pytest.mark.wires
def test_a_test_that_loads_all_cores_itself_fails(tmp_path: Path) -> None:
    assert ended(started(tmp_path, LOADED.format(hogs=HOGS)))[0] == "1 failed"


@pytest.mark.slow
@pytest.mark.wires
def test_a_test_that_other_programs_keep_from_the_cores_is_undecided(tmp_path: Path) -> None:
    process = started(tmp_path, "import os\nos.nice(5)\n" + LOADED.format(hogs=0))
    while not (tmp_path / "ready").exists():
        time.sleep(0.01)
    hogs = [subprocess.Popen([sys.executable, "-IS", "-c", "while True: pass"]) for _ in range(HOGS)]
    try:
        assert ended(process)[0] == "1 undecided"
    finally:
        for hog in hogs:
            hog.kill()
            hog.wait()


def test_a_pause_is_the_lateness_times_the_fraction_of_others() -> None:
    before, late_s = Usage(1.0, 5.0, 3.0), 0.04
    length_s = PERIOD_S + late_s

    def pause(idle_s: float, own_s: float) -> float:
        return pause_between(before, Usage(1.0 + length_s, 5.0 + idle_s, 3.0 + own_s), 2).duration_s

    assert pause(0.0, 0.0) == pytest.approx(late_s)
    assert pause(0.0, length_s) == pytest.approx(0.5 * late_s)
    assert pause(0.0, 2.0 * length_s) == pytest.approx(0.0)  # the test had all cores
    assert pause(2.0 * length_s, 0.0) == pytest.approx(0.0)  # the watcher was stopped, and cores were free
    assert pause(length_s, length_s) == pytest.approx(0.0)
    assert pause(-0.01, 0.0) == pytest.approx(late_s)  # a hypervisor withheld what counts as idle
    assert pause(0.0, -1.0) == 0.0  # an orphan has taken its time with it


BURN = "import time\nwhile time.process_time() < 0.1: pass"


def test_processor_time_of_a_tree_includes_unobserved_children() -> None:
    tree = ProcessTree(os.getpid())
    used_s = tree.used_s()
    for _ in range(2):
        subprocess.run([sys.executable, "-IS", "-c", BURN], check=True)
    assert tree.used_s() - used_s > 0.15
    shell = subprocess.Popen(
        [
            sys.executable,
            "-IS",
            "-c",
            f"import os\nif os.fork() == 0:\n {BURN.replace(chr(10), chr(10) + ' ')}\nelse: os.wait(); input()",
        ],
        stdin=subprocess.PIPE,
    )
    try:
        used_s = tree.used_s()
        while tree.used_s() - used_s < 0.09:
            assert shell.poll() is None
    finally:
        shell.communicate(b"\n")


def test_processor_time_of_a_tree_excludes_that_of_others() -> None:
    asleep = subprocess.Popen([sys.executable, "-IS", "-c", "input()"], stdin=subprocess.PIPE)
    busy = subprocess.Popen([sys.executable, "-IS", "-c", BURN])
    tree = ProcessTree(asleep.pid)
    used_s = tree.used_s()
    busy.wait()
    assert tree.used_s() - used_s < 0.05
    asleep.communicate(b"\n")


def test_wait_of_a_thread_counts_from_the_last_call_on(monkeypatch: pytest.MonkeyPatch) -> None:
    waited_ns = iter([{"1": 5_000_000_000}, {"1": 5_070_000_000, "2": 60_000_000}])
    monkeypatch.setattr(pauses, "_waited", lambda pid: next(waited_ns))
    tree = ProcessTree(os.getpid())
    assert [tree.longest_wait_s(), tree.longest_wait_s()] == [0.0, 0.07]
    pause = pause_between(Usage(0.0, 0.0, 0.0), Usage(0.1, 0.0, 0.02), 2, 0.07)
    assert pause.duration_s == pytest.approx(0.063)
