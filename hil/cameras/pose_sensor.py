"""Simulated vision unit: pose from the axis positions, by a noise model or by rendered images."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.config.load import load_geometry
from hil.config.rig import Rig, Vmu
from hil.config.scenario import Scenario, VisionNoise
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import ImageSink
from hil.core.messages import VMU_FRAME, Array, PoseFrame, new
from hil.drivers.vmu.transport import Transport
from hil.maths.random_streams import NormalRows, noise_source, stream
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.errors import VISION_MEMORY
from hil.sensors.vision_unit.model import VISION_NOISE, measure_frame
from hil.vmu.estimators import PoseEstimator, board_of, make_estimator
from hil.vmu.geometry import geometry_of_rig, nominal_geometry


class PoseSensor(Protocol):
    """Converts the bench's encoder values to the pose that the vision unit would report."""

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the measured pose of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``; None without one."""


class PoseModel:
    """Pose sensor with the error model of a vision unit, without images. scenario, rig, seed: of the run.

    memory: VISION_MEMORY, what the errors keep from exposure to exposure; None: of its own.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int, memory: np.record | None = None) -> None:
        self._bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._mounting = vmu_params.mounting(rig)
        self._vision = vmu_params.model(scenario, seed)
        self._camera, self.leds = vmu_params.camera(rig)
        self.noise = NormalRows(noise_source(seed, "vision"), VISION_NOISE)
        """One row per exposure."""
        self._memory = new(VISION_MEMORY) if memory is None else memory
        self._frame = new(VMU_FRAME)
        self._r = np.empty(3)
        self._q = np.empty(4)

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the measured pose of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``; None without one."""
        frame = self._frame
        frame.t_s = frame.received_s = t_s
        pose_on_bench(self._bench, rail_m, gimbal_rad, self._r, self._q)
        measure_frame(
            self._vision, self._camera, self.leds, self._mounting, self._r, self._q, self.noise.next_row(), t_s,
            self._memory, frame,
        )  # fmt: skip
        return None if math.isnan(frame.t_v[0]) else PoseFrame.from_record(frame)


def transport(vmu: VisionNoise, seed: int) -> Transport:
    """Return the transport of a simulated vision unit's frames: latency, duplicates, losses."""
    return Transport(
        noise_source(seed, "transport"),
        vmu.latency_s,
        vmu.latency_jitter_s,
        vmu.duplicate_probability,
        vmu.loss_probability,
    )


def make_pose_sensor(
    scenario: Scenario, rig: Rig, seed: int, shown: ImageSink | None = None, memory: np.record | None = None
) -> PoseSensor:
    """Return the pose sensor for the vision unit of ``rig``, as selected by ``vmu.source``.

    shown: receives the rendered images, if any. memory: see ``PoseModel``.
    """
    if scenario.vmu.source == "model":
        return PoseModel(scenario, rig, seed, memory)
    from hil.cameras.rendered import RenderedCameras, RenderedPoseSensor

    bench, mounting = bench_params.bench(rig, scenario.step_s, scenario.bench), vmu_params.mounting(rig)
    rng, estimator = stream(seed, "pictures"), estimator_of_unit(rig.vmu)
    images = scenario.vmu.images
    cameras = RenderedCameras(bench, mounting, geometry_of_rig(rig), images, rng, board_of(estimator))
    return RenderedPoseSensor(cameras, estimator, rng, shown, rig.vmu.covariance == "noise")


def calibrated_geometry(rig: Rig) -> VmuGeometry:
    """Return the geometry that the vision unit of ``rig`` assumes for its cameras and LEDs. Raises BadInput."""
    return geometry_of_unit(rig.vmu)


def estimator_of_unit(vmu: Vmu) -> PoseEstimator:
    """Return the estimator that solves the images of the vision unit ``vmu``. Raises BadInput."""
    return make_estimator(vmu.estimator, geometry_of_unit(vmu), vmu.estimator_settings)


def geometry_of_unit(vmu: Vmu) -> VmuGeometry:
    """Return the geometry that the vision unit ``vmu`` assumes for its cameras and LEDs. Raises BadInput."""
    return nominal_geometry(vmu) if vmu.geometry_file is None else load_geometry(vmu.geometry_file).value
