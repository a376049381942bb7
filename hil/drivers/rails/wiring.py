"""Wires of the rail drives as configured in the rig file; drives on one wire share it."""

from __future__ import annotations

from typing import Final

from hil.config.rail_wires import ModbusRtu
from hil.config.rig import LinearAxes, ModbusAxis
from hil.core.clock import BenchClock
from hil.drivers.rails.drive import ATTEMPTS, ModbusDevice
from hil.drivers.rails.frames import Counters
from hil.drivers.rails.modbus_bus import ModbusBus

# Waiting for one drive delays the commands of the others: it must stay below their watchdog time.
ATTEMPT_MAX_S: Final = 0.2


def make_wires(config: LinearAxes, timeout_s: float, counters: Counters, clock: BenchClock) -> list[ModbusDevice]:
    """Return the wires of the axes, not connected yet. Requires a running event loop.

    timeout_s: within which a dead wire is reported.
    """
    if config.driver == "modbus_rtu":
        rtu = config.rtu or ModbusRtu()
        line = ModbusBus.on_port(rtu.port or "", rtu, rtu.exchange_s(config.map), counters, clock)
        attempt_s = _attempt_s(timeout_s, len(config.axes))
        return [ModbusDevice(line, rtu.device_ids[axis], attempt_s) for axis in config.axis_numbers]
    axes = tcp_axes(config)
    hosts = [(axis.host, axis.port or 0) for axis in axes]
    lines = {host: ModbusBus.to_host(*host, counters, clock) for host in dict.fromkeys(hosts)}
    return [
        ModbusDevice(lines[host], axis.device_id, _attempt_s(timeout_s, hosts.count(host)))
        for host, axis in zip(hosts, axes, strict=True)
    ]


def _attempt_s(timeout_s: float, drives: int) -> float:
    """Return the time for one response if ``drives`` share a wire, s.

    On a dead wire each of them waits once before the first one retries and reports the failure.
    """
    return min(timeout_s / (drives + ATTEMPTS - 1), ATTEMPT_MAX_S)


def tcp_axes(config: LinearAxes) -> list[ModbusAxis]:
    """Return the TCP settings of the drives."""
    return [getattr(config.modbus, name, ModbusAxis()) for name in config.axis_names]
