"""Adapters that collect bytes for 16 ms: the promised rate is the measured one, or preflight warns."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from hil.config.rig import AxisGroupTable
from hil.drivers.base import AxisGroup
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.wires import devices
from hil.parts.wires.devices import _exchange_rate, _promised_hz
from tests.behaviour.test_rails_faults import bench_of
from tests.support.turntable_bench import served, turntable

FTDI = {"adapter_latency_s": 0.016}
Serving = tuple[AxisGroup, LockStepConductor, AxisGroupTable]


@contextmanager
def serial_device(kind: str) -> Iterator[Serving]:
    """Yield an open driver on an adapter that collects bytes, its clock, and its table."""
    if kind == "modbus_rtu":
        rtu = {"baud": 115_200, "parity": "none", **FTDI}
        with bench_of("emulated-rtu", rtu=rtu) as bench:
            bench.open()
            yield bench.rails, bench.clock, bench.rails._config
        return
    keys: dict[str, Any] = {"cia402": FTDI} if kind == "cia402" else {"line": FTDI}
    with served(kind, **keys) as (_, device, clock):
        yield device, clock, turntable(kind, "/dev/null", **keys)


def undeclared(table: AxisGroupTable) -> AxisGroupTable:
    """Return the table of a lab that ignores its adapter."""
    wires = {
        name: wire.model_copy(update={"adapter_latency_s": 0.0})
        for name in ("rtu", "cia402", "ascii")
        if (wire := getattr(table, name, None)) is not None
    }
    return table.model_copy(update=wires)


@pytest.mark.parametrize("kind", ["modbus_rtu", "cia402", "ascii", "acu"])
def test_rate_of_a_line_with_an_adapter_is_measured_and_shown(kind: str, monkeypatch) -> None:
    with serial_device(kind) as (device, clock, table):
        monkeypatch.setattr(devices, "time", SimpleNamespace(sleep=clock.sleep))  # not of other threads of this process
        declared_hz, other_hz = (_promised_hz(each, device.name) for each in (table, undeclared(table)))
        said, text = (_exchange_rate(device, clock, hz) for hz in (declared_hz, other_hz))
        sys.stdout.write(f"{kind}: {other_hz:.1f} Hz without adapter, {declared_hz:.1f} with it: {said}\n")
        assert float(said.split()[1]) == pytest.approx(declared_hz, rel=0.25)
        assert "an adapter that collects bytes" not in said
        assert f"{other_hz:.0f} by the rates of its wires: an adapter that collects bytes" in text
