"""Docking monitor of a scenario: places of camera and target, and its table ``[monitor]`` as a sensor of the loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hil.config.load import load_scene
from hil.config.rig import BenchGeometry
from hil.config.scenario import Scenario
from hil.config.tables.docking_monitor import DockingMonitorConfig
from hil.config.tables.sensors import SensorConfig
from hil.core.messages import new
from hil.maths import quat
from hil.sensors.mounting import MOUNTING


def mounting(config: DockingMonitorConfig) -> np.record:
    """Return MOUNTING of the television camera and the docking target; their axes are those of v and t."""
    params, axes = new(MOUNTING), BenchGeometry(lever_arm_m=(0.0, 0.0, 0.0))
    params.camera_position = config.camera_position_m
    params.q_vc = quat.from_matrix(np.array(axes.camera_axes))
    params.led_ring_position = config.target_position_m
    params.q_th = quat.from_matrix(np.array(axes.led_ring_axes))
    return params


def monitor_sensor(scenario: Scenario) -> SensorConfig:
    """Return the docking monitor as a witness: one measurement per portion of its scene's images, in their field."""
    from hil.parts.monitor.settings import MonitorSettings  # slow import, for runs with a docking monitor only

    config, settings = scenario.monitor, MonitorSettings()
    scene = load_scene(config.scene).value
    images_hz, camera = scene.fps if scene.fields == "whole" else 2.0 * scene.fps, scene.camera
    places: dict[str, Any] = {
        f"{name}_{axis}_m": value
        for name, position in (("camera", config.camera_position_m), ("target", config.target_position_m))
        for axis, value in zip("xyz", position, strict=True)
    }
    return SensorConfig(
        kind="docking_monitor",
        use="witness",
        rate_hz=max(images_hz / settings.portion_frames, 1.0 / settings.portion_s),
        latency_s=config.latency_s,
        interlock_sigmas=config.interlock_sigmas,
        interlock_samples=config.interlock_frames,
        **places,
        error_m=config.interlock_error_max_m,
        error_rad=math.radians(config.interlock_error_max_deg),
        reference_range_m=config.reference_range_m,
        sigma_range_scale=config.sigma_range_scale,
        sigma_sight_rad=math.radians(config.sigma_sight_deg),
        sigma_angle_rad=math.radians(config.sigma_angle_deg),
        range_min_m=config.range_min_m,
        near_range_m=config.near_range_m,
        range_max_m=config.range_max_m,
        field_right=0.5 * camera.width / camera.f,
        field_up=0.5 * camera.height / camera.f,
    )
