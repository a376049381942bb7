"""Turntable drivers by the wall clock: silence, floods, dead processes, threads that hang."""

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

from hil.core.clock import WallClock
from hil.errors import DeviceError, LinkLost, LinkTimeout
from hil.parts.emulation.shared_state import ChainState, SharedAxisState
from tests.support.turntable_bench import DRIVERS, EMULATORS, turntable

pytestmark = pytest.mark.wires

PATIENCE_WALL_S = 20.0


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
def test_flood_of_other_frames_on_the_bus_leaves_the_feedback_fresh():
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


def test_drives_stop_by_themselves_when_setpoints_cease(driver):
    with served(driver, speed=1.0) as (emulator, device, clock):  # their patience is short for a computer that pauses
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
from hil.parts.emulation.shared_state import SharedAxisState
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
