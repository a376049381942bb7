"""Registry entries of the rail drivers: Modbus TCP and Modbus RTU."""

from __future__ import annotations

from typing import Final

from hil.config.rig import LINEAR_NAMES, LinearAxes, RailAxis, check_ids
from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.config.tables.rail_map import range_of
from hil.config.tables.wires import ModbusRtu

_DRIVES_LEAST: Final = 3  # for which the time-out must suffice


def _check_map(rails: LinearAxes) -> None:
    """Raise ValueError if the register map cannot serve an axis."""
    for name in rails.axis_names:
        axis: RailAxis = getattr(rails, name)
        if axis.encoder == "incremental" and not rails.map.homes:
            raise ValueError(f'{name}.encoder = "incremental" needs map.control_bits.home and map.status_bits.homed')
        for block, register in (("command", rails.map.command.position), ("state", rails.map.state.position)):
            low, high = range_of(register)
            if not low <= axis.travel_m[0] < axis.travel_m[1] <= high:
                raise ValueError(
                    f"{name}.travel_m {list(axis.travel_m)}: map.{block}.position ({register.type}, "
                    f"{register.scale:g} {register.unit} per count) holds {low:g} to {high:g} m"
                )


def _check_tcp(rails: LinearAxes) -> None:
    _check_map(rails)
    if rails.modbus is not None:
        wires = [getattr(rails.modbus, name) for name in rails.axis_names]
        given = [(wire.host, wire.port, wire.device_id) for wire in wires if wire.port is not None]
        if len(set(given)) != len(given):
            raise ValueError("modbus: two axes have the same host, port and device_id, allowed: different ones")


def _check_rtu(rails: LinearAxes) -> None:
    rtu, drives = rails.rtu or ModbusRtu(), max(_DRIVES_LEAST, len(rails.axes))
    check_ids("rtu.device_ids", rtu.device_ids, rails)
    exchanges = 2.0 * (drives + 2)  # one retry, and as much again for the drives' response times
    least_s = exchanges * rtu.exchange_s(rails.map)
    if rails.timeout_s < least_s:
        raise ValueError(
            f"timeout_s {rails.timeout_s:g}: too short for {drives} drives at {rtu.baud} baud with one retry, "
            f"allowed {least_s:.2f} or more"
        )
    _check_map(rails)


def _rtu_setpoints_hz(rails: LinearAxes) -> float:
    """The drives share the line: one exchange after the other."""
    return 1.0 / (len(rails.axes) * (rails.rtu or ModbusRtu()).exchange_s(rails.map))


def _identity(rails: LinearAxes) -> dict[str, str]:
    major, minor = rails.map.firmware_min
    return {"vendor": f"0x{rails.map.vendor:X}", "firmware from": f"{major}.{minor}"}


TCP: Final = DriverEntry(
    "rails",
    "modbus",
    driver="hil.drivers.rails.driver:ModbusRails",
    emulator="hil.parts.emulation.rails:RailsEmulator",
    wires=[WireKey(f"modbus.{name}", "tcp", name) for name in LINEAR_NAMES],
    check=_check_tcp,
    identity=_identity,
    axes=range(1, 7),
    keeps_bench_time=lambda table: True,
)
RTU: Final = DriverEntry(
    "rails",
    "modbus_rtu",
    driver="hil.drivers.rails.driver:ModbusRails",
    emulator="hil.parts.emulation.rails:RtuRailsEmulator",
    # a pseudo terminal has no parity bit; the emulated line accounts for its time
    wires=[WireKey("rtu.port", "serial", emulated={"parity": "none"})],
    check=_check_rtu,
    identity=_identity,
    axes=range(1, 7),
    setpoints_hz=_rtu_setpoints_hz,
    keeps_bench_time=lambda table: True,
)
