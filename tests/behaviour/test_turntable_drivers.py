"""Turntable drivers against their emulators, over the wires that both really use."""

from __future__ import annotations

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
import tty

import can
import numpy as np
import pytest

from hil.config.rig import AsciiTurntableLine, Cia402, GimbalAxis, Servo, Turntable
from hil.core.clock import WallClock
from hil.drivers.shared_state import ChainState, SharedAxisState
from hil.drivers.turntable.ascii.driver import AsciiTurntable
from hil.drivers.turntable.ascii.emulator import AsciiTurntableEmulator
from hil.drivers.turntable.cia402.driver import Cia402Turntable
from hil.drivers.turntable.cia402.emulator import Cia402Emulator
from hil.errors import DeviceError, DriveFault, FaultKind, LinkLost, LinkTimeout, SafetyTrip

pytestmark = pytest.mark.wires

DRIVERS = {"cia402": Cia402Turntable, "ascii": AsciiTurntable, "acu": AsciiTurntable}
EMULATORS = {"cia402": Cia402Emulator, "ascii": AsciiTurntableEmulator, "acu": AsciiTurntableEmulator}
PARK_DEG = (3.0, -2.0, 0.5)
PATIENCE_WALL_S = 20.0


def turntable(driver, address=None, interface="serial", timeout_s=0.4, cia402=None, protocol=None, **of_axes):
    shipped = "acu" if driver == "acu" else "hil-ascii"
    axes = [
        GimbalAxis(
            travel_deg=(-60.0, 60.0), rate_max_degps=40.0, acceleration_max_degps2=80.0, park_deg=park, **of_axes
        )
        for park in PARK_DEG
    ]
    return Turntable(
        driver="cia402" if driver == "cia402" else "ascii",
        timeout_s=timeout_s,
        servo=Servo(gain_per_s=30.0, lag_s=0.006),
        roll=axes[0],
        pitch=axes[1],
        yaw=axes[2],
        cia402=Cia402(interface=interface, channel=address, **(cia402 or {})),
        ascii=AsciiTurntableLine(port=address, protocol=protocol or shipped),
    )


@contextlib.contextmanager
def emulated(driver, clock, interface="serial", channel=None, prepare=lambda emulator: None, chain=ChainState, **rig):
    """Yield an emulator in a thread, and its address."""
    board = SharedAxisState.create()
    emulator = EMULATORS[driver](turntable(driver, channel, interface, **rig), clock, board, chain=chain)
    prepare(emulator)
    address = emulator.start()["turntable"]
    stop = threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    try:
        yield emulator, address
    finally:
        stop.set()
        thread.join()
        emulator.close()
        board.close()


@contextlib.contextmanager
def served(driver, interface="serial", channel=None, speed=2.0, **rig):
    """Yield an emulator in a thread, an open driver and their clock."""
    clock = WallClock(speed=speed)
    with emulated(driver, clock, interface, channel, **rig) as (emulator, address):
        rig = {key: value for key, value in rig.items() if key not in ("prepare", "chain")}
        device = DRIVERS[driver](turntable(driver, address, interface, **rig), clock)
        try:
            device.open(clock.now_s())
            yield emulator, device, clock
        finally:
            device.close()


def eventually(condition, patience_s=PATIENCE_WALL_S):
    end_s = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end_s, "did not happen in time"
        time.sleep(0.002)


def watchdog_trips(emulator):
    """Return how many of roll and yaw stopped because their setpoints ceased."""
    if isinstance(emulator, Cia402Emulator):
        return sum(emulator.drives[axis].objects[0x603F].value == 0x8250 for axis in (0, 2))
    return sum(emulator.fault[axis] == emulator._words.command_timeout for axis in (0, 2))


def error_of(device, clock, patience_s=PATIENCE_WALL_S):
    """Send and read like the loop until the device fails; return its error."""
    end_s = time.monotonic() + patience_s
    position = device.read(clock.now_s()).position
    while time.monotonic() < end_s:
        try:
            device.send(position, np.zeros(3), clock.now_s())
            device.read(clock.now_s())
        except DeviceError as error:
            return error
        time.sleep(0.005)
    raise AssertionError("the device did not fail")


@pytest.fixture(params=["cia402", "ascii", "acu"])
def driver(request):
    return request.param


def test_open_holds_the_present_position(driver):
    with served(driver) as (emulator, device, clock):
        assert np.degrees(device.read(clock.now_s()).position) == pytest.approx(PARK_DEG, abs=1e-4)
        time.sleep(0.1)
        assert np.degrees(emulator.gimbals.position) == pytest.approx(PARK_DEG, abs=1e-4)


@pytest.mark.parametrize("speed", [1.5, 4.0])
def test_axes_go_where_they_are_sent_and_feedback_says_so(driver, speed):
    goal = np.radians((5.0, -4.0, 1.0))
    with served(driver, speed=speed) as (emulator, device, clock):
        assert device.send(goal, np.zeros(3), clock.now_s()) == pytest.approx(goal)
        eventually(lambda: np.allclose(device.read(clock.now_s()).position, goal, atol=1e-4))
        eventually(lambda: np.allclose(emulator.gimbals.position, goal, atol=1e-4))
        eventually(lambda: np.abs(device.read(clock.now_s()).rate).max() < 1e-3)


def test_feedback_stays_fresh_without_setpoints(driver):
    with served(driver) as (_, device, clock):
        seen = set()
        end_s = clock.now_s() + 0.6
        while clock.now_s() < end_s:
            seen.add(device.read(clock.now_s()).t_s)
            time.sleep(0.002)
        assert len(seen) > 5
        assert not any(device.read(clock.now_s()).rate)  # and the drives' own watchdog keeps quiet


def test_rate_feedforward_reaches_the_drives(driver):
    def lag_deg():
        start, start_s = device.read(clock.now_s()).position, clock.now_s()
        lag = []
        while (now_s := clock.now_s()) < start_s + 1.0:
            wanted = start + math.radians(10.0) * (now_s - start_s)
            device.send(wanted, np.full(3, math.radians(10.0)), now_s)
            time.sleep(0.01)
            lag.append(np.degrees(wanted - emulator.gimbals.position))
        return float(np.median(lag[10:]))

    with served(driver) as (emulator, device, clock):
        # without it the position loop alone would lag by rate/gain = 0.33 deg behind the moving setpoint
        assert any(lag_deg() < 0.1 for _ in range(4))  # a busy computer sends late


def test_rate_of_a_setpoint_that_nobody_renews_is_dropped(driver):
    goal = np.radians((5.0, -4.0, 1.0))
    with served(driver, speed=4.0, timeout_s=1.6) as (_, device, clock):
        device.send(goal, np.full(3, math.radians(10.0)), clock.now_s())
        eventually(lambda: np.allclose(device.read(clock.now_s()).position, goal, atol=1e-4))


def test_setpoint_outside_the_travel_is_cut(driver):
    with served(driver) as (_, device, clock):
        accepted = device.send(np.radians((90.0, -90.0, 1.0)), np.zeros(3), clock.now_s())
        assert np.degrees(accepted) == pytest.approx((60.0, -60.0, 1.0))


def test_number_that_is_not_finite_is_a_safety_trip(driver):
    with served(driver) as (_, device, clock):
        with pytest.raises(SafetyTrip, match=r"turntable\.pitch: setpoint nan"):
            device.send(np.array((0.0, math.nan, 0.0)), np.zeros(3), clock.now_s())
        with pytest.raises(SafetyTrip, match=r"turntable\.yaw: rate inf"):
            device.send(np.zeros(3), np.array((0.0, 0.0, math.inf)), clock.now_s())


def test_stop_brings_moving_axes_to_a_stand_for_good(driver):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -50.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).min() > math.radians(15.0))
        device.stop(clock.now_s())
        device.stop(clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
        standing = emulator.gimbals.position.copy()
        assert np.abs(np.degrees(standing)).max() < 40.0
        held = device.send(np.zeros(3), np.zeros(3), clock.now_s())
        time.sleep(0.15)
        assert emulator.gimbals.position == pytest.approx(standing, abs=1e-4)
        assert held == pytest.approx(standing, abs=0.01)
        assert device.read(clock.now_s()).position == pytest.approx(standing, abs=1e-4)


def test_close_stops_moving_axes_and_a_new_open_holds_them(driver):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -50.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).min() > math.radians(15.0))
        device.close()
        with pytest.raises(LinkLost, match="turntable: is closed"):
            device.send(np.zeros(3), np.zeros(3), clock.now_s())
        device.open(clock.now_s())
        standing = emulator.gimbals.position.copy()
        assert np.abs(emulator.gimbals.rate).max() < 0.01
        time.sleep(0.1)
        assert emulator.gimbals.position == pytest.approx(standing, abs=1e-3)
        device.send(np.zeros(3), np.zeros(3), clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).min() > math.radians(1.0))


@pytest.mark.parametrize(
    ("driver", "code", "text"),
    [
        ("cia402", 0x3210, r"turntable\.pitch: fault 0x3210 \(DC link over-voltage\)"),
        ("ascii", 0x0020, r"turntable\.pitch: following error"),
        ("acu", 3, r"turntable\.pitch: encoder"),
    ],
)
def test_drive_fault_is_named_and_stops_the_other_axes(driver, code, text):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -50.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).min() > math.radians(10.0))
        emulator.faults.on("drive_fault", "pitch", code)
        with pytest.raises(DriveFault, match=text) as caught:
            raise error_of(device, clock)
        assert caught.value.kind is FaultKind.OTHER
        eventually(lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
        assert watchdog_trips(emulator) == 0  # it was the driver that stopped them
        device.open(clock.now_s())  # a fault that is gone is reset
        device.read(clock.now_s())


def test_a_reversed_encoder_is_a_following_error_of_the_drive_which_has_no_torque_then(driver):
    with served(driver, timeout_s=1.2) as (emulator, device, clock):
        emulator.faults.on("reversed", "pitch")
        begun_s, start = clock.now_s(), device.read(clock.now_s()).position
        rate = np.radians((0.0, 5.0, 0.0))

        def move() -> bool:
            now_s = clock.now_s()
            device.send(start + rate * (now_s - begun_s), rate, now_s)
            device.read(now_s)
            return False

        with pytest.raises(DriveFault, match=r"turntable\.pitch: .*following error"):
            eventually(move)
        assert emulator.gimbals.astray == [False, True, False]
        assert emulator.gimbals.limit == (0, 0, 0)
        emulator.faults.clear()
        eventually(lambda: not emulator.gimbals.moving(1))
        stood = float(emulator.gimbals.position[1])
        device.open(clock.now_s())  # resets the fault; the axis holds where it has come to a stand
        assert emulator.gimbals.astray == [False, False, False]
        assert device.read(clock.now_s()).position[1] == pytest.approx(stood, abs=1e-3)


def test_stop_and_close_before_open_do_nothing(driver):
    device = DRIVERS[driver](turntable(driver, "/nowhere"), WallClock())
    device.stop(0.0)
    device.close()
    with pytest.raises(LinkLost, match="turntable: is not open"):
        device.read(0.0)


def test_port_that_is_not_there_is_a_lost_link(driver):
    device = DRIVERS[driver](turntable(driver, "/nowhere"), WallClock())
    with pytest.raises(LinkLost, match=r"turntable: cannot open .*/nowhere"):
        device.open(0.0)
    with pytest.raises(LinkLost, match="turntable: cannot open"):
        device.send(np.zeros(3), np.zeros(3), 0.0)


def test_device_that_is_silent_from_the_start_is_a_time_out(driver):
    near, far = os.openpty()
    tty.setraw(far)
    device = DRIVERS[driver](turntable(driver, os.ttyname(far)), WallClock())
    with pytest.raises(LinkTimeout, match=r"turntable.* does not answer"):
        device.open(0.0)
    device.close()
    os.close(near)
    os.close(far)


def test_cia402_works_on_any_bus_of_python_can():
    with served("cia402", "virtual", "test-turntable", speed=4.0, timeout_s=1.6) as (_, device, clock):
        device.send(np.radians((5.0, -4.0, 1.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.allclose(np.degrees(device.read(clock.now_s()).position), (5.0, -4.0, 1.0), atol=0.01))


@pytest.mark.slow
def test_flood_of_foreign_frames_on_the_bus_leaves_the_feedback_fresh():
    dice, oldest_s = np.random.default_rng(1), 0.0
    with (
        served("cia402", "virtual", "test-flood", speed=1.0, timeout_s=1.6) as (_, device, clock),
        can.Bus(interface="virtual", channel="test-flood") as stranger,
    ):
        for _burst in range(100):
            device.send(np.radians((5.0, -4.0, 1.0)), np.zeros(3), clock.now_s())
            for _ in range(100):  # of higher priority, of other nodes, extended
                number = int(dice.choice((0x001, 0x010, 0x1A5, 0x2C4, 0x7F0)))
                data, extended = dice.bytes(int(dice.integers(0, 9))), bool(dice.random() < 0.2)
                stranger.send(can.Message(arbitration_id=number, data=data, is_extended_id=extended))
            time.sleep(0.02)
            now_s = clock.now_s()
            oldest_s = max(oldest_s, now_s - device.read(now_s).t_s)
        eventually(lambda: np.allclose(np.degrees(device.read(clock.now_s()).position), (5.0, -4.0, 1.0), atol=0.01))
    print(f"10,000 foreign frames: oldest feedback {1e3 * oldest_s:.0f} ms")  # noqa: T201
    assert oldest_s < 0.4


def test_frames_of_another_length_in_the_name_of_a_drive_are_an_error_that_names_it():
    with (
        served("cia402", "virtual", "test-impostor", speed=1.0, timeout_s=1.6) as (_, device, clock),
        can.Bus(interface="virtual", channel="test-impostor") as impostor,
    ):
        for _ in range(20):
            impostor.send(can.Message(arbitration_id=0x182, data=b"", is_extended_id=False))
        assert "turntable.pitch: 4 implausible frames in a row" in str(error_of(device, clock))


def test_cia402_drive_without_velocity_offset_goes_by_its_target_alone():
    def without_offset(emulator):
        emulator.drives[1].objects.remove(0x60B1)

    with served("cia402", speed=4.0, timeout_s=1.6, prepare=without_offset) as (_, device, clock):
        device.send(np.radians((5.0, -4.0, 1.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.allclose(np.degrees(device.read(clock.now_s()).position), (5.0, -4.0, 1.0), atol=0.01))


def test_drives_stop_by_themselves_when_setpoints_cease(driver):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -50.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(lambda: np.abs(emulator.gimbals.rate).min() > math.radians(10.0))
        # the controller falls silent: its thread hangs
        device._link.exchange = lambda position, rate: time.sleep(0.5)
        eventually(lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
        assert np.abs(np.degrees(emulator.gimbals.position)).max() < 40.0


CHILD = """
import json, sys, threading
from hil.core.clock import WallClock
from hil.config.rig import Turntable
from hil.drivers.shared_state import SharedAxisState
from {module} import {emulator}
emulator = {emulator}(Turntable.model_validate_json(sys.argv[1]), WallClock(int(sys.argv[2])), SharedAxisState.create())
print(json.dumps(emulator.start()), flush=True)
emulator.run(threading.Event())
"""


@pytest.mark.parametrize(
    ("number", "kinds"), [(signal.SIGKILL, (LinkLost, LinkTimeout)), (signal.SIGSTOP, LinkTimeout)]
)
def test_dead_device_is_noticed_in_time_and_left_quickly(driver, number, kinds):
    clock = WallClock()
    script = CHILD.format(module=EMULATORS[driver].__module__, emulator=EMULATORS[driver].__name__)
    argv = [sys.executable, "-c", script, turntable(driver).model_dump_json(), str(clock.epoch_ns)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE) as child:
        try:
            address = json.loads(child.stdout.readline())["turntable"]
            device = DRIVERS[driver](turntable(driver, address), clock)
            device.open(clock.now_s())
            device.send(np.zeros(3), np.zeros(3), clock.now_s())
            time.sleep(0.05)
            child.send_signal(number)
            signalled_s = time.monotonic()
            error = error_of(device, clock)
            assert time.monotonic() - signalled_s < 0.4 + 0.1  # timeout_s and some slack
            assert isinstance(error, kinds)
            assert str(error).startswith("turntable")
            left_s = time.monotonic()
            device.stop(clock.now_s())
            device.close()
            assert time.monotonic() - left_s < 0.3
        finally:
            child.kill()
