"""Checks of the devices of an emulated rig, whose emulators run meanwhile."""

from __future__ import annotations

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.clock import WallClock
from hil.errors import DeviceError
from hil.parts.emulation.emulated_devices import EmulatedDevices
from hil.parts.wires.devices import wired_checks
from hil.preflight.check import PreflightCheck


def emulated_checks(scenario: Scenario, rig: Rig, enable_drives: bool) -> list[PreflightCheck]:
    """Return the checks of clock, links and devices of an emulated rig; its drives are enabled in any case."""
    clock = WallClock()
    try:
        with EmulatedDevices(scenario, rig, clock, seed=0) as emulated:
            return wired_checks(scenario, emulated.wait_ready()[0], clock, enable_drives=True)
    except DeviceError as error:
        return [PreflightCheck("emulators", False, str(error), "hil emulate shows the messages of the emulators")]
