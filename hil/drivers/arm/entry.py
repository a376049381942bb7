"""Registry entries of axes that a robot stands for; its own driver is that of ``[arm]`` or ``[target_arm]``."""

from __future__ import annotations

from hil.config.tables.driver_registry import Device, DriverEntry


def _entry(device: Device) -> DriverEntry:
    return DriverEntry(
        device, "arm", "hil.drivers.arm.device:make_arms", axes=range(1, 4), keeps_bench_time=lambda _: True
    )


RAILS, TURNTABLE = _entry("rails"), _entry("turntable")
