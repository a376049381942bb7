"""Each fault of the wire, switched on in the emulator while the driver runs: what is tolerated, what ends the link."""

from __future__ import annotations

import numpy as np
import pytest

from hil.errors import DeviceError, LinkTimeout
from tests.support.lock_step import GRID_S
from tests.support.turntable_bench import error_of, eventually, served

UNNOTICED_DEG = 1.1  # half of the following error: a smaller jump is plausible, without a checksum
REACHED_DEGPS = 80.0  # a faster one is not, whatever the time since the last sample
PAUSE_S = 0.01


@pytest.fixture(params=["cia402", "ascii", pytest.param("acu", marks=pytest.mark.slow)])
def driver(request):
    return request.param


def strike(clock, emulator, device, fault, share, counters, times):
    """Switch a fault on until the driver has counted ``times`` of it, then off; the link stays up."""
    before = device.counters()

    def counted():
        return sum(device.counters()[name] - before[name] for name in counters)

    for k in range(times):
        emulator.faults.on(fault, value=share)
        eventually(clock, lambda k=k: counted() > k)
        emulator.faults.off(fault)
        exchanges = device.counters()["exchanges"]
        eventually(clock, lambda exchanges=exchanges: device.counters()["exchanges"] > exchanges + 3)


@pytest.mark.parametrize(
    ("fault", "counters"),
    [
        ("drop", ("lost",)),
        ("corrupt", ("lost", "protocol_errors", "skipped_bytes")),
        ("duplicate", ("duplicates", "late")),
    ],
)
def test_single_spoilt_packets_are_tolerated_and_counted(driver, fault, counters):
    with served(driver, timeout_s=2.0) as (emulator, device, clock):
        counters = [name for name in counters if name in device.counters()]
        strike(clock, emulator, device, fault, 0.3, counters, 3)
        device.read(clock.now_s())
        assert np.abs(np.degrees(emulator.gimbals.rate)).max() < 0.1


@pytest.mark.parametrize(("fault", "value"), [("drop", 1.0), ("link_down", None), ("corrupt", 1.0)])
def test_burst_ends_in_an_error_that_names_the_device(driver, fault, value):
    with served(driver) as (emulator, device, clock):
        clock.sleep(0.1)
        emulator.faults.on(fault, value=value)
        error = error_of(device, clock)
        assert isinstance(error, DeviceError)
        assert str(error).startswith("turntable")
        emulator.faults.clear()
        with pytest.raises(DeviceError):  # for good: a link that has returned must be reopened
            device.read(clock.now_s())
        device.close()
        eventually(clock, lambda: not device._thread.is_alive())
        device.open(clock.now_s())
        device.read(clock.now_s())


def test_dead_wire_is_a_time_out_and_the_drives_stop_by_themselves(driver):
    with served(driver) as (emulator, device, clock):
        device.send(np.radians((50.0, -40.0, 50.0)), np.zeros(3), clock.now_s())
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).min() > 0.2)
        emulator.faults.on("link_down")
        assert isinstance(error_of(device, clock), LinkTimeout)
        eventually(clock, lambda: np.abs(emulator.gimbals.rate).max() < 1e-3)
        assert np.abs(np.degrees(emulator.gimbals.position)).max() < 38.0


def test_answers_that_come_late_are_counted_and_not_taken_for_new_ones(driver):
    with served(driver, timeout_s=2.0) as (emulator, device, clock):
        before = device.counters()
        # a PDO bears no number: one that is late by whole exchanges leaves only a gap
        told = ("late", "lost") if driver == "cia402" else ("late",)
        emulator.faults.on("delay", value=0.08)
        eventually(clock, lambda: any(device.counters()[name] > before[name] for name in told))
        emulator.faults.off("delay")
        exchanges = device.counters()["exchanges"]
        eventually(clock, lambda: device.counters()["exchanges"] > exchanges + 10)
        now_s = clock.now_s()
        assert now_s - device.read(now_s).t_s < 0.5


def test_no_spoilt_frame_moves_an_axis_or_shows_a_place_where_it_is_not(driver):
    with served(driver, timeout_s=2.0) as (emulator, device, clock):
        start = emulator.gimbals.position.copy()
        emulator.faults.on("corrupt", value=0.1)
        end_s = clock.now_s() + 0.8
        before_s = device.read(clock.now_s()).t_s
        allowed_deg = UNNOTICED_DEG
        while clock.now_s() < end_s:
            try:
                seen = device.read(clock.now_s())
                device.send(start, np.zeros(3), clock.now_s())
            except DeviceError:
                break  # a burst
            gap_s = seen.t_s - before_s
            if gap_s > 0.0:  # a new sample: after a pause of the machine the axis could have moved
                # until the device has checked it, which is later than its time
                checked_s = clock.now_s() - before_s
                allowed_deg = UNNOTICED_DEG + (REACHED_DEGPS * checked_s if gap_s > PAUSE_S else 0.0)
                before_s = seen.t_s
            assert np.abs(np.degrees(seen.position - start)).max() < allowed_deg
            clock.sleep(GRID_S)
        assert np.abs(np.degrees(emulator.gimbals.position - start)).max() < 0.1


def test_drive_fault_without_a_number_has_a_name_all_the_same(driver):
    with served(driver) as (emulator, device, clock):
        assert emulator.faults.execute("on drive_fault yaw") == "ok"
        text = str(error_of(device, clock))
        assert text.startswith("turntable.yaw: ")
        assert "following error" in text or "over-current" in text
