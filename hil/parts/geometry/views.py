"""What the vision unit of a rig sees of a plan of poses, and its noise."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.bench.field_of_view import view_margins
from hil.core.messages import Array
from hil.maths import euler, quat
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params
from hil.session.build import Job

_TURN: Final = 0.8  # rad, largest angle of a gimbal of a pose that is aimed at the ring
_RANGE_M: Final = (0.5, 8.0)  # from camera to ring


def shown_by(job: Job, axes: Array, source: str) -> np.ndarray:
    """Return whether ``source`` has a pose at ``axes`` (n, 6): mask (n,); a tracker has one everywhere."""
    if source != "vmu":
        return np.ones(len(axes), dtype=bool)
    rig, scenario = job.rig.value, job.scenario.value
    if not rig.has_vmu:
        return np.zeros(len(axes), dtype=bool)
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    camera, leds = vmu_params.camera(rig)
    margins = np.empty(len(axes))
    rails, gimbals = np.ascontiguousarray(axes[:, :3]), np.ascontiguousarray(axes[:, 3:])
    view_margins(bench, vmu_params.mounting(rig), camera, leds, rails, gimbals, margins)
    return margins > 0.0


def sigma_of_vision(job: Job, average_s: float) -> Array:
    """Return the noise of a pose of the vision unit, averaged, (6,), m and rad, at the reference range."""
    vmu, frames = job.scenario.value.vmu, max(1.0, average_s * job.rig.value.vmu.rate_hz)
    sigma = np.array([vmu.sigma_position_m] * 3 + [np.radians(vmu.sigma_angle_deg)] * 3)
    averaged: Array = sigma / np.sqrt(frames)
    return averaged


def aimed_axes(job: Job, rng: np.random.Generator) -> Array:
    """Return axes, (6,), m and rad, at random, at which the LED ring is in the image of the left camera."""
    rig, scenario = job.rig.value, job.scenario.value
    bench, mounting = bench_params.bench(rig, scenario.step_s, scenario.bench), vmu_params.mounting(rig)
    camera = rig.vmu.camera
    low, high = (np.clip(np.array(end)[3:], -_TURN, _TURN) for end in (bench.low, bench.high))
    angles = rng.uniform(low, high)
    spread = 0.5 * np.array([camera.width_px, camera.height_px]) / camera.focal_px
    along = float(np.exp(rng.uniform(*np.log(_RANGE_M))))
    p_v = along * np.array([*(rng.uniform(-1.0, 1.0, 2) * spread), 1.0])
    q = euler.to_quaternion(angles, np.array(bench.order))
    arm = quat.transform_back(mounting.q_vc, p_v) + mounting.camera_position + bench.lever_arm
    target = quat.transform_back(np.array(bench.q_HL), np.array(mounting.led_ring_position))
    return np.concatenate([target - quat.transform_back(q, arm), angles])
