"""Emulators in child processes: they start together, tell why they cannot, and never stay behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.drivers.emulator_process import EmulatorProcess
from hil.drivers.fault_injection import FaultControl
from hil.errors import LinkLost, LinkTimeout, ProtocolError

pytestmark = pytest.mark.wires

CHILD = """
import sys, time
from hil.drivers.emulator_process import serve
from hil.drivers.fault_injection import WIRE, Faults

class Emulator:
    def __init__(self, configuration):
        self.c = configuration
        self.faults = Faults("vmu", WIRE)
    def start(self):
        print("chatter on stdout")
        print("chatter on stderr", file=sys.stderr)
        return {"vmu": self.c["port"]}
    def run(self, stop):
        if self.c.get("raises"):
            raise RuntimeError("motor smoke")
        if self.c.get("hangs"):
            time.sleep(60)
        stop.wait()
    def close(self):
        if "note" in self.c:
            open(self.c["note"], "w").write("closed")

serve(Emulator)
"""

PARENT = f"""
import os, sys, time
from hil.drivers.emulator_process import EmulatorProcess
child = EmulatorProcess("vmu", [sys.executable, "-c", {CHILD!r}], {{"port": "p"}})
child.wait_ready(20.0)
holder = os.fork() if sys.argv[1] == "held" else 0  # a second owner of the pipes: no end of stdin
if sys.argv[1] != "held" or holder:
    print(child.pid, holder, flush=True)
time.sleep(60)
"""


def start(program: str = CHILD, **configuration: object) -> EmulatorProcess:
    return EmulatorProcess("vmu", [sys.executable, "-c", program], {"port": "p"} | configuration)


@pytest.fixture
def child() -> Iterator[EmulatorProcess]:
    process = start()
    process.wait_ready(20.0)
    yield process
    process.close()


def is_running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def wait_gone(pid: int, wall_s: float = 3.0) -> None:
    give_up_s = time.monotonic() + wall_s
    while is_running(pid):
        assert time.monotonic() < give_up_s, f"{pid} is still there"
        time.sleep(0.005)


def test_several_start_side_by_side_and_tell_their_addresses() -> None:
    children = [start(port=f"/dev/{i}") for i in range(3)]
    try:
        assert [child.wait_ready(20.0)["vmu"] for child in children] == [f"/dev/{i}" for i in range(3)]
        assert len({child.pid for child in children}) == 3
    finally:
        for child in children:
            child.ask_to_end()
        for child in children:
            child.close()


def test_chatter_does_not_reach_the_terminal(child: EmulatorProcess, capfd: pytest.CaptureFixture[str]) -> None:
    assert child.wait_ready(1.0)["vmu"] == "p"
    child.close()
    assert capfd.readouterr() == ("", "")


def test_faults_are_switched_at_the_address_that_the_child_tells(child: EmulatorProcess) -> None:
    control = FaultControl(child.wait_ready(20.0)["vmu.faults"])
    assert control.send("on drop 0.5") == "ok"
    assert control.send("list") == "drop 0.5"
    control.close()


def test_closed_child_closes_its_emulator_and_exits_with_zero(tmp_path: Path) -> None:
    child = start(note=str(tmp_path / "note"))
    child.wait_ready(20.0)
    child.close()
    child.close()
    assert (tmp_path / "note").read_text() == "closed"
    assert child._process.returncode == 0


@pytest.mark.parametrize("hangs", [False, True])
def test_end_of_stdin_alone_ends_the_child_even_when_its_emulator_hangs(hangs: bool) -> None:
    child = start(hangs=hangs)
    child.wait_ready(20.0)
    child.ask_to_end()
    wait_gone(child.pid)
    child.close()
    assert child._process.returncode == 0


def test_interrupt_is_left_to_the_parent_and_terminate_ends_in_good_order(tmp_path: Path) -> None:
    child = start(note=str(tmp_path / "note"))
    child.wait_ready(20.0)
    os.kill(child.pid, signal.SIGINT)
    time.sleep(0.1)
    assert is_running(child.pid)
    os.kill(child.pid, signal.SIGTERM)
    assert child._process.wait(3.0) == 0
    assert (tmp_path / "note").read_text() == "closed"
    child.close()


@pytest.mark.parametrize("trouble", ["frozen", "hangs"])
def test_child_that_does_not_answer_is_ended_in_bounded_time(trouble: str) -> None:
    child = start(hangs=trouble == "hangs")
    child.wait_ready(20.0)
    if trouble == "frozen":
        os.kill(child.pid, signal.SIGSTOP)
    start_s = time.monotonic()
    child.close()
    assert time.monotonic() - start_s < 0.45
    assert not is_running(child.pid)


def test_emulator_that_raises_ends_its_process() -> None:
    child = start(raises=True)
    child.wait_ready(20.0)
    wait_gone(child.pid)
    assert "RuntimeError: motor smoke" in child._last_words()
    assert child._process.wait(1.0) == 1
    child.close()


@pytest.mark.parametrize(
    ("program", "error_class", "text"),
    [
        ("raise SystemExit('no such device')", LinkLost, r"vmu: emulator ended before it was ready:\nno such device"),
        ("import time; time.sleep(60)", LinkTimeout, r"vmu: emulator is not ready after 0\.2 s"),
        ("print('hello'); input(); input()", ProtocolError, r"vmu: emulator announced b'hello\\n'"),
    ],
)
def test_child_that_does_not_get_ready_is_explained(program: str, error_class: type[Exception], text: str) -> None:
    child = start(program)
    try:
        with pytest.raises(error_class, match=text):
            child.wait_ready(0.2 if error_class is LinkTimeout else 20.0)
    finally:
        child.close()
    assert not is_running(child.pid)


def test_program_that_does_not_exist_is_named() -> None:
    with pytest.raises(LinkLost, match=r"vmu: emulator cannot be started: .*/no/such/program"):
        EmulatorProcess("vmu", ["/no/such/program"], {})


@pytest.mark.parametrize("belt", ["end of stdin", "held"])
def test_nothing_stays_behind_when_the_parent_is_killed(belt: str) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, belt], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid, holder = map(int, parent.stdout.readline().split())
        assert is_running(pid)
        parent.kill()
        try:
            wait_gone(pid)
        finally:
            if holder:
                os.kill(holder, signal.SIGKILL)
