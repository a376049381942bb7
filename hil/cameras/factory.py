"""Which eye a scenario asks for."""

from __future__ import annotations

from hil.cameras.pose_model import PoseModel, PoseSensor
from hil.config.load import load_geometry
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import MakesPictures
from hil.params import gnc as gnc_params
from hil.vmu.geometry import geometry_of_rig


def make_pose_sensor(scenario: Scenario, rig: Rig, seed: int, shown: MakesPictures | None = None) -> PoseSensor:
    """Return what sees the target for the vision unit of ``rig``, as ``vmu.source`` says.

    shown: takes the pictures, where there are any.
    """
    bench, stations = gnc_params.bench(rig, scenario.step_s), gnc_params.stations(rig)
    if scenario.vmu.source == "model":
        return PoseModel(bench, stations, gnc_params.vision(scenario), seed)
    from hil.cameras.rendered import RenderedEye

    return RenderedEye(bench, stations, geometry_of_rig(rig), believed_geometry(rig), scenario.vmu.images, seed, shown)


def believed_geometry(rig: Rig) -> VmuGeometry:
    """Return what the vision unit of ``rig`` takes its cameras and LEDs for. Raises BadInput."""
    path = rig.vmu.geometry_file
    return geometry_of_rig(rig) if path is None else load_geometry(path).value
