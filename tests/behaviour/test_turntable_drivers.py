"""Turntable drivers against their emulators, over the wires that both really use, in lock-step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.core.clock import WallClock
from hil.errors import DriveFault, FaultKind, LinkLost, SafetyTrip
from hil.parts.emulation.cia402 import Cia402Emulator
from tests.support.lock_step import GRID_S
from tests.support.turntable_bench import DRIVERS, PARK_DEG, error_of, eventually, served, turntable


def watchdog_trips(emulator):
    """Return how many of roll and yaw stopped because their setpoints ceased."""
    if isinstance(emulator, Cia402Emulator):
        return sum(emulator.drives[axis].objects[0x603F].value == 0x8250 for axis in (0, 2))
    return sum(emulator.fault[axis] == emulator._words.command_timeout for axis in (0, 2))


@pytest.fixture(params=["cia402", "ascii", "acu"])
def driver(request):
    return request.param


def test_open_holds_the_present_position(driver):
    with served(driver) as (emulator, device, clock):
        assert np.degrees(device.read(clock.now_s()).position) == pytest.approx(PARK_DEG, abs=1e-4)
        clock.sleep(0.1)
        assert np.degrees(emulator.gimbals.position) == pytest.approx(PARK_DEG, abs=1e-4)


def test_axes_reach_their_setpoints_and_feedback_confirms_it(driver):
    goal = np.radians((5.0, -4.0, 1.0))
    with served(driver) as (emulator, device, clock):
        assert device.send(goal, np.zeros(3), clock.now_s()) == pytest.approx(goal)
        eventually(clock, lambda: np.allclose(device.read(clock.now_s()).position, goal, atol=1e-4))
        eventually(clock, lambda: np.allclose(emulator.gimbals.position, goal, atol=1e-4))
        eventually(clock, lambda: np.abs(device.read(clock.now_s()).rate).max() < 1e-3)


def test_feedback_stays_fresh_without_setpoints(driver):
    with served(driver) as (_, device, clock):
        seen = set()
        end_s = clock.now_s() + 0.6
        while clock.now_s() < end_s:
            seen.add(device.read(clock.now_s()).t_s)
            clock.sleep(GRID_S)
        assert len(seen) > 5
        assert not any(device.read(clock.now_s()).rate)  # and the drives' own watchdog keeps quiet


def test_rate_feedforward_reaches_the_drives(driver):
    def lag_deg():
        start, start_s = device.read(clock.now_s()).position, clock.now_s()
        lag = []
        while (now_s := clock.now_s()) < start_s + 1.0:
            wanted = start + math.radians(10.0) * (now_s - start_s)
            device.send(wanted, np.full(3, math.radians(10.0)), now_s)
            clock.sleep(0.5 * GRID_S)
            lag.append(np.degrees(wanted - emulator.gimbals.position))
        return float(np.median(lag[10:]))

    with served(driver) as (emulator, device, clock):
        # without it the position loop alone would lag by rate/gain = 0.33 deg behind the moving setpoint
        assert lag_deg() < 0.1


def test_rate_of_a_setpoint_that_is_not_renewed_is_dropped(driver):
    goal = np.radians((5.0, -4.0, 1.0))
    with served(driver) as (_, device, clock):
        device.send(goal, np.full(3, math.radians(10.0)), clock.now_s())
        eventually(clock, lambda: np.allclose(device.read(clock.now_s()).position, goal, atol=1e-4))


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
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).min() > math.radians(15.0))
        device.stop(clock.now_s())
        device.stop(clock.now_s())
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
        standing = emulator.gimbals.position.copy()
        assert np.abs(np.degrees(standing)).max() < 40.0
        held = device.send(np.zeros(3), np.zeros(3), clock.now_s())
        clock.sleep(0.15)
        assert emulator.gimbals.position == pytest.approx(standing, abs=1e-4)
        assert held == pytest.approx(standing, abs=0.01)
        assert device.read(clock.now_s()).position == pytest.approx(standing, abs=1e-4)


def test_close_stops_moving_axes_and_a_new_open_holds_them(driver):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -50.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).min() > math.radians(15.0))
        device.close()
        with pytest.raises(LinkLost, match="turntable: is closed"):
            device.send(np.zeros(3), np.zeros(3), clock.now_s())
        device.open(clock.now_s())
        standing = emulator.gimbals.position.copy()
        assert np.abs(emulator.gimbals.rate).max() < 0.01
        clock.sleep(0.1)
        assert emulator.gimbals.position == pytest.approx(standing, abs=1e-3)
        device.send(np.zeros(3), np.zeros(3), clock.now_s())
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).min() > math.radians(1.0))


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
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).min() > math.radians(10.0))
        emulator.faults.on("drive_fault", "pitch", code)
        with pytest.raises(DriveFault, match=text) as caught:
            raise error_of(device, clock)
        assert caught.value.kind is FaultKind.OTHER
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
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
            eventually(clock, move)
        assert emulator.gimbals.astray == [False, True, False]
        assert [emulator.gimbals.limit(i) for i in range(3)] == [0, 0, 0]
        emulator.faults.clear()
        eventually(clock, lambda: not emulator.gimbals.moving(1))
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


def test_cia402_drive_without_velocity_offset_goes_by_its_target_alone():
    def without_offset(emulator):
        emulator.drives[1].objects.remove(0x60B1)

    with served("cia402", prepare=without_offset) as (_, device, clock):
        device.send(np.radians((5.0, -4.0, 1.0)), np.zeros(3), clock.now_s())
        eventually(
            clock, lambda: np.allclose(np.degrees(device.read(clock.now_s()).position), (5.0, -4.0, 1.0), atol=0.01)
        )
