"""Registry entry of the I/O coupler on Modbus TCP."""

from __future__ import annotations

from typing import Final

from hil.config.tables.driver_registry import DriverEntry, WireKey

ENTRY: Final = DriverEntry(
    "io",
    "modbus",
    driver="hil.drivers.io.driver:ModbusIo",
    emulator="hil.parts.emulation.digital_io:IoEmulator",
    wires=[WireKey("", "tcp")],
    identity=lambda io: io.identity.model_dump(exclude_none=True),
    keeps_bench_time=lambda table: True,
)
