"""Child processes: they start together, explain why they cannot start, and never outlive their parent."""

from __future__ import annotations

import importlib
import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import hil
from hil.core.child_process import ChildProcess
from hil.errors import DeviceError, LinkLost, LinkTimeout, ProtocolError
from hil.parts.emulation.fault_injection import FaultControl

pytestmark = pytest.mark.wires(limit_s=0.05)  # what a process has to end after SIGTERM

CHILD = """
import sys, time
from hil.core.child_process import serve
from hil.parts.emulation.fault_injection import Faults
from hil.parts.emulation.process import FaultInjectionService

class Emulator:
    def __init__(self, configuration):
        self.c = configuration
        self.faults = Faults("vmu", ("wire",))
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

serve(lambda configuration: FaultInjectionService(Emulator(configuration)))
"""

PARENT = """
import os, sys, time
from hil.core.child_process import ChildProcess
child = ChildProcess("vmu emulator", sys.argv[2], {"port": "p"})
child.wait_ready(20.0)
holder = os.fork() if sys.argv[1] == "held" else 0  # a second owner of the pipes: no end of stdin
if sys.argv[1] != "held" or holder:
    print(child.pid, holder, flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let ``python -m`` find the modules that these tests write."""
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path.cwd()}:{os.environ.get('PYTHONPATH', '')}")
    (tmp_path / "emulator_child.py").write_text(CHILD)


def start(module: str = "emulator_child", **configuration: object) -> ChildProcess:
    return ChildProcess("vmu emulator", module, {"port": "p"} | configuration)


@pytest.fixture
def child(programs: None) -> Iterator[ChildProcess]:
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


def test_several_start_side_by_side_and_report_their_addresses() -> None:
    children = [start(port=f"/dev/{i}") for i in range(3)]
    try:
        assert [child.wait_ready(20.0)["addresses"]["vmu"] for child in children] == [f"/dev/{i}" for i in range(3)]
        assert len({child.pid for child in children}) == 3
    finally:
        for child in children:
            child.ask_to_end()
        for child in children:
            child.close()


def test_chatter_does_not_reach_the_terminal(child: ChildProcess, capfd: pytest.CaptureFixture[str]) -> None:
    assert child.wait_ready(1.0)["addresses"]["vmu"] == "p"
    child.close()
    assert capfd.readouterr() == ("", "")


def test_faults_are_switched_at_the_address_that_the_child_reports(child: ChildProcess) -> None:
    control = FaultControl(child.wait_ready(20.0)["addresses"]["vmu.faults"])
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
    assert "RuntimeError: motor smoke" in child.last_stderr()
    assert child._process.wait(1.0) == 1
    child.close()


def test_results_arrive_one_by_one_and_a_child_without_one_is_explained(tmp_path: Path) -> None:
    source = """
from hil.core.child_process import Parent
parent = Parent()
parent.send()
parent.send(**parent.configuration)
parent.send(sum=sum(parent.receive(None)["numbers"]), value=float("nan"))
raise SystemExit("no more")
"""
    (tmp_path / "results_child.py").write_text(source)
    with start("results_child") as child:
        assert child.wait_ready(20.0) == {}
        assert child.receive(5.0) == {"port": "p"}
        child.send({"numbers": list(range(50_000))})
        result = child.receive(5.0)
        assert result["sum"] == 25_000 * 49_999
        assert math.isnan(result["value"])
        with pytest.raises(LinkLost, match=r"^vmu emulator: ended with exit code 1 without a result:\nno more$"):
            child.receive(5.0)
        child.send({"numbers": []})


@pytest.mark.parametrize(
    ("program", "error_class", "text"),
    [
        ("raise SystemExit('no such device')", LinkLost, "ended with exit code 1 before it was ready:\nno such device"),
        ("import os; os.kill(os.getpid(), 9)", LinkLost, "was ended by SIGKILL before it was ready"),
        ("import time; time.sleep(60)", LinkTimeout, "was not ready within 0.2 s"),
        ("print('hello'); input(); input()", ProtocolError, "sent b'hello\\n', expected a JSON object"),
        ("print('[1]'); input(); input()", ProtocolError, "sent b'[1]\\n', expected a JSON object"),
    ],
)
def test_child_that_does_not_get_ready_is_explained(
    program: str, error_class: type[DeviceError], text: str, tmp_path: Path
) -> None:
    (tmp_path / "broken_child.py").write_text(program)
    child = start("broken_child")
    try:
        with pytest.raises(error_class) as caught:
            child.wait_ready(0.2 if error_class is LinkTimeout else 20.0)
        assert str(caught.value) == f"vmu emulator: {text}"
    finally:
        child.close()
    assert not is_running(child.pid)


def test_a_program_that_does_not_exist_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    with start("hil.no_such_module") as child, pytest.raises(LinkLost, match=r"No module named hil\.no_such_module"):
        child.wait_ready(20.0)
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(LinkLost, match=r"vmu emulator: cannot be started: .*/no/such/python"):
        start()


def test_every_module_that_is_started_exists_and_every_module_with_a_parent_is_started() -> None:
    package = Path(hil.__file__).parent
    sources = {path: path.read_text() for path in sorted(package.rglob("*.py"))}
    started = {
        name for text in sources.values() for name in re.findall(r'"(hil\.[\w.]+)"', text) if name in children(sources)
    }
    assert started == children(sources) - {"hil.parts.links.gnc_server", "hil.parts.links.binary_gnc_server"}
    for name in sorted(started):
        importlib.import_module(name)


def children(sources: dict[Path, str]) -> set[str]:
    """Return the modules of ``sources`` that are programs of child processes."""
    programs = [path for path, text in sources.items() if "Parent(" in text and "__main__" in text]
    return {".".join(path.relative_to(Path(hil.__file__).parents[1]).with_suffix("").parts) for path in programs}


@pytest.mark.parametrize("belt", ["end of stdin", "held"])
def test_nothing_stays_behind_when_the_parent_is_killed(belt: str) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", PARENT, belt, "emulator_child"], stdout=subprocess.PIPE, text=True
    ) as parent:
        assert parent.stdout is not None
        pid, holder = map(int, parent.stdout.readline().split())
        assert is_running(pid)
        parent.kill()
        try:
            wait_gone(pid)
        finally:
            if holder:
                os.kill(holder, signal.SIGKILL)
