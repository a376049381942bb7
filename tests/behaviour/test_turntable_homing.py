"""Homing, limit switches, identity, parking: what the turntable drivers do besides following setpoints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import configs_folder
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.errors import DriveFault, FaultKind, LinkTimeout, ProtocolError
from hil.parts.emulation.shared_state import ChainState
from tests.support.turntable_bench import PARK_DEG, error_of, eventually, served

INCREMENTAL = {"encoder": "incremental", "home_deg": 1.0, "homing_rate_degps": 5.0}


@pytest.fixture(params=["cia402", "ascii", "acu"])
def driver(request):
    return request.param


def feedback(device, clock):
    return device.read(clock.now_s())


def test_axes_without_absolute_encoders_take_no_setpoints_before_homing(driver):
    with served(driver, **INCREMENTAL) as (_, device, clock):
        found = feedback(device, clock)
        assert set(found.homing) == {Homing.NEEDED}
        assert found.position == pytest.approx(np.zeros(3), abs=1e-6)  # counted from where it was switched on
        assert device.send(np.full(3, 0.2), np.zeros(3), clock.now_s()) == pytest.approx(found.position)
        clock.sleep_until(clock.now_s() + 0.3)
        assert feedback(device, clock).position == pytest.approx(found.position, abs=1e-6)


def test_homing_finds_the_place_and_setpoints_are_taken_afterwards(driver):
    with served(driver, **INCREMENTAL) as (emulator, device, clock):
        device.home(clock.now_s())
        assert set(feedback(device, clock).homing) == {Homing.UNDER_WAY}
        eventually(clock, lambda: set(feedback(device, clock).homing) == {Homing.DONE})
        home = np.radians([1.0, 1.0, 1.0])
        assert feedback(device, clock).position == pytest.approx(home, abs=math.radians(0.3))
        clock.sleep_until(clock.now_s() + 0.2)
        assert feedback(device, clock).position == pytest.approx(home, abs=math.radians(0.3))  # nothing jumps
        goal = np.radians((4.0, -3.0, 2.0))
        device.send(goal, np.zeros(3), clock.now_s())
        eventually(clock, lambda: np.allclose(feedback(device, clock).position, goal, atol=1e-4))
        eventually(clock, lambda: np.allclose(emulator.gimbals.position, goal, atol=2e-3))


def test_homing_that_fails_is_reported_and_stops_all_axes(driver):
    with served(driver, **{**INCREMENTAL, "homing_rate_degps": 0.1}) as (emulator, device, clock):
        device.home(clock.now_s())
        eventually(clock, lambda: emulator.gimbals.homing.count(Homing.UNDER_WAY) == 3)
        emulator.gimbals.brake(1)  # as after the longest time that a search may take
        eventually(clock, lambda: feedback(device, clock).homing[1] is Homing.FAILED)
        eventually(clock, lambda: Homing.UNDER_WAY not in emulator.gimbals.homing)
        assert device.send(np.ones(3), np.zeros(3), clock.now_s()) == pytest.approx(np.zeros(3), abs=0.01)


def test_axis_on_its_limit_switch_is_reported(driver):
    with served(driver) as (_, device, clock):
        assert feedback(device, clock).limit == (0, 0, 0)
        goal = np.radians((-60.0, -2.0, 60.0))

        def there():
            device.send(goal, np.zeros(3), clock.now_s())
            return feedback(device, clock).limit == (-1, 0, 1)

        eventually(clock, there)


def test_open_safety_chain_is_a_drive_fault_by_name(driver):
    closed = [True]
    with served(driver, chain=lambda: ChainState(*closed * 3)) as (_, device, clock):
        closed[0] = False
        with pytest.raises(DriveFault, match=r"turntable\.(roll|pitch|yaw): .*safe torque off") as caught:
            raise error_of(device, clock)
        assert caught.value.kind is FaultKind.TORQUE_OFF


def test_torque_off_is_known_by_its_code_when_it_is_called_otherwise(driver, tmp_path, monkeypatch):
    monkeypatch.setitem(codec.FAULT_NAMES, codec.TORQUE_OFF, "STO active")
    file = tmp_path / "mine.toml"
    shipped = "acu" if driver == "acu" else "hil-ascii"
    text = (configs_folder() / "protocols" / f"{shipped}.toml").read_text()
    file.write_text(text.replace("safe torque off", "STO active"))
    closed = [True]
    with served(driver, chain=lambda: ChainState(*closed * 3), protocol=str(file)) as (_, device, clock):
        closed[0] = False
        with pytest.raises(DriveFault, match=r"STO active") as caught:
            raise error_of(device, clock)
        assert caught.value.kind is FaultKind.TORQUE_OFF


def test_move_to_parks_the_axes_slowly_and_takes_no_setpoints_any_more(driver):
    with served(driver) as (emulator, device, clock):
        goal, rate = np.radians((8.0, -8.0, 5.0)), np.radians((10.0, 10.0, 10.0))
        assert device.move_to(goal, rate, clock.now_s()) == pytest.approx(goal)
        fastest = [0.0]

        def there():
            device.send(np.zeros(3), np.zeros(3), clock.now_s())
            fastest[0] = max(fastest[0], float(np.abs(feedback(device, clock).rate).max()))
            return np.allclose(feedback(device, clock).position, goal, atol=1e-3)

        eventually(clock, there)
        eventually(clock, lambda: np.allclose(emulator.gimbals.position, goal, atol=2e-3))
        assert fastest[0] < 2.0 * rate[0]  # and not the 40 deg/s that the axis can do
        device.stop(clock.now_s())
        assert device.move_to(np.zeros(3), rate, clock.now_s()) == pytest.approx(goal, abs=1e-2)  # where it stands


@pytest.mark.parametrize(
    ("key", "value", "text"),
    [
        ("vendor_id", 0x99, r"turntable\.roll: vendor id is 0x00000B0B, expected 0x00000099"),
        ("product_code", 1, r"turntable\.roll: product code is 0x00010402, expected 0x00000001"),
        ("revision_min", 0x20000, r"turntable\.roll: revision is 0x00010000, expected 0x00020000 or newer"),
        ("firmware", "2.0", r"turntable\.roll: firmware is 'emulated drive 1\.0', expected '2\.0'"),
    ],
)
def test_cia402_drive_that_is_another_one_is_refused(key, value, text):
    with pytest.raises(ProtocolError, match=text), served("cia402", cia402={key: value}):
        pass


def test_cia402_drive_that_is_the_right_one_is_opened():
    right = {"vendor_id": 0xB0B, "product_code": 0x10402, "revision_min": 0x10000, "firmware": "emulated drive 1.0"}
    with served("cia402", cia402=right) as (_, device, clock):
        assert np.degrees(feedback(device, clock).position) == pytest.approx(PARK_DEG, abs=1e-4)


def test_serial_controller_that_is_another_one_is_refused():
    identity = {"model": "EMULATED-ACU", "firmware": "3.0"}
    wrong = pytest.raises(ProtocolError, match=r"turntable: firmware is '2\.3', expected '3\.0'")
    with wrong, served("acu", identity=identity):
        pass


def test_cia402_heartbeat_that_ceases_is_a_time_out_of_its_axis():
    with served("cia402") as (emulator, device, clock):
        emulator.drives[2].objects[0x1017].value = 0
        with pytest.raises(LinkTimeout, match=r"turntable\.yaw: no heartbeat for"):
            raise error_of(device, clock)


def test_cia402_drive_that_restarts_is_a_fault_of_its_axis():
    with served("cia402") as (emulator, device, clock):
        emulator._station.send(emulator.drives[1].boot())
        with pytest.raises(DriveFault, match=r"turntable\.pitch: has restarted"):
            raise error_of(device, clock)
