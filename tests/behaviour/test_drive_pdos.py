"""Drives whose PDOs are few, fixed, or described in short, in lock-step."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.tables.drive_habits import DriveHabits
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.errors import DriveFault
from tests.support.data_sheets import pdo, with_pdos
from tests.support.drive_makes import INTERPOLATED_AND_HOMING
from tests.support.turntable_bench import eventually, served

CONTROL, STATUS, TARGET, POSITION = 0x60400010, 0x60410010, 0x607A0020, 0x60640020
ONE_EACH = (pdo(0x1400, 0x200, CONTROL), pdo(0x1800, 0x180, STATUS))
SHEETS = {
    "one PDO each": ONE_EACH,
    "one PDO each, interpolated": ONE_EACH,
    "fixed identifiers": [
        pdo(parameter, function, entry, fixed="identifier")
        for parameter, function, entry in (
            (0x1400, 0x200, CONTROL), (0x1401, 0x300, CONTROL), (0x1800, 0x180, STATUS), (0x1801, 0x280, STATUS)
        )
    ],
    "fixed sets of the profile": [
        pdo(0x1400, 0x200, CONTROL, fixed="identifier, mapping", transmission=255),
        pdo(0x1402, 0x400, CONTROL, TARGET, fixed="identifier, mapping", transmission=255),
        pdo(0x1800, 0x180, STATUS, fixed="identifier, mapping", transmission=255),
        pdo(0x1802, 0x380, STATUS, POSITION, fixed="identifier, mapping", transmission=255),
    ],
    "entries in use alone": [
        pdo(0x1400, 0x200), pdo(0x1401, 0x300), pdo(0x1800, 0x180), pdo(0x1801, 0x280)
    ],
    "compact": [],
}  # fmt: skip


def sheet_of(folder, name: str) -> dict[str, object]:
    device = "CompactPDO=0x17\n" if name == "compact" else ""
    habits = DriveHabits(supported_modes=INTERPOLATED_AND_HOMING if "interpolated" in name else None)
    return {"eds_file": str(with_pdos(folder, *SHEETS[name], device=device)), "emulated": habits}


@pytest.mark.parametrize("incremental", [False, True], ids=["absolute", "incremental"])
@pytest.mark.parametrize("name", SHEETS)
def test_drive_with_such_pdos_homes_follows_and_stops(tmp_path, name: str, incremental: bool) -> None:
    keys = {"encoder": "incremental", "home_deg": 1.0, "homing_rate_degps": 15.0} if incremental else {}
    with served("cia402", cia402=sheet_of(tmp_path, name), **keys) as (emulator, device, clock):
        if incremental:
            device.home(clock.now_s())
            eventually(clock, lambda: set(device.read(clock.now_s()).homing) == {Homing.DONE})
        start, path = device.read(clock.now_s()).position, np.radians((3.0, -2.0, 1.0))
        for k in range(76):
            device.send(start + k / 75.0 * path, path / (75 * 0.02) * (k < 75), clock.now_s())
            clock.sleep(0.02)
            assert np.degrees(np.abs(device.read(clock.now_s()).position - start - k / 75.0 * path).max()) < 0.3
        assert device.counters()["protocol_errors"] == device.counters()["lost"] == 0
        device.send(start - path, -path, clock.now_s())
        clock.sleep(0.1)
        device.stop(clock.now_s())
        eventually(clock, lambda: {drive.state for drive in emulator.drives} == {codec.DriveState.QUICK_STOP_ACTIVE})
        assert set(device.read(clock.now_s()).homing) == {Homing.DONE}


def test_fault_in_a_report_of_one_pdo_is_a_drive_fault(tmp_path) -> None:
    with served("cia402", cia402=sheet_of(tmp_path, "one PDO each")) as (emulator, device, clock):
        emulator.drives[1].fail(0x7500)  # the emergency message is lost
        clock.sleep(0.2)
        with pytest.raises(DriveFault, match=r"turntable\.pitch: fault 0x7500"):
            device.read(clock.now_s())


def test_drive_of_another_device_type_is_one_by_its_data_sheet(tmp_path) -> None:
    path = with_pdos(tmp_path, *ONE_EACH)
    path.write_text(path.read_text().replace("DefaultValue=0x20192", "DefaultValue=0x00220811"))
    with served("cia402", cia402={"eds_file": str(path)}) as (_, device, clock):
        device.read(clock.now_s())
