"""Parameters of the vision unit: its noise, its cameras and where they are mounted, from user units to SI."""

from __future__ import annotations

import math

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array, new
from hil.dynamics.vision import VISION_PARAMS
from hil.maths import quat
from hil.models.camera import CAMERA
from hil.models.mounting import MOUNTING
from hil.params.errors import vision_errors


def vision(scenario: Scenario, seed: int = 0) -> np.record:
    """Return VISION_PARAMS. seed: of the run, for errors."""
    params = new(VISION_PARAMS)
    params.sigma_position = scenario.vmu.sigma_position_m
    params.sigma_angle = math.radians(scenario.vmu.sigma_angle_deg)
    params.reference_range = scenario.vmu.reference_range_m
    params.reported_scale = scenario.vmu.reported_sigma_scale
    params.errors = vision_errors(scenario, seed)
    return params


def mounting(rig: Rig) -> np.record:
    """Return MOUNTING: camera on the chaser, LED ring on the target."""
    params = new(MOUNTING)
    params.camera_position = rig.bench.camera_position_m
    params.q_vc = quat.from_matrix(np.array(rig.bench.camera_axes))
    params.led_ring_position = rig.bench.led_ring_position_m
    params.q_th = quat.from_matrix(np.array(rig.bench.led_ring_axes))
    params.position_variance = rig.vmu.bench_sigma_m**2
    params.attitude_variance = math.radians(rig.vmu.bench_sigma_deg) ** 2
    return params


def camera(rig: Rig) -> tuple[np.record, Array]:
    """Return CAMERA, and the LEDs of the ring in t, (n, 3), m."""
    params = new(CAMERA)
    settings = rig.vmu.camera
    params.focal = settings.focal_px
    params.width = settings.width_px
    params.height = settings.height_px
    params.baseline = settings.baseline_m
    return params, np.array(rig.vmu.leds_m, dtype=float)
