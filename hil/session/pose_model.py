"""Simulated vision unit: pose from the axis positions, by its error model or by the sensor that a part has."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.config.rig import Rig
from hil.config.scenario import Scenario, VisionNoise
from hil.core.messages import VMU_FRAME, Array, PoseFrame, new
from hil.core.part import provided
from hil.drivers.vmu.transport import Transport
from hil.maths.random_streams import NormalRows, noise_source
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.errors import VISION_MEMORY
from hil.sensors.vision_unit.model import VISION_NOISE, measure_frame

if TYPE_CHECKING:
    from hil.core.camera_images import ImageSink


class PoseSensor(Protocol):
    """Converts the bench's encoder values to the pose that the vision unit would report."""

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the measured pose of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,) at ``t_s``; None without one."""


class PoseModel:
    """Pose sensor with the error model of a vision unit, without images. scenario, rig, seed: of the run.

    memory: VISION_MEMORY, what the errors keep from exposure to exposure; None: of its own.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int, memory: np.record | None = None) -> None:
        self._bench = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench)
        self._mounting = vmu_params.mounting_as_built(rig, scenario)
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
    rendered: PoseSensor = provided(f"vmu.source={scenario.vmu.source}", "scenario")(scenario, rig, seed, shown)
    return rendered
