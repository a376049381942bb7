"""Kernels of the vision unit and of its rendered images."""

from __future__ import annotations

from hil.config.load import load_rig, load_scenario
from hil.parts.cameras.pose_sensor import rendered_pose_sensor
from hil.session.assembly import start_axes
from hil.vmu.geometry import geometry_of_rig
from hil.vmu.unit import VisionUnit


def compile_kernels() -> None:
    """Call the kernels of the vision unit, of its search and its windows, and of its rendered images once."""
    scenario, rig = load_scenario("scheme-1", ("vmu.source=rendered",)).value, load_rig("mock").value
    VisionUnit(geometry_of_rig(rig)).warm_up()
    sensor, start = rendered_pose_sensor(scenario, rig, 0), start_axes(scenario, rig)
    for k in range(3):
        sensor.measure(start.rail_m, start.gimbal_rad, k / rig.vmu.rate_hz)
