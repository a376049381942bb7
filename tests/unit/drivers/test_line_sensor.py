"""Sensor on a serial wire: its driver against a device of the test's own, and its emulator against a plain client."""

from __future__ import annotations

import os
import threading
import time
import tty
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import serial

from hil.core.clock import WallClock
from hil.drivers.line_sensor.driver import LineSensor, LineSettings
from hil.errors import LinkLost
from hil.parts.emulation.line_sensor import LineSensorEmulator
from hil.sensors import check
from hil.sensors.range_finder import DimetixLines, RangeFinder
from hil.sensors.registry import sensor

WAIT_S = 5.0


class Device:
    """The far end of a wire, independent of the driver."""

    def __init__(self) -> None:
        self.fd, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def received(self, ending: bytes) -> bytes:
        data = b""
        while not data.endswith(ending):
            data += os.read(self.fd, 100)
        return data

    def send(self, data: bytes) -> None:
        os.write(self.fd, data)

    def close(self) -> None:
        for descriptor in (self.fd, self._slave):
            os.close(descriptor)


@pytest.fixture
def device() -> Iterator[Device]:
    made = Device()
    yield made
    made.close()


@pytest.fixture
def clock() -> WallClock:
    return WallClock()


@pytest.fixture
def driver(device: Device, clock: WallClock) -> Iterator[LineSensor]:
    made = LineSensor("sensor.ranger", 2, 1, DimetixLines(), LineSettings(device.path, latency_s=0.02), clock)
    yield made
    made.close()


def polled(driver: LineSensor, clock: WallClock, n: int, zero_s: float = -10.0) -> np.ndarray:
    """Return ``n`` samples as they arrive."""
    rows = [driver.poll(clock.now_s(), zero_s)]
    deadline = time.monotonic() + WAIT_S
    while sum(map(len, rows)) < n and time.monotonic() < deadline:
        time.sleep(0.005)
        rows.append(driver.poll(clock.now_s(), zero_s))
    return np.concatenate(rows)


def test_lines_are_those_of_the_manual() -> None:
    protocol = DimetixLines()
    assert protocol.decode(b"g0h+00032178") == (pytest.approx(3.2178),)
    assert protocol.decode(b"g3uh+00000001") == (pytest.approx(1e-4),)
    assert protocol.decode(b"g0?") is None
    with pytest.raises(ValueError, match="reports error 255"):
        protocol.decode(b"g0@E255")
    for line in (b"g0h+0003217", b"g0h-00032178", b"g0h+0003217x", b"\xff\xfe", b"g0h+00032178g0h+00032179"):
        with pytest.raises(ValueError, match="no line of a distance sensor"):
            protocol.decode(line)
    assert protocol.encode([3.21784]) == b"g0h+00032178\r\n"


def test_driver_asks_for_measurements_and_stamps_them_before_their_receipt(
    device: Device, driver: LineSensor, clock: WallClock
) -> None:
    assert device.received(b"\n") == b"s0h\r\n"
    before_s = clock.now_s()
    device.send(b"g0?\r\ng0h+000")
    time.sleep(0.02)
    device.send(b"32178\r\n")
    (row,) = polled(driver, clock, 1)
    after_s = clock.now_s()
    assert (row["sensor"], row["number"], row["value"][0]) == (2, 0, pytest.approx(3.2178))
    line_s = 14 * 10 / 19_200
    assert before_s + 0.02 <= row["t_s"] - 10.0 + 0.02 + line_s <= after_s
    assert not row["covariance"].any()
    device.send(b"g0h+00032179\r\n")
    assert len(polled(driver, clock, 1, zero_s=clock.now_s() + 10.0)) == 0  # measured before the run
    driver.close()
    assert device.received(b"\n") == b"s0c\r\n"


def test_damaged_lines_are_refused_and_counted_by_reason(device: Device, driver: LineSensor, clock: WallClock) -> None:
    device.send(b"\x00\xffg0h+12\r\ng0@E255\r\n" + b"g" * 300)
    device.send(b"g0@E255\r\n\r\n\n")
    device.send(b"g0h+00010000\r\n")
    found = polled(driver, clock, 1)
    assert found["value"][:, 0].tolist() == [pytest.approx(1.0)]
    assert driver.refused["the sensor reports error 255"] >= 1
    assert driver.refused["no line of a distance sensor"] >= 1
    assert driver.failure == ""


def test_a_wire_that_is_gone_is_reported_and_the_driver_closes(clock: WallClock) -> None:
    device = Device()
    driver = LineSensor("sensor.ranger", 0, 1, DimetixLines(), LineSettings(device.path), clock)
    device.close()
    deadline = time.monotonic() + WAIT_S
    while not driver.failure and time.monotonic() < deadline:
        assert len(driver.poll(clock.now_s(), 0.0)) == 0
        time.sleep(0.005)
    assert device.path in driver.failure
    driver.close()
    driver.close()
    with pytest.raises(LinkLost, match=r"sensor\.ranger: cannot open /dev/none"):
        LineSensor("sensor.ranger", 0, 1, DimetixLines(), LineSettings("/dev/none"), clock)


def test_emulator_measures_while_it_is_asked_to(clock: WallClock) -> None:
    emulator = LineSensorEmulator(
        "sensor.ranger", DimetixLines(), lambda t_s, number: None if number % 3 == 0 else [1.0 + 1e-4 * number],
        (50.0, 0.01), clock,
    )  # fmt: skip
    path, stop = emulator.start()["sensor.ranger"], threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    try:
        with serial.Serial(path, 19_200, timeout=0.2) as client:
            assert client.readline() == b""
            client.write(b"s0h\r\n")
            client.timeout = WAIT_S
            numbers = [int(client.readline()[4:12]) - 10_000 for _ in range(8)]
            assert all(number % 3 for number in numbers)
            assert numbers == sorted(set(numbers))
            client.write(b"s0c\r\n")
            client.timeout = 0.3
            while client.readline():
                pass
            emulator.faults.on("link_down")
            client.write(b"s0h\r\n")
            assert client.readline() == b""
    finally:
        stop.set()
        thread.join()
        emulator.close()


def test_check_finds_a_line_that_means_something_else_and_a_noise_that_is_missing() -> None:
    class Millimetres(DimetixLines):
        def encode(self, values: object) -> bytes:
            return b"g0h+00000001\r\n"

    found = sensor("range_finder")
    other = replace(found, module=type("Other", (RangeFinder,), {"wire": Millimetres()}))
    assert any("is received as" in line for line in check.problems(other))

    class Silent(RangeFinder):
        @staticmethod
        def innovate(settings, estimate, out):  # type: ignore[no-untyped-def]
            out.value[0] = out.sample.value[0] - estimate.r_CT_H[0]
            out.h[0, 0] = 1.0

    assert any("noise is missing" in line for line in check.problems(replace(found, module=Silent)))
