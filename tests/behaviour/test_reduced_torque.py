"""Torque limit of a CiA 402 drive, reduced for the first move of commissioning and restored, in lock-step."""

from __future__ import annotations

from contextlib import suppress

import pytest

from hil.config.tables.drive_habits import DriveHabits
from hil.drivers.turntable.cia402 import codec as codec
from hil.errors import DeviceError
from tests.support.turntable_bench import eventually, served

PITCH = 1


def limit(device, clock, reduced: bool) -> str:
    device.limit_torque(PITCH, reduced)
    eventually(clock, lambda: device.torque_limit(PITCH))
    return device.torque_limit(PITCH)


def limits(emulator) -> list[int]:
    return [drive.objects.value(codec.MAX_TORQUE) for drive in emulator.drives]


def test_torque_limit_of_one_drive_is_reduced_read_back_and_restored() -> None:
    with served("cia402") as (emulator, device, clock):
        emulator.drives[PITCH].objects.put(codec.MAX_TORQUE, 1200)
        for _ in range(2):
            assert limit(device, clock, True) == "torque at most 360 per mille of the rated one (0x6072, reduced)"
            assert limits(emulator) == [1000, 360, 1000]
        assert limit(device, clock, False) == "torque at most 1200 per mille of the rated one (0x6072)"
        assert limits(emulator) == [1000, 1200, 1000]


@pytest.mark.parametrize("ends", ["close", "lost thread"])
def test_torque_limit_is_restored_when_the_link_is_closed(ends: str) -> None:
    with served("cia402") as (emulator, device, clock):
        limit(device, clock, True)
        if ends == "lost thread":
            emulator._station.send(emulator.drives[0].fail(0x7500))
            clock.sleep(0.3)
            with suppress(DeviceError):
                device.read(clock.now_s())
        device.close()
        eventually(clock, lambda: limits(emulator) == [1000, 1000, 1000])


@pytest.mark.parametrize(
    ("habit", "text"),
    [
        ({"missing": (0x6072,)}, "0x6072 is missing: full torque"),
        ({"aborts": (0x6072,)}, "refuses object 0x6072 = 300"),
    ],
)
def test_drive_without_a_torque_limit_is_named(habit: dict, text: str) -> None:
    with served("cia402", cia402={"emulated": DriveHabits(**habit)}) as (_, device, clock):
        assert limit(device, clock, True).startswith(text)
        assert limit(device, clock, True).endswith("full torque")
        device.read(clock.now_s())
