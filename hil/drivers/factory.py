"""Drivers of a rig with wires, as its configuration selects them."""

from __future__ import annotations

from hil.config.rig import Rig
from hil.core.clock import BenchClock
from hil.drivers.base import AxisGroup, PoseSource


def make_drivers(rig: Rig, clock: BenchClock) -> tuple[AxisGroup, AxisGroup, PoseSource, AxisGroup | None]:
    """Return the drivers of rails, turntable and vision unit, and of the target's axes if the target is moved."""
    target = rig.target_axes.make_driver(clock, "target") if rig.target_axes else None
    rails, turntable = rig.rails.make_driver(clock, "rails"), rig.turntable.make_driver(clock, "turntable")
    return rails, turntable, rig.vmu.make_driver(clock), target
