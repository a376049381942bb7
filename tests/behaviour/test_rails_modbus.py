"""Rails on Modbus TCP: driver and emulated drives over real sockets."""

from __future__ import annotations

import dataclasses
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from hil.config.rig import Rails
from hil.config.tables.rail_map import RailMap
from hil.core.clock import WallClock
from hil.drivers import loop_thread
from hil.drivers.base import AxisGroup
from hil.drivers.rails.codec import Command, ControlFlags, State, Status
from hil.drivers.rails.driver import ModbusRails
from hil.errors import BadInput, BenchError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip
from hil.parts.emulation.emulated_axes import WATCHDOG_S
from hil.parts.emulation.rails import RailsEmulator
from hil.parts.emulation.shared_state import SharedAxisState

pytestmark = pytest.mark.wires

TIMEOUT_S = 0.2
CYCLE_S = 0.01
SLACK_S = 0.25  # wall time that a busy test machine may take away
PARK = [1.0, 0.0, 0.5]

CHILD = """
import json, sys, threading
from hil.core.clock import WallClock
from hil.parts.emulation.shared_state import SharedAxisState
from hil.config.rig import Rails
from hil.parts.emulation.rails import RailsEmulator
emulator = RailsEmulator(Rails.model_validate_json(sys.argv[1]), WallClock(), SharedAxisState.create())
print(json.dumps(emulator.start()), flush=True)
emulator.run(threading.Event())
"""


SHORT_NUMBERS = {
    "functions": (6, 3),
    "command": {
        "position": {"address": 2, "type": "i16", "unit": "mm", "scale": 0.5},
        "rate": {"address": 3, "type": "i16", "unit": "mm/s"},
    },
}
"""Map of a drive that writes one register at a time."""


def config(
    addresses: dict[str, str] | None = None, timeout_s: float = TIMEOUT_S, registers: dict[str, Any] | None = None
) -> Rails:
    axis = {"rate_max_mps": 1.0, "acceleration_max_mps2": 2.0}
    values: dict[str, Any] = {
        "driver": "modbus",
        "timeout_s": timeout_s,
        "servo": {"gain_per_s": 10.0, "lag_s": 0.02},
        "map": registers or {},
        "x": {"travel_m": (0.0, 12.0), "park_m": PARK[0]} | axis,
        "y": {"travel_m": (-1.0, 1.0), "park_m": PARK[1]} | axis,
        "z": {"travel_m": (0.0, 2.0), "park_m": PARK[2]} | axis,
    }
    if addresses:
        values["modbus"] = {name[-1]: {"port": int(place.split(":")[1])} for name, place in addresses.items()}
    return Rails.model_validate(values)


@dataclasses.dataclass
class Bench:
    clock: WallClock
    emulator: RailsEmulator
    addresses: dict[str, str]
    board: SharedAxisState

    def port(self, axis: str) -> int:
        return int(self.addresses[f"rails.{axis}"].split(":")[1])

    def state(self, axis: int) -> State:
        """Return what a drive would report; time 0 is past, so this moves nothing."""
        return self.emulator.drives[axis].state(0.0)


@contextmanager
def emulated(speed: float = 1.0, registers: dict[str, Any] | None = None) -> Iterator[Bench]:
    clock = WallClock(speed=speed)
    board = SharedAxisState.create()
    emulator = RailsEmulator(config(registers=registers), clock, board)
    addresses = emulator.start()
    stop = threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    try:
        yield Bench(clock, emulator, addresses, board)
    finally:
        stop.set()
        thread.join()
        emulator.close()
        emulator.close()
        board.close()


@pytest.fixture
def bench() -> Iterator[Bench]:
    with emulated() as made:
        yield made


@contextmanager
def opened(rig: Rails, clock: WallClock) -> Iterator[ModbusRails]:
    rails = ModbusRails(rig, clock)
    try:
        rails.open(clock.now_s())
        yield rails
    finally:
        rails.stop(clock.now_s())
        rails.close()


@contextmanager
def child() -> Iterator[tuple[subprocess.Popen[str], dict[str, str]]]:
    command = [sys.executable, "-c", CHILD, config().model_dump_json()]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        addresses: dict[str, str] = json.loads(process.stdout.readline())
        yield process, addresses
    finally:
        process.kill()
        process.wait()
        assert process.stdout is not None
        process.stdout.close()


def cycle(rails: ModbusRails, clock: WallClock, cycles: int, rate: float = 0.2) -> None:
    """Move x with ``rate``, m/s."""
    start_s = clock.now_s()
    place = rails.read(start_s).position
    for _ in range(cycles):
        now_s = clock.now_s()
        rails.read(now_s)
        rails.send(place + rate * (now_s - start_s) * np.array([1.0, 0.0, 0.0]), np.array([rate, 0.0, 0.0]), now_s)
        clock.sleep_until(now_s + CYCLE_S)


def until_failure(rails: ModbusRails, clock: WallClock, longest_s: float = 3.0) -> tuple[BenchError, float]:
    """Run cycles until the device raises; return what, and after how long, s."""
    start_s = clock.now_s()
    while clock.now_s() - start_s < longest_s:
        try:
            cycle(rails, clock, 1, rate=0.0)
        except BenchError as error:
            return error, clock.now_s() - start_s
    raise AssertionError("nothing was noticed")


def wait_for(condition: Callable[[], bool], wall_s: float = 2.0) -> bool:
    end = time.monotonic() + wall_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.005)
    return condition()


def test_open_holds_the_axes_where_they_stand(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        assert isinstance(rails, AxisGroup)
        assert rails.axis_names == ("rails.x", "rails.y", "rails.z")
        assert rails.read(bench.clock.now_s()).position.tolist() == PARK
        time.sleep(0.1)
        assert rails.read(bench.clock.now_s()).position.tolist() == PARK
        assert all(bench.state(axis).status & Status.ENABLED for axis in range(3))


def test_axes_follow_setpoints_and_the_board_shows_them() -> None:
    with emulated(speed=4.0) as bench, opened(config(bench.addresses), bench.clock) as rails:
        cycle(rails, bench.clock, 100)
        feedback = rails.read(bench.clock.now_s())
        assert feedback.rate[0] == pytest.approx(0.2, abs=0.05)
        assert feedback.position[0] > 1.1
        assert feedback.position[1:].tolist() == PARK[1:]
        seen, _ = bench.board.read("rails", feedback.t_s)
        assert seen == pytest.approx(feedback.position, abs=0.02)


@pytest.mark.parametrize("registers", [{"functions": (16, 3)}, SHORT_NUMBERS], ids=["16 and 3", "6 and 3"])
def test_drives_without_function_23_are_written_and_then_read(registers: dict[str, Any]) -> None:
    with emulated(registers=registers) as bench:
        with opened(config(bench.addresses, registers=registers), bench.clock) as rails:
            cycle(rails, bench.clock, 100)
            feedback = rails.read(bench.clock.now_s())
            assert feedback.position[0] > 1.1
            assert feedback.position[1:].tolist() == PARK[1:]
            assert rails.counters()["protocol_errors"] == 0
            bench.emulator.faults.on("drive_fault", "y", 3)
            failure, _ = until_failure(rails, bench.clock)
            assert str(failure).startswith("rails.y: fault 3, motor too hot")
        assert all(bench.state(axis).status & Status.QUICK_STOP for axis in (0, 2))
        with pytest.raises(ProtocolError, match=r"exception [12] to function 23"):
            ModbusRails(config(bench.addresses), bench.clock).open(bench.clock.now_s())


def test_feedback_stays_fresh_and_axes_stand_without_setpoints(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        rails.send(np.array([1.1, 0.0, 0.5]), np.array([0.2, 0.0, 0.0]), bench.clock.now_s())
        time.sleep(WATCHDOG_S + 2.0 * TIMEOUT_S)
        feedback = rails.read(bench.clock.now_s())
        assert bench.clock.now_s() - feedback.t_s < 0.1
        # The rate of the last setpoint would leave the axis 0.02 m ahead of it.
        assert wait_for(lambda: abs(rails.read(bench.clock.now_s()).position[0] - 1.1) < 0.002)


def test_setpoint_is_cut_to_travel_and_must_be_finite(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        accepted = rails.send(np.array([20.0, -3.0, 0.5]), np.zeros(3), bench.clock.now_s())
        assert accepted.tolist() == [12.0, -1.0, 0.5]
        with pytest.raises(SafetyTrip, match=r"rails\.x"):
            rails.send(np.array([np.nan, 0.0, 0.5]), np.zeros(3), bench.clock.now_s())
        with pytest.raises(SafetyTrip, match=r"rails\.y"):
            rails.send(np.array(PARK), np.array([0.0, np.inf, 0.0]), bench.clock.now_s())


def test_stop_stands_and_stays_standing(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        cycle(rails, bench.clock, 30, rate=0.5)
        began = time.monotonic()
        rails.stop(bench.clock.now_s())
        assert time.monotonic() - began < 0.1 + SLACK_S
        assert all(bench.state(axis).status & Status.QUICK_STOP for axis in range(3))
        assert wait_for(lambda: abs(rails.read(bench.clock.now_s()).rate[0]) < 1e-5)
        standing = rails.read(bench.clock.now_s()).position
        held = rails.send(np.array([0.0, 0.0, 0.0]), np.zeros(3), bench.clock.now_s())
        assert held == pytest.approx(standing, abs=1e-5)
        rails.stop(bench.clock.now_s())
        time.sleep(0.1)
        assert rails.read(bench.clock.now_s()).position == pytest.approx(standing, abs=1e-5)


def test_close_without_stop_leaves_the_drives_stopped(bench: Bench) -> None:
    rails = ModbusRails(config(bench.addresses), bench.clock)
    rails.open(bench.clock.now_s())
    cycle(rails, bench.clock, 20, rate=0.5)
    rails.close()
    rails.close()
    assert wait_for(lambda: all(bench.state(axis).status & Status.QUICK_STOP for axis in range(3)), 0.3)


def test_closing_again_does_not_interrupt_the_last_requests(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_thread, "_END_WAIT_WALL_S", 1e-4)  # as on a busy host
    rails = ModbusRails(config(bench.addresses), bench.clock)
    rails.open(bench.clock.now_s())
    cycle(rails, bench.clock, 5, rate=0.5)
    drives = rails._drives
    thread = rails._thread
    assert thread is not None
    while thread.is_alive():
        rails.close()
    assert not any(drive._bus._client.connected for drive in drives)
    assert wait_for(lambda: all(bench.state(axis).status & Status.QUICK_STOP for axis in range(3)), 0.3)


def test_link_opens_again_after_close(bench: Bench) -> None:
    rails = ModbusRails(config(bench.addresses), bench.clock)
    for _ in range(2):
        rails.open(bench.clock.now_s())
        cycle(rails, bench.clock, 10)
        rails.stop(bench.clock.now_s())
        rails.close()
    assert rails._thread is None
    assert bench.state(0).position_m > PARK[0]


def test_device_that_is_not_open_does_not_answer(bench: Bench) -> None:
    rails = ModbusRails(config(bench.addresses), bench.clock)
    rails.stop(0.0)
    with pytest.raises(LinkLost, match="rails: is not open"):
        rails.send(np.array(PARK), np.zeros(3), 0.0)
    rails.open(bench.clock.now_s())
    rails.close()
    with pytest.raises(LinkLost, match="rails: is closed"):
        rails.read(bench.clock.now_s())


def test_missing_port_is_bad_input() -> None:
    with pytest.raises(BadInput, match=r"rails\.modbus\.x\.port"):
        config().make_driver(WallClock(), "rails")


def test_missing_server_is_reported_with_the_address(bench: Bench) -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        gone = f"127.0.0.1:{unused.getsockname()[1]}"
    rails = ModbusRails(config(bench.addresses | {"rails.z": gone}), bench.clock)
    began = time.monotonic()
    with pytest.raises(LinkLost, match=rf"rails\.z: no connection to {gone}"):
        rails.open(bench.clock.now_s())
    assert time.monotonic() - began < 0.5 + SLACK_S
    with pytest.raises(LinkLost, match=r"rails\.z"):
        rails.read(bench.clock.now_s())


@pytest.mark.parametrize(
    ("vendor", "firmware_min", "what"),
    [
        (0x48494C52, (2, 0), "firmware 1.0, expected 2.x"),
        (0x48494C52, (1, 4), "firmware 1.0, expected 1.4 or newer"),
        (0xBAD, (1, 0), "vendor 0x48494C52, expected 0x00000BAD"),
    ],
)
def test_wrong_drive_is_refused_untouched(vendor: int, firmware_min: tuple[int, int], what: str) -> None:
    with emulated() as bench:
        expected = config(bench.addresses).model_copy(update={"map": RailMap(vendor=vendor, firmware_min=firmware_min)})
        with pytest.raises(ProtocolError, match=rf"rails\.\w: wrong drive at 127.0.0.1:\d+: {what}"):
            ModbusRails(expected, bench.clock).open(bench.clock.now_s())
        assert all(bench.state(axis).echo == 0 for axis in range(3))


def test_drive_fault_is_named_and_stops_the_others(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        cycle(rails, bench.clock, 5)
        bench.emulator.drives[1].trip(3)
        error, _ = until_failure(rails, bench.clock)
        assert isinstance(error, DriveFault)
        assert str(error) == "rails.y: fault 3, motor too hot"
        assert wait_for(lambda: all(bench.state(axis).status & Status.QUICK_STOP for axis in (0, 2)))


def test_fault_is_reset_by_open(bench: Bench) -> None:
    bench.emulator.drives[2].trip(6)
    with opened(config(bench.addresses), bench.clock) as rails:
        rails.read(bench.clock.now_s())


def test_unrequested_quick_stop_is_a_fault(bench: Bench) -> None:
    with opened(config(bench.addresses), bench.clock) as rails:
        with socket.create_connection(("127.0.0.1", bench.port("x")), timeout=2.0) as other:
            other.sendall(bytes.fromhex("0001 0000 0006 01 06 0000 0003"))
            error, _ = until_failure(rails, bench.clock)
        assert isinstance(error, DriveFault)
        assert error.device == "rails.x"


def test_killed_device_is_noticed_and_left_quickly() -> None:
    clock = WallClock()
    with child() as (process, addresses):
        rails = ModbusRails(config(addresses), clock)
        rails.open(clock.now_s())
        cycle(rails, clock, 10)
        process.send_signal(signal.SIGKILL)
        error, after_s = until_failure(rails, clock)
        began = time.monotonic()
        rails.stop(clock.now_s())
        rails.close()
        assert isinstance(error, LinkLost)
        assert error.device.startswith("rails.")
        assert after_s < TIMEOUT_S + CYCLE_S + SLACK_S
        assert time.monotonic() - began < 0.2 + SLACK_S


def test_frozen_drive_is_noticed_and_the_others_are_stopped(bench: Bench) -> None:
    clock = bench.clock
    with child() as (process, addresses):
        mixed = config(bench.addresses | {"rails.y": addresses["rails.y"]})
        rails = ModbusRails(mixed, clock)
        rails.open(clock.now_s())
        cycle(rails, clock, 10, rate=0.5)
        process.send_signal(signal.SIGSTOP)
        error, after_s = until_failure(rails, clock)
        assert isinstance(error, LinkTimeout)
        assert error.device in ("rails.y", "rails")
        assert after_s < TIMEOUT_S + CYCLE_S + SLACK_S
        assert wait_for(lambda: all(bench.state(axis).status & Status.QUICK_STOP for axis in (0, 2)), 0.3)
        rails.stop(clock.now_s())
        rails.close()


def test_fault_stops_the_others_while_one_is_frozen(bench: Bench) -> None:
    clock = bench.clock
    with child() as (process, addresses):
        mixed = config(bench.addresses | {"rails.y": addresses["rails.y"]}, timeout_s=5.0)
        with opened(mixed, clock) as rails:
            cycle(rails, clock, 10)
            bench.emulator.drives[0].trip(2)
            process.send_signal(signal.SIGSTOP)
            stopped = wait_for(lambda: Status.QUICK_STOP in bench.state(2).status, 0.8 * WATCHDOG_S)
            assert stopped
            with pytest.raises(DriveFault, match=r"rails\.x: fault 2, over-current"):
                rails.read(clock.now_s())


def test_stop_does_not_wait_for_a_frozen_drive(bench: Bench) -> None:
    clock = bench.clock
    with child() as (process, addresses):
        mixed = config(bench.addresses | {"rails.y": addresses["rails.y"]}, timeout_s=5.0)
        rails = ModbusRails(mixed, clock)
        rails.open(clock.now_s())
        cycle(rails, clock, 10, rate=0.5)
        process.send_signal(signal.SIGSTOP)
        time.sleep(0.05)
        began = time.monotonic()
        rails.stop(clock.now_s())
        reached = [bool(bench.state(axis).status & Status.QUICK_STOP) for axis in (0, 2)]
        rails.stop(clock.now_s())
        rails.close()
        assert reached == [True, True]
        assert time.monotonic() - began < 0.2 + SLACK_S


def test_wire_carries_the_documented_bytes(bench: Bench) -> None:
    identity = "0007 0000 0006 01 03 0020 0003", "0007 0000 0009 01 03 06 4849 4c52 0100"
    enable = (
        "0008 0000 0017 01 17 0010 0007 0000 0006 0c 0001 002a 000f4240 00000000",
        "0008 0000 0011 01 17 0e 0043 0000 002a 000f4240 00000000",
    )
    quick_stop = "0009 0000 0006 01 06 0000 0003", "0009 0000 0006 01 06 0000 0003"
    state = "000a 0000 0006 01 03 0010 0003", "000a 0000 0009 01 03 06 0053 0000 002a"
    write_to_state = "000b 0000 0006 01 06 0010 0000", "000b 0000 0003 01 86 02"
    with socket.create_connection(("127.0.0.1", bench.port("x")), timeout=2.0) as wire:
        for request, answer in (identity, enable, quick_stop, state, write_to_state):
            wire.sendall(bytes.fromhex(request))
            assert wire.recv(256).hex() == bytes.fromhex(answer).hex()


def test_drive_stops_by_itself_when_commands_cease() -> None:
    board = SharedAxisState.create()
    emulator = RailsEmulator(config(), WallClock(), board)
    drive = emulator.drives[0]
    drive.command(Command(ControlFlags.ENABLE, 1, 3.0, 0.0), 0.1)
    moving = drive.state(0.5)
    assert Status.MOVING in moving.status
    assert Status.QUICK_STOP not in drive.state(0.09 + WATCHDOG_S).status
    stopped = drive.state(2.0)
    assert stopped.status == Status.READY | Status.ENABLED | Status.QUICK_STOP | Status.HOMED
    assert stopped.position_m < 2.9
    drive.command(Command(ControlFlags.ENABLE, 2, 3.0, 0.0), 2.1)
    assert drive.state(2.3).position_m == pytest.approx(stopped.position_m, abs=1e-4)
    emulator.close()
    board.close()
