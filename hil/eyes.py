"""Which eye a scenario asks for."""

from __future__ import annotations

from pathlib import Path

from hil import parameters
from hil.config.load import load_file
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.vmu_geometry import VmuGeometry
from hil.eye import Eye, Looks
from hil.vmu.geometry import geometry_of_rig


def make_eye(scenario: Scenario, rig: Rig, seed: int) -> Looks:
    """Return what sees the target for the vision unit of ``rig``, as ``vmu.source`` says."""
    bench, stations = parameters.bench(rig, scenario.step_s), parameters.stations(rig)
    if scenario.vmu.source == "model":
        return Eye(bench, stations, parameters.vision(scenario), seed)
    from hil.rendered_eye import RenderedEye

    scene = geometry_of_rig(rig)
    path = rig.vmu.geometry_file
    geometry = scene if path is None else load_file(Path(path), VmuGeometry).value
    return RenderedEye(bench, stations, scene, geometry, scenario.vmu.pictures, seed)
