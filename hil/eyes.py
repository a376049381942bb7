"""Which eye a scenario asks for."""

from __future__ import annotations

from pathlib import Path

from hil import parameters
from hil.config.load import load_file
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.vmu_geometry import Camera, VmuGeometry
from hil.eye import Eye, Looks


def make_eye(scenario: Scenario, rig: Rig, seed: int) -> Looks:
    """Return what sees the target for the vision unit of ``rig``, as ``vmu.source`` says."""
    bench, stations = parameters.bench(rig, scenario.step_s), parameters.stations(rig)
    if scenario.vmu.source == "model":
        return Eye(bench, stations, parameters.vision(scenario), seed)
    from hil.rendered_eye import RenderedEye

    scene = rig_geometry(rig)
    path = rig.vmu.geometry_file
    geometry = scene if path is None else load_file(Path(path), VmuGeometry).value
    return RenderedEye(bench, stations, scene, geometry, scenario.vmu.pictures, seed)


def rig_geometry(rig: Rig) -> VmuGeometry:
    """Return the cameras and LEDs of ``rig``: principal points in the middle, no distortion."""
    camera = rig.vmu.camera
    one = Camera(
        fx=camera.focal_px,
        fy=camera.focal_px,
        cx=0.5 * (camera.width_px - 1),
        cy=0.5 * (camera.height_px - 1),
        width=camera.width_px,
        height=camera.height_px,
    )
    return VmuGeometry(leds_m=rig.vmu.leds_m, left=one, right=one, baseline_m=(camera.baseline_m, 0.0, 0.0))
