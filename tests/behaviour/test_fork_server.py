"""Children of the fork server: their own descriptors and errors, exit codes, and an end with server and parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.core.child_process import ChildProcess
from hil.core.fork_server import ForkServer
from hil.core.realtime import fair_share, short_turns
from hil.errors import LinkLost

pytestmark = pytest.mark.wires

CHILD = """
import os, sys
from hil.core.child_process import Parent
from hil.core.realtime import fair_share

PREPARED = []

def prepare():
    PREPARED.append(os.getpid())

def main():
    parent = Parent()
    print("chatter")
    share = list(fair_share())
    parent.send(pid=os.getpid(), prepared=PREPARED, share=share, fds=sorted(map(int, os.listdir("/proc/self/fd"))))
    while True:
        try:
            request = parent.receive(None)
        except EOFError:
            return
        if "write" in request:
            os.write(request["write"], b"written")
        if "fail" in request:
            raise RuntimeError(request["fail"])
"""

PARENT = """
import os, sys, time
from hil.core.child_process import ChildProcess
from hil.core.fork_server import ForkServer
child = ChildProcess("one", "forked_child", {}, server=ForkServer("hil.core.child_process"))
child.wait_ready(20.0)
holder = os.fork() if sys.argv[1] == "held" else 0  # a second owner of the pipes and of the server's socket
if sys.argv[1] != "held" or holder:
    print(child.pid, holder, flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let servers find the module that these tests write."""
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path.cwd()}:{os.environ.get('PYTHONPATH', '')}")
    (tmp_path / "forked_child.py").write_text(CHILD)


@pytest.fixture
def server(programs: None) -> Iterator[ForkServer]:
    made = ForkServer("forked_child")
    yield made
    made.close()


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def gone(*pids: int) -> bool:
    end_s = time.monotonic() + 5.0
    while any(map(is_alive, pids)) and time.monotonic() < end_s:
        time.sleep(0.01)
    return not any(map(is_alive, pids))


def test_child_has_its_own_descriptors_alone(server: ForkServer) -> None:
    read, write = os.pipe()
    with (
        ChildProcess("one", "forked_child", {}, (write,), server=server) as one,
        ChildProcess("two", "forked_child", {}, server=server) as two,
    ):
        first, second = one.wait_ready(20.0), two.wait_ready(20.0)
        assert (first["pid"], second["pid"]) == (one.pid, two.pid)
        assert len({one.pid, two.pid, os.getpid()}) == 3
        assert server._process is not None
        assert first["prepared"] == second["prepared"] == [server._process.pid]
        one.send({"write": write})
        assert os.read(read, 16) == b"written"
        own = [len(each["fds"]) for each in (first, second)]
        assert own[0] == own[1] + 1  # the pipe
        assert own[1] <= 6  # 0, 1, 2, the copy of 1, and the listed folder
        assert "chatter" in one.last_stderr()
    os.close(read)
    os.close(write)
    assert gone(one.pid, two.pid)
    assert (one.exit_status(), two.exit_status()) == ("ended with exit code 0",) * 2


def test_child_has_the_present_environment_and_folder(
    server: ForkServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GONE", "then")
    with ChildProcess("one", "forked_child", {}, server=server) as one:
        one.wait_ready(20.0)
    (tmp_path / "later").mkdir()
    found = "now=[os.environ.get('GONE'), os.environ['NEW'], os.getcwd()]"
    (tmp_path / "later" / "later_child.py").write_text(CHILD.replace("pid=os.getpid()", found))
    monkeypatch.delenv("GONE")
    monkeypatch.setenv("NEW", "now")
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path / 'later'}:{os.environ['PYTHONPATH']}")
    monkeypatch.chdir(tmp_path)
    with ChildProcess("two", "later_child", {}, server=server) as two:
        assert two.wait_ready(20.0)["now"] == [None, "now", str(tmp_path)]


def test_child_has_the_present_set_of_processors(server: ForkServer) -> None:
    def share() -> object:
        with ChildProcess("one", "forked_child", {}, server=server) as one:
            return one.wait_ready(20.0)["share"]

    before = list(fair_share())
    assert share() == before
    processors = os.sched_getaffinity(0)
    try:
        with short_turns():  # niceness and slice, where the system allows it
            os.sched_setaffinity(0, {min(processors)})
            now = list(fair_share())
            assert share() == now != before
    finally:
        os.sched_setaffinity(0, processors)
    assert share() == before


def test_end_of_a_child_is_explained(server: ForkServer) -> None:
    with ChildProcess("one", "forked_child", {}, server=server) as failed:
        failed.wait_ready(20.0)
        failed.send({"fail": "motor smoke"})
        with pytest.raises(LinkLost, match=r"one: ended with exit code 1 without a result:(.|\n)*motor smoke"):
            failed.receive(10.0)
    with ChildProcess("two", "forked_child", {}, server=server) as killed:
        killed.wait_ready(20.0)
        killed.kill()
        assert killed.wait_end(5.0)
        assert killed.exit_status() == "was ended by SIGKILL"
    text = r"three: ended with exit code 1 before(.|\n)*no_such_module"
    with ChildProcess("three", "no_such_module", {}, server=server) as absent, pytest.raises(LinkLost, match=text):
        absent.wait_ready(10.0)


def test_children_end_with_their_server_and_the_next_one_has_a_new_server(server: ForkServer) -> None:
    with ChildProcess("one", "forked_child", {}, server=server) as one:
        one.wait_ready(20.0)
        assert server._process is not None
        server._process.kill()
        server._process.wait()
        assert one.wait_end(5.0)
        assert one.exit_status() == "was ended by SIGKILL"
        assert gone(one.pid)
        with ChildProcess("two", "forked_child", {}, server=server) as two:
            assert two.wait_ready(20.0)["pid"] == two.pid


def test_server_that_does_not_answer_is_given_up_and_replaced(server: ForkServer) -> None:
    with ChildProcess("one", "forked_child", {}, server=server) as one:
        one.wait_ready(20.0)
        assert server._process is not None
        assert server._requests is not None
        server._process.send_signal(signal.SIGSTOP)
        server._requests.settimeout(0.1)
        with pytest.raises(LinkLost, match="two: cannot be started: timed out"):
            ChildProcess("two", "forked_child", {}, server=server)
    with ChildProcess("three", "forked_child", {}, server=server) as three:
        assert three.wait_ready(20.0)["pid"] == three.pid


@pytest.mark.parametrize("how", ["alone", "held"])
def test_nothing_stays_behind_when_the_parent_is_killed(how: str) -> None:
    command = [sys.executable, "-c", PARENT, how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child, holder = map(int, parent.stdout.readline().split())
        assert is_alive(child)
        parent.kill()
    try:
        assert gone(child)
    finally:
        if holder:
            os.kill(holder, signal.SIGKILL)
