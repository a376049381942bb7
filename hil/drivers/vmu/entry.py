"""Registry entry of the vision unit on RS-422."""

from __future__ import annotations

from typing import Final

from hil.config.driver_registry import DriverEntry, WireKey

ENTRY: Final = DriverEntry(
    "vmu",
    "rs422",
    driver="hil.drivers.vmu.driver:Rs422Vmu",
    emulator="hil.drivers.vmu.emulator:VmuEmulator",
    wires=[WireKey("rs422.port", "serial")],
    identity=lambda vmu: vmu.identity.model_dump(exclude_none=True),
)
