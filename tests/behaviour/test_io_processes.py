"""The I/O process: what passes through shared memory, and what happens when either side falls silent."""

from __future__ import annotations

import math
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import RAIL_NAMES
from hil.core import clock
from hil.core.clock import WallClock
from hil.core.messages import AxisFeedback, Homing, PoseFrame
from hil.drivers.axes import ServoAxes
from hil.drivers.mock_axes import MockAxes
from hil.drivers.remote.devices import IoLink, RemoteAxes, RemotePoses, RemoteTurntable
from hil.drivers.remote.io_layout import IO, WATCHDOG, IoSharedMemory, setpoint_record
from hil.drivers.remote.processes import IoProcesses
from hil.drivers.remote.requests import IoRequests
from hil.drivers.remote.server import LOOP_SILENCE_MAX_S
from hil.errors import BenchError, DriveFault, FaultKind, LinkLost, LinkTimeout, ProtocolError
from hil.parts.wires.io_server import IoServer

pytestmark = pytest.mark.wires

WIRES = (
    "rig.turntable.cia402.channel=nowhere",
    "rig.vmu.rs422.port=nowhere",
    "rig.io.port=9",
    *(f"rig.rails.modbus.{axis}.port={port}" for port, axis in enumerate(RAIL_NAMES, 9)),
)
RIG = load_rig("emulated", WIRES).value


def setpoint(position: np.ndarray) -> np.ndarray:
    record = np.zeros(1, setpoint_record(3))
    record["position"] = position
    return record


class ScriptedVmu:
    """A pose source that hands out what it is given."""

    name = "vmu"

    def __init__(self) -> None:
        self.frames: list[PoseFrame] = []
        self.error: BenchError | None = None

    def open(self, now_s: float) -> None:
        if self.error:
            raise self.error

    def poll(self, now_s: float) -> list[PoseFrame]:
        if self.error:
            raise self.error
        frames, self.frames = self.frames, []
        return frames

    def counters(self) -> dict[str, int]:
        return {"frames": 7, "crc_errors": 2}

    def close(self) -> None:
        pass


class StoppableAxes(MockAxes):
    """Mock axes that count how often they were stopped."""

    stops = 0
    disabled = 0
    accepted = np.zeros(3)
    goal: np.ndarray | None = None

    def send(self, position: np.ndarray, rate: np.ndarray, now_s: float) -> np.ndarray:
        self.accepted = super().send(position, rate, now_s)
        return self.accepted

    def move_to(self, position: np.ndarray, rate: np.ndarray, now_s: float) -> np.ndarray:
        self.goal = np.array([position, rate])
        return position

    def stop(self, now_s: float) -> None:
        self.stops += 1
        super().stop(now_s)

    def disable(self, now_s: float) -> None:
        self.disabled += 1


@dataclass
class Sides:
    """A host at work in a thread, and the loop's side of its devices."""

    clock: WallClock
    axes: dict[str, StoppableAxes]
    unit: ScriptedVmu
    rails: RemoteAxes
    turntable: RemoteTurntable
    vmu: RemotePoses
    ended: list[str] = field(default_factory=list)

    def wait_until(self, reached: Callable[[], bool], alive: bool = True, limit_s: float = 5.0) -> bool:
        """Wait until ``reached``; alive: show the host signs of life meanwhile."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            if reached():
                return True
            if alive:
                self.rails.read(self.clock.now_s())
            time.sleep(0.005)
        return False


@pytest.fixture
def sides() -> Iterator[Sides]:
    ServoAxes(RIG.rails).step(0.0)  # compiles
    clock, stop = WallClock(), threading.Event()
    here, there = socket.socketpair()
    memory = IoSharedMemory.create()
    axes = {
        "rails": StoppableAxes("rails", RIG.rails),
        "turntable": StoppableAxes("turntable", RIG.turntable),
    }
    unit = ScriptedVmu()
    host = IoServer(dict(axes), unit, memory, there, clock)
    host.start()
    thread = threading.Thread(target=host.run, args=(stop,))
    thread.start()
    requests, ended = IoRequests(here, IO, clock), list[str]()
    link = IoLink(IO, memory, requests, clock, lambda: ended[0] if ended else "")
    rails, turntable = RemoteAxes("rails", RIG.rails, link), RemoteTurntable("turntable", RIG.turntable, link)
    made = Sides(clock, axes, unit, rails, turntable, RemotePoses(RIG.vmu, link), ended)
    try:
        yield made
    finally:
        for device in (rails, turntable, made.vmu):
            device.close()
        stop.set()
        thread.join(5.0)
        host.close()
        requests.close()
        memory.close()


def test_feedback_arrives_with_homing_and_switches(sides: Sides) -> None:
    sides.rails.open(sides.clock.now_s())
    told = AxisFeedback(
        0.0, np.array([1.0, 2.0, 3.0]), np.zeros(3), (Homing.DONE, Homing.FAILED, Homing.NEEDED), (0, 1, -1)
    )

    def read(now_s: float) -> AxisFeedback:
        return AxisFeedback(now_s, told.position, told.rate, told.homing, told.limit)

    sides.axes["rails"].read = read  # type: ignore[method-assign]
    assert sides.wait_until(lambda: sides.rails.read(sides.clock.now_s()).limit == (0, 1, -1))
    found = sides.rails.read(sides.clock.now_s())
    assert found.homing == told.homing
    assert np.array_equal(found.position, told.position)


def test_frames_arrive_whole_and_once(sides: Sides) -> None:
    sides.vmu.open(sides.clock.now_s())
    frame = PoseFrame(
        5, 1.25, 1.3, np.array([0.1, -0.2, 3.0]), np.array([0.0, 0.0, 0.6, 0.8]), np.arange(36.0).reshape(6, 6), 63, 31
    )
    sides.unit.frames = [frame]
    found: list[PoseFrame] = []
    sides.wait_until(lambda: bool(found.extend(sides.vmu.poll(sides.clock.now_s())) or found), alive=False)
    (arrived,) = found
    for name in ("counter", "t_s", "received_s", "leds_left", "leds_right"):
        assert getattr(arrived, name) == getattr(frame, name)
    for name in ("t_v", "q_vt", "covariance"):
        assert np.array_equal(getattr(arrived, name), getattr(frame, name))
    assert sides.wait_until(lambda: sides.vmu.counters() == {"frames": 7, "crc_errors": 2}, alive=False)


@pytest.mark.parametrize("kind", [LinkLost, LinkTimeout, ProtocolError, DriveFault])
def test_errors_arrive_as_what_they_are(sides: Sides, kind: type[BenchError]) -> None:
    sides.rails.open(sides.clock.now_s())
    sides.axes["rails"].fail(kind("rails.y", "smells of smoke"))  # type: ignore[call-arg, arg-type]

    with pytest.raises(kind, match=r"rails\.y: smells of smoke"):
        sides.wait_until(lambda: False)


@pytest.mark.parametrize("kind", FaultKind)
def test_the_kind_of_a_fault_arrives_while_a_device_is_served_and_at_its_opening(sides: Sides, kind: FaultKind) -> None:
    sides.unit.error = DriveFault("vmu", "STO active", kind)
    with pytest.raises(DriveFault, match="vmu: STO active") as caught:
        sides.vmu.open(sides.clock.now_s())
    assert caught.value.kind is kind
    sides.rails.open(sides.clock.now_s())
    sides.axes["rails"].fail(DriveFault("rails.y", "STO active", kind))
    with pytest.raises(DriveFault, match=r"rails\.y: STO active") as caught:
        sides.wait_until(lambda: False)
    assert caught.value.kind is kind


def test_error_at_opening_is_reported_there(sides: Sides) -> None:
    sides.unit.error = LinkLost("vmu", "cannot open /dev/null")
    with pytest.raises(LinkLost, match="vmu: cannot open /dev/null"):
        sides.vmu.open(sides.clock.now_s())
    with pytest.raises(LinkLost, match="vmu: is not open"):
        sides.vmu.poll(sides.clock.now_s())
    sides.unit.error = None
    sides.vmu.open(sides.clock.now_s())
    assert sides.vmu.poll(sides.clock.now_s()) == []


def test_axes_are_stopped_when_the_loop_falls_silent(sides: Sides) -> None:
    for device in (sides.rails, sides.turntable):
        device.open(sides.clock.now_s())
    assert sides.wait_until(lambda: sides.clock.now_s() > 3.0 * LOOP_SILENCE_MAX_S)
    assert [device.stops for device in sides.axes.values()] == [0, 0]
    assert sides.wait_until(lambda: all(device.stops for device in sides.axes.values()), alive=False)
    with pytest.raises(LinkLost, match="rails: stopped: the loop has been silent for"):
        sides.rails.read(sides.clock.now_s())


def test_process_that_was_paused_reports_it_for_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    here, there = socket.socketpair()
    stop, woken = threading.Event(), []
    host = IoServer({}, ScriptedVmu(), IoSharedMemory.create(), there, WallClock())

    def select_after_a_pause(*_: object) -> tuple[list[int], list[int], list[int]]:
        time.sleep(0.03 if not woken else 0.0)
        woken.append(None)
        stop.set()
        return [], [], []

    monkeypatch.setattr(clock.select, "select", select_after_a_pause)
    assert host.own_pause() == ""
    host.run(stop)
    assert re.fullmatch(r" \(the host paused this process for \d+ ms: end other programs, .*\)", host.own_pause())
    monkeypatch.setattr(clock.time, "monotonic", lambda: time.perf_counter() + 1e6)
    assert host.own_pause() == ""
    here.close()
    there.close()


def test_silence_before_the_first_cycle_and_without_torque_is_no_fault(sides: Sides) -> None:
    for device in (sides.rails, sides.turntable):
        device.open(sides.clock.now_s())
    time.sleep(3.0 * LOOP_SILENCE_MAX_S)
    assert sides.axes["rails"].stops == 0
    sides.rails.read(sides.clock.now_s())
    sides.rails.stop(sides.clock.now_s())
    assert sides.wait_until(lambda: sides.axes["rails"].stops == 1)
    sides.rails.disable(sides.clock.now_s())
    assert sides.wait_until(lambda: sides.axes["rails"].disabled == 1, alive=False)
    time.sleep(3.0 * LOOP_SILENCE_MAX_S)
    assert [device.stops for device in sides.axes.values()] == [1, 0]


def test_silence_after_a_stop_is_a_fault_as_long_as_there_is_torque(sides: Sides) -> None:
    for device in (sides.rails, sides.turntable):
        device.open(sides.clock.now_s())
    sides.rails.read(sides.clock.now_s())
    sides.rails.stop(sides.clock.now_s())
    assert sides.wait_until(lambda: sides.axes["turntable"].stops == 1, alive=False)
    time.sleep(LOOP_SILENCE_MAX_S)  # the stop runs in a thread of its own
    with pytest.raises(LinkLost, match="turntable: stopped: the loop has been silent for"):
        sides.turntable.read(sides.clock.now_s())


def test_a_jog_passes_the_travel_and_ends_with_the_next_setpoint_of_another_kind(sides: Sides) -> None:
    rails, device = sides.rails, sides.axes["rails"]
    rails.open(sides.clock.now_s())
    beyond = np.array([rails.read(sides.clock.now_s()).position[0], 1.52, 0.0])
    rails.set_jogging(True)
    assert np.array_equal(rails.send(beyond, np.zeros(3), sides.clock.now_s()), beyond)
    assert sides.wait_until(lambda: device.accepted[1] == 1.52)
    rails.set_jogging(False)
    assert rails.send(beyond, np.zeros(3), sides.clock.now_s())[1] == 1.5
    assert sides.wait_until(lambda: device.accepted[1] == 1.5)


def test_a_parking_turntable_is_given_its_goal_once_and_no_setpoint_after_it(sides: Sides) -> None:
    turntable, device = sides.turntable, sides.axes["turntable"]
    for axes in (sides.rails, turntable):
        axes.open(sides.clock.now_s())
    accepted = turntable.move_to(np.array([0.1, 9.0, 0.0]), np.full(3, 0.2), sides.clock.now_s())
    high = math.radians(RIG.turntable.pitch.travel_deg[1])
    assert accepted[1] == pytest.approx(high)
    assert sides.wait_until(lambda: device.goal is not None)
    assert np.allclose(device.goal, [[0.1, high, 0.0], [0.2, 0.2, 0.2]])
    stands = turntable.read(sides.clock.now_s()).position
    assert np.array_equal(turntable.send(np.ones(3), np.zeros(3), sides.clock.now_s()), stands)


def test_setpoints_from_before_an_opening_are_left_out(sides: Sides) -> None:
    rails = sides.rails
    rails.open(sides.clock.now_s())
    started = rails.read(sides.clock.now_s()).position
    rails.stop(sides.clock.now_s())
    sides.rails._block["rails.setpoint"].write(setpoint(started + 0.4), 0.0)
    rails.close()
    rails.open(sides.clock.now_s())
    until_s = sides.clock.now_s() + 0.3
    assert sides.wait_until(lambda: sides.clock.now_s() > until_s)
    assert np.abs(rails.read(sides.clock.now_s()).position - started).max() < 1e-4


def test_ended_io_process_is_reported_at_once(sides: Sides) -> None:
    sides.rails.open(sides.clock.now_s())
    sides.ended.append("was ended by SIGKILL")
    with pytest.raises(LinkLost, match="rails: I/O process was ended by SIGKILL"):
        sides.rails.read(sides.clock.now_s())


PARENT = f"""
import sys, time
from hil.core.clock import WallClock
from hil.config.load import load_rig
from hil.drivers.remote.processes import IoProcesses
io = IoProcesses(load_rig("emulated", {WIRES!r}).value, WallClock())
io.wait_ready()
print(io.pids['I/O'], flush=True)
time.sleep(60)
"""


def test_the_io_process_ends_with_its_parent() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.kill()
    end_s = time.monotonic() + 5.0
    while time.monotonic() < end_s and _lives(pid):
        time.sleep(0.01)
    assert not _lives(pid)


def test_a_killed_io_process_is_missed() -> None:
    with IoProcesses(RIG, WallClock()) as io:
        io.wait_ready()
        rails = io.devices()[0]
        os.kill(io.pids[IO], signal.SIGKILL)
        with pytest.raises(LinkLost, match="rails: I/O process has ended"):
            rails.open(0.0)


def test_a_dead_watchdog_is_called_watchdog() -> None:
    with IoProcesses(RIG, WallClock()) as io:
        os.kill(io.pids[WATCHDOG], signal.SIGKILL)
        with pytest.raises(LinkLost, match=r"^watchdog process: was ended by SIGKILL before it was ready"):
            io.wait_ready()
    with IoProcesses(RIG, WallClock()) as io:
        io.wait_ready()
        lines = io.devices()[3]
        assert lines is not None
        os.kill(io.pids[WATCHDOG], signal.SIGKILL)
        with pytest.raises(LinkLost, match=r"^io: watchdog process has ended"):
            lines.open(0.0)


def _lives(pid: int) -> bool:
    try:
        with open(f"/proc/{pid}/stat", encoding="ascii") as stat:
            return stat.read().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
