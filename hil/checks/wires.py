"""Which wires the drivers of a rig will open."""

from __future__ import annotations

from dataclasses import dataclass

from hil.config.flight_computer import FlightComputer
from hil.config.rig import RAIL_NAMES, ModbusAxis, Rig

_SERIAL_CAN = ("serial", "slcan")  # interfaces of python-can that are serial ports


@dataclass(frozen=True, slots=True)
class Wire:
    """One wire of the rig. kind: "serial", "tcp" or "can"; address: path, host:port or interface."""

    key: str
    kind: str
    address: str


def wires(rig: Rig) -> list[Wire]:
    """Return the wires that the rig's drivers will open."""
    found = []
    if rig.rails.driver == "modbus" and rig.rails.modbus is not None:
        for name in RAIL_NAMES:
            axis: ModbusAxis = getattr(rig.rails.modbus, name)
            found.append(Wire(f"rails.modbus.{name}", "tcp", f"{axis.host}:{axis.port}"))
    if rig.rails.driver == "modbus_rtu" and rig.rails.rtu is not None and rig.rails.rtu.port is not None:
        found.append(Wire("rails.rtu.port", "serial", rig.rails.rtu.port))
    can, line = rig.turntable.cia402, rig.turntable.ascii
    if rig.turntable.driver == "cia402" and can is not None and can.channel is not None:
        found.append(Wire("turntable.cia402.channel", _kind_of_can(can.interface), can.channel))
    if rig.turntable.driver == "ascii" and line is not None and line.port is not None:
        found.append(Wire("turntable.ascii.port", "serial", line.port))
    if rig.io is not None and rig.io.driver == "modbus":
        found.append(Wire("io", "tcp", f"{rig.io.host}:{rig.io.port}"))
    if rig.vmu.driver == "rs422" and rig.vmu.rs422 is not None and rig.vmu.rs422.port is not None:
        found.append(Wire("vmu.rs422.port", "serial", rig.vmu.rs422.port))
    found += _of_flight_computer(rig.flight_computer)
    if (target := rig.moved_target) is not None and target.driver == "modbus" and target.modbus is not None:
        for name in RAIL_NAMES:
            axis = getattr(target.modbus, name)
            found.append(Wire(f"target_manipulator.modbus.{name}", "tcp", f"{axis.host}:{axis.port}"))
    return found


def _kind_of_can(interface: str) -> str:
    return "can" if interface == "socketcan" else "serial" if interface in _SERIAL_CAN else "other"


def _of_flight_computer(computer: FlightComputer) -> list[Wire]:
    found = []
    if computer.words == "serial" and computer.serial.port is not None:
        found.append(Wire("flight_computer.serial.port", "serial", computer.serial.port))
    if computer.words == "can" and computer.can.channel is not None:
        found.append(Wire("flight_computer.can.channel", _kind_of_can(computer.can.interface), computer.can.channel))
    if computer.poses.port is not None:
        found.append(Wire("flight_computer.poses.port", "serial", computer.poses.port))
    return found
