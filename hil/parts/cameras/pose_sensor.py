"""Vision unit of rendered images in memory, and the cameras and targets that the unit of a rig assumes."""

from __future__ import annotations

from hil.config.load import load_geometry
from hil.config.rig import Rig, Vmu
from hil.config.scenario import Scenario
from hil.config.vmu_geometry import OFFICIAL, VmuGeometry
from hil.core.camera_images import GEOMETRY_FILE, ImageSink
from hil.maths.random_streams import stream
from hil.params import bench as bench_params
from hil.parts.cameras.rendered import RenderedCameras, RenderedPoseSensor
from hil.sensors.vision_unit import parameters as vmu_params
from hil.vmu.estimators import DRAWN, LED_RING, PoseEstimator, board_of, make_estimator
from hil.vmu.geometry import geometry_of_rig, nominal_geometry


def rendered_pose_sensor(scenario: Scenario, rig: Rig, seed: int, shown: ImageSink | None = None) -> RenderedPoseSensor:
    """Return the pose sensor that renders the images of the vision unit of ``rig`` and solves them.

    shown: receives the images.
    """
    bench = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench)
    mounting = vmu_params.mounting_as_built(rig, scenario)
    rng, estimator = stream(seed, "pictures"), estimator_of_unit(rig.vmu)
    images = scenario.vmu.images
    cameras = RenderedCameras(bench, mounting, geometry_of_rig(rig), images, rng, board_of(estimator))
    return RenderedPoseSensor(cameras, estimator, rng, shown, rig.vmu.covariance == "noise")


def calibrated_geometry(rig: Rig) -> VmuGeometry:
    """Return the geometry that the vision unit of ``rig`` assumes for its cameras and LEDs. Raises BadInput."""
    return geometry_of_unit(rig.vmu)


def estimator_of_unit(vmu: Vmu) -> PoseEstimator:
    """Return the estimator that solves the images of the vision unit ``vmu``. Raises BadInput."""
    source = vmu.geometry_file or "rig: vmu.geometry_file"
    return make_estimator(vmu.estimator, geometry_of_unit(vmu), vmu.estimator_settings, source)


def geometry_of_unit(vmu: Vmu) -> VmuGeometry:
    """Return the geometry that the vision unit ``vmu`` assumes for its cameras and LEDs. Raises BadInput."""
    if vmu.geometry_file is not None:
        return load_geometry(vmu.geometry_file).value
    geometry = nominal_geometry(vmu)
    is_drawn = vmu.driver != "cameras" and vmu.estimator != LED_RING
    return geometry.model_copy(update={"print": DRAWN.get(vmu.estimator, OFFICIAL)}) if is_drawn else geometry


def attachments(scenario: Scenario, rig: Rig) -> dict[str, str]:
    """Return the attachment of a recording of rendered images: cameras and target as the vision unit assumes them."""
    if scenario.vmu.source != "rendered":
        return {}
    return {GEOMETRY_FILE: calibrated_geometry(rig).model_dump_json()}
