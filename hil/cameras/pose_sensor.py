"""Simulated vision unit: pose from the axis positions, by a noise model or by rendered images."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.load import load_geometry
from hil.config.rig import Rig
from hil.config.scenario import Scenario, VisionNoise
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import ImageSink
from hil.core.messages import Array, PoseFrame
from hil.drivers.vmu.transport import Transport
from hil.dynamics.vision import ALL_LEDS, VISION_NOISE, measure
from hil.maths.random_streams import NormalRows, stream
from hil.params import bench as bench_params
from hil.params import vision as vision_params
from hil.vmu.geometry import geometry_of_rig


class PoseSensor(Protocol):
    """Converts the bench's encoder values to the pose that the vision unit would report."""

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the measured pose of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``; None without one."""


class PoseModel:
    """Pose sensor with the noise model of a vision unit, without images."""

    def __init__(self, bench: np.record, mounting: np.record, vision: np.record, seed: int) -> None:
        self._bench = bench
        self._mounting = mounting
        self._vision = vision
        self.noise = NormalRows(stream(seed, "vision"), VISION_NOISE)
        """One row per exposure."""
        self._r = np.empty(3)
        self._q = np.empty(4)

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame:
        """Return the measured pose of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``."""
        t_v, q_vt, covariance = np.empty(3), np.empty(4), np.empty((6, 6))
        pose_of_axes(self._bench, rail_m, gimbal_rad, self._r, self._q)
        measure(self._vision, self._mounting, self._r, self._q, self.noise.next_row(), t_v, q_vt, covariance)
        return PoseFrame(0, t_s, t_s, t_v, q_vt, covariance, leds_left=ALL_LEDS, leds_right=ALL_LEDS)


def transport(vmu: VisionNoise, seed: int) -> Transport:
    """Return the transport of a simulated vision unit's frames: latency, duplicates, losses."""
    return Transport(
        stream(seed, "transport"), vmu.latency_s, vmu.latency_jitter_s, vmu.duplicate_probability, vmu.loss_probability
    )


def make_pose_sensor(scenario: Scenario, rig: Rig, seed: int, shown: ImageSink | None = None) -> PoseSensor:
    """Return the pose sensor for the vision unit of ``rig``, as selected by ``vmu.source``.

    shown: receives the rendered images, if any.
    """
    bench, mounting = bench_params.bench(rig, scenario.step_s), vision_params.mounting(rig)
    if scenario.vmu.source == "model":
        return PoseModel(bench, mounting, vision_params.vision(scenario), seed)
    from hil.cameras.rendered import RenderedPoseSensor

    return RenderedPoseSensor(
        bench, mounting, geometry_of_rig(rig), calibrated_geometry(rig), scenario.vmu.images, seed, shown
    )


def calibrated_geometry(rig: Rig) -> VmuGeometry:
    """Return the geometry that the vision unit of ``rig`` assumes for its cameras and LEDs. Raises BadInput."""
    path = rig.vmu.geometry_file
    return geometry_of_rig(rig) if path is None else load_geometry(path).value
