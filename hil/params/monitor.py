"""Parameters of the docking monitor in the loop, from the scenario's units to SI."""

from __future__ import annotations

import math

import numpy as np

from hil.config.docking_monitor import DockingMonitorConfig
from hil.config.load import load_scene
from hil.config.rig import BenchGeometry
from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.dynamics.docking_monitor import MONITOR_MODEL
from hil.maths import quat
from hil.models.mounting import MOUNTING
from hil.monitor.kernels.interlock import INTERLOCK_PARAMS
from hil.params.gnc import largest_accelerations, protection_sigmas

_AGE_MAX_S = 2.0  # of a measurement


def mounting(config: DockingMonitorConfig) -> np.record:
    """Return MOUNTING of the television camera and the docking target; their axes are those of v and t."""
    params, axes = new(MOUNTING), BenchGeometry(lever_arm_m=(0.0, 0.0, 0.0))
    params.camera_position = config.camera_position_m
    params.q_vc = quat.from_matrix(np.array(axes.camera_axes))
    params.led_ring_position = config.target_position_m
    params.q_th = quat.from_matrix(np.array(axes.led_ring_axes))
    return params


def monitor_model(scenario: Scenario) -> np.record:
    """Return MONITOR_MODEL: one measurement per portion of the scene's images, in the field of its camera."""
    from hil.monitor.settings import MonitorSettings  # slow import, for runs with a docking monitor only

    config, settings = scenario.monitor, MonitorSettings()
    scene, params = load_scene(config.scene).value, new(MONITOR_MODEL)
    images_hz = scene.fps if scene.fields == "whole" else 2.0 * scene.fps
    params.rate_hz = max(images_hz / settings.portion_frames, 1.0 / settings.portion_s)
    params.latency_s = config.latency_s
    params.mounting = mounting(config)
    params.reference_range, params.sigma_range = config.reference_range_m, config.sigma_range_scale
    params.sigma_sight = math.radians(config.sigma_sight_deg)
    params.sigma_angle = math.radians(config.sigma_angle_deg)
    params.range_min, params.range_near = config.range_min_m, config.near_range_m
    params.range_max = config.range_max_m
    camera = scene.camera
    params.field = (0.5 * camera.width / camera.f, 0.5 * camera.height / camera.f)
    return params


def interlock(scenario: Scenario) -> np.record:
    """Return INTERLOCK_PARAMS."""
    config, params = scenario.monitor, new(INTERLOCK_PARAMS)
    params.sigmas, params.frames = config.interlock_sigmas, config.interlock_frames
    params.position = config.interlock_error_max_m
    params.attitude = math.radians(config.interlock_error_max_deg)
    params.acceleration, params.angular_acceleration = largest_accelerations(scenario.chaser)
    params.age_max_s, params.step_s = _AGE_MAX_S, scenario.step_s
    params.bound_sigmas = protection_sigmas(scenario)
    return params
