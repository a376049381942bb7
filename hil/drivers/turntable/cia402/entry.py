"""Registry entry of the CiA 402 turntable drives."""

from __future__ import annotations

from typing import Final

from hil.config.driver_registry import DriverEntry, WireKey
from hil.config.rig import GIMBAL_NAMES, Turntable


def _check_files(turntable: Turntable) -> list[str]:
    from hil.drivers.turntable.cia402.eds import Eds  # on use: importing canopen is slow

    if turntable.cia402 is not None:
        Eds.of(turntable.cia402, homing=any(getattr(turntable, name).encoder == "incremental" for name in GIMBAL_NAMES))
    return []


def _identity(turntable: Turntable) -> dict[str, str]:
    if (can := turntable.cia402) is None:
        return {}
    numbers = {"vendor": can.vendor_id, "product": can.product_code, "revision from": can.revision_min}
    required = {name: f"0x{value:X}" for name, value in numbers.items() if value is not None}
    return required if can.firmware is None else {**required, "firmware": can.firmware}


ENTRY: Final = DriverEntry(
    "turntable",
    "cia402",
    driver="hil.drivers.turntable.cia402.driver:Cia402Turntable",
    emulator="hil.drivers.turntable.cia402.emulator:Cia402Emulator",
    wires=[WireKey("cia402.channel", "can")],
    check_files=_check_files,
    identity=_identity,
)
