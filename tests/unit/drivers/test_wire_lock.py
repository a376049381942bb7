"""A rig is held by one controller at a time, by the wires that it uses."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.config.tables.driver_registry import Wire
from hil.core import surroundings
from hil.drivers import wire_lock
from hil.errors import BadInput

RIG = """
extends = "emulated"
name = "lab"
kind = "hardware"
sign_off.waived = true
[rails.modbus]
x = {{ host = "{host}", port = 502 }}
y = {{ host = "192.0.2.2", port = 502 }}
z = {{ host = "192.0.2.3", port = 502 }}
[turntable]
driver = "ascii"
[turntable.ascii]
port = "{folder}/tty"
[io]
driver = "none"
[vmu.rs422]
port = "{folder}/vmu"
"""
HOLDER = """
import sys, time
from hil.config.load import load_rig
from hil.drivers.wire_lock import locked_wires
with locked_wires(load_rig(sys.argv[1]).value):
    print("held", flush=True)
    time.sleep(60.0)
"""


def test_lock_of_another_user_is_taken_whatever_his_umask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, before = tmp_path / "a.lock", os.umask(0o077)
    try:
        os.close(surroundings._opened(path))
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o666
    opened = os.open

    def of_another_user(name: Path, flags: int, mode: int = 0o777) -> int:
        if flags & (os.O_RDWR | os.O_CREAT):
            raise PermissionError(13, "Permission denied")
        return opened(name, flags, mode)

    monkeypatch.setattr(os, "open", of_another_user)
    os.close(surroundings._opened(path))


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(wire_lock, "_FOLDER", f"hil-wires-test-{tmp_path.name}")


def rig_file(folder: Path, name: str, host: str = "127.0.0.1") -> Path:
    path = folder / f"{name}.toml"
    path.write_text(RIG.format(host=host, folder=folder))
    return path


def rig(folder: Path, host: str = "127.0.0.1") -> Rig:
    return load_rig(str(rig_file(folder, "lab", host))).value


def test_second_controller_is_refused_within_a_second_naming_the_process_that_holds_the_wires(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire_lock, "_FOLDER", "hil-wires")  # of another process as well
    command = [sys.executable, "-c", HOLDER, str(rig_file(tmp_path, "first", "192.0.2.77"))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout is not None
            assert holder.stdout.readline() == "held\n"
            began_s = time.monotonic()
            with pytest.raises(BadInput) as refused, wire_lock.locked_wires(rig(tmp_path, "192.0.2.77")):
                pytest.fail("both hold the wires")
            assert time.monotonic() - began_s < 1.0
            lines = [str(problem) for problem in refused.value.problems]
            words = f"rig.vmu.rs422.port: {tmp_path}/vmu: is in use by process {holder.pid}: -c"
            assert any(words in line for line in lines)
            assert len(lines) == 5
        finally:
            holder.kill()
    with wire_lock.locked_wires(rig(tmp_path, "192.0.2.77")):  # the lock ends with its process
        pass


@pytest.mark.parametrize("command", [["run", "scheme-1", "--rig"], ["dss", "scheme-1", "--rig"]], ids=["run", "dss"])
def test_command_at_a_rig_in_use_is_refused_before_the_imports_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: list[str]
) -> None:
    monkeypatch.setattr(wire_lock, "_FOLDER", "hil-wires")
    arguments = [*command, str(rig_file(tmp_path, "lab", "192.0.2.78"))]
    script = f"import sys; from hil.cli.main import execute; print(execute({arguments})); print(*sys.modules)"
    with wire_lock.locked_wires(rig(tmp_path, "192.0.2.78")):
        done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    code, modules = done.stdout.splitlines()
    assert code == "2"
    assert len(done.stderr.splitlines()) == 5
    assert f"is in use by process {os.getpid()}" in done.stderr
    assert not {"numba", "hil.session.build", "pymodbus"} & set(modules.split())


def test_wires_are_free_again_after_use_and_also_after_a_refusal(tmp_path: Path) -> None:
    for _ in range(2):
        with wire_lock.locked_wires(rig(tmp_path)), pytest.raises(BadInput), wire_lock.locked_wires(rig(tmp_path)):
            pytest.fail("both hold the wires")


def test_emulated_rig_locks_no_wires() -> None:
    with wire_lock.locked_wires(load_rig("emulated").value), wire_lock.locked_wires(load_rig("emulated").value):
        pass


def test_address_of_a_wire_is_the_same_however_it_is_written(tmp_path: Path) -> None:
    port, link = tmp_path / "port", tmp_path / "by-id"
    port.touch()
    link.symlink_to(port)
    assert wire_lock.normalised(Wire("a", "serial", str(link))) == wire_lock.normalised(Wire("b", "serial", str(port)))
    texts = ("localhost:502", "127.0.0.1:502", "LOCALHOST:502")
    same = {wire_lock.normalised(Wire("a", "tcp", text)) for text in texts}
    assert len(same) == 1
    assert wire_lock.normalised(Wire("a", "tcp", "127.0.0.1:503")) not in same


TWO_GROUPS = """
extends = "emulated"
name = "lab"
kind = "hardware"
rails.modbus.x.port = 502
rails.modbus.y = {{ port = 503 }}
rails.modbus.z = {{ port = 504 }}
vmu.rs422.port = "/dev/ttyS7"
io = {{ port = 505 }}
[turntable.cia402]
interface = "{interface}"
channel = "can0"
[rotary_axes.sun]
driver = "cia402"
servo = {{ gain_per_s = 30.0, lag_s = 0.006 }}
place_deg = [3.0]
roll = {{ travel_deg = [-10.0, 10.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }}
[rotary_axes.sun.cia402]
interface = "{interface}"
channel = "can0"
node_ids = [{node}]
"""


@pytest.mark.parametrize(
    ("interface", "node", "text"),
    [
        ("socketcan", 7, ""),
        ("socketcan", 2, r"rotary_axes\.sun\.cia402: node id 2 on can0 is also one of turntable"),
        ("socketcan", 127, r"rotary_axes\.sun\.cia402: node id 127 on can0 is also one of turntable"),
        ("serial", 7, r"rotary_axes\.sun\.cia402\.channel: can0 is also turntable\.cia402\.channel, allowed: a port"),
    ],
)
def test_groups_share_a_bus_with_node_ids_of_their_own_and_no_serial_port(
    tmp_path: Path, interface: str, node: int, text: str
) -> None:
    file = tmp_path / "rig.toml"
    file.write_text(TWO_GROUPS.format(interface=interface, node=node))
    if not text:
        load_rig(str(file))
        return
    with pytest.raises(BadInput, match=text):
        load_rig(str(file))
