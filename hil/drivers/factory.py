"""Drivers of a rig with wires, as its configuration selects them."""

from __future__ import annotations

from dataclasses import dataclass

from hil.config.rig import AxisGroupTable, Rig
from hil.core.clock import BenchClock
from hil.drivers.base import AxisGroup, Parks, PoseSource, full_names
from hil.drivers.split_axes import AxisPart, SplitAxes, SplitParkingAxes


@dataclass(frozen=True)
class RigDrivers:
    """Drivers of a rig. axes: by the names of their devices, ``rails`` and ``turntable`` first; poses: vision unit."""

    axes: dict[str, AxisGroup]
    poses: PoseSource


def make_drivers(rig: Rig, clock: BenchClock) -> RigDrivers:
    """Return the drivers of all axes and of the vision unit."""
    axes = {name: make_axes(table, clock, name) for name, table in rig.axis_groups.items()}
    return RigDrivers(axes, rig.vmu.make_driver(clock))


def make_axes(table: AxisGroupTable, clock: BenchClock, name: str) -> AxisGroup:
    """Return the driver of the axes of ``table``: one of its own, or one per controller, together."""
    made = [
        AxisPart(part.make_driver(clock, part_name), [table.axis_names.index(axis) for axis in part.axis_names])
        for part_name, part in table.parts(name).items()
    ]
    if len(made) == 1:
        return made[0].axes
    split = SplitParkingAxes if all(isinstance(part.axes, Parks) for part in made) else SplitAxes
    return split(name, full_names(name, table.axis_names), made, clock)
