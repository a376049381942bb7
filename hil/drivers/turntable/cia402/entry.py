"""Registry entry of the CiA 402 turntable drives."""

from __future__ import annotations

from typing import Final

from hil.config.rig import Cia402, RotaryAxes, check_ids
from hil.config.tables.driver_registry import DriverEntry, WireKey

_PDO_BITS: Final = 111  # data frame of 8 bytes and interframe space, without stuff bits (ISO 11898-1)
_SYNC_BITS: Final = 47  # frame without data
_ADAPTER_BYTES: Final = {"serial": (19, 11), "slcan": (22, 6)}  # bytes of both on the serial port of an adapter
_BITS_PER_BYTE: Final = 10


def _check(turntable: RotaryAxes) -> None:
    if turntable.cia402 is None:
        raise ValueError("cia402: is missing, the table of its bus")
    check_ids("cia402.node_ids", turntable.cia402.node_ids, turntable)


def _check_files(turntable: RotaryAxes) -> list[str]:
    from hil.drivers.turntable.cia402.eds import Eds  # on use: importing canopen is slow

    assert turntable.cia402 is not None  # ``_check``
    return Eds.of(turntable.cia402, homing=any(axis.encoder == "incremental" for axis in turntable.axes)).losses()


def _setpoints_hz(turntable: RotaryAxes) -> float:
    """A setpoint per axis and SYNC, as many replies: on the bus in turn, on a serial adapter one direction each."""
    can = turntable.cia402 or Cia402()
    bus_bits = 2 * len(turntable.axes) * _PDO_BITS + _SYNC_BITS
    hz = can.bitrate / bus_bits
    if can.interface in _ADAPTER_BYTES:
        pdo, sync = _ADAPTER_BYTES[can.interface]
        bits = _BITS_PER_BYTE * (len(turntable.axes) * pdo + sync)
        hz = 1.0 / (max(1.0 / hz, bits / can.baud) + can.adapter_latency_s)
    return hz


def _identity(turntable: RotaryAxes) -> dict[str, str]:
    if (can := turntable.cia402) is None:
        return {}
    numbers = {"vendor": can.vendor_id, "product": can.product_code, "revision from": can.revision_min}
    required = {name: f"0x{value:X}" for name, value in numbers.items() if value is not None}
    return required if can.firmware is None else {**required, "firmware": can.firmware}


ENTRY: Final = DriverEntry(
    "turntable",
    "cia402",
    driver="hil.drivers.turntable.cia402.driver:Cia402Turntable",
    emulator="hil.parts.emulation.cia402:Cia402Emulator",
    wires=[WireKey("cia402.channel", "can")],
    check_files=_check_files,
    identity=_identity,
    axes=range(1, 7),
    check=_check,
    setpoints_hz=_setpoints_hz,
    keeps_bench_time=lambda table: bool(table.cia402.interface == "serial"),
)
