"""Registry entries of rails and turntable that a robot stands for; its own driver is that of ``[arm]``."""

from __future__ import annotations

from hil.config.tables.driver_registry import Device, DriverEntry


def _entry(device: Device) -> DriverEntry:
    return DriverEntry(device, "arm", driver="hil.drivers.arm.device:make_arm", keeps_bench_time=lambda table: True)


RAILS, TURNTABLE = _entry("rails"), _entry("turntable")
