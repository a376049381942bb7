"""Parameters of the vision unit from user units to SI: noise and errors, cameras, mounting, LEDs that are dimmed."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.config.bench_geometry import errors_as_built, measured_errors
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.machine import parts_of
from hil.core.messages import Array, new
from hil.maths import quat
from hil.maths.elementary import square
from hil.models.faults import SEED_BITS
from hil.sensors.mounting import MOUNTING
from hil.sensors.vision_unit.camera import CAMERA
from hil.sensors.vision_unit.errors import VISION_ERRORS
from hil.sensors.vision_unit.model import VISION_PARAMS

LEAST_SNR: Final = 6.0
"""Of a spot's light over its noise, from which on the unit sees it."""


def model(scenario: Scenario, seed: int = 0) -> np.record:
    """Return VISION_PARAMS. seed: of the run, for errors."""
    params = new(VISION_PARAMS)
    params.sigma_position = scenario.vmu.sigma_position_m
    params.sigma_angle = math.radians(scenario.vmu.sigma_angle_deg)
    params.reference_range = scenario.vmu.reference_range_m
    params.reported_scale = scenario.vmu.reported_sigma_scale
    params.errors = _errors(scenario, seed)
    return params


def _errors(scenario: Scenario, seed: int) -> np.record:
    """Return VISION_ERRORS. seed: of the run."""
    given, params = scenario.vmu.errors, new(VISION_ERRORS)
    params.seed, params.needs_view = seed & SEED_BITS, given.needs_view
    params.bias, params.scale_error = given.bias_m, given.scale_error
    params.q_misaligned = quat.from_rotation_vector(-np.radians(given.misalignment_deg))  # it turns the frame
    params.correlated_fraction, params.correlation_s = given.correlated_fraction, given.correlation_time_s
    params.outlier_probability, params.outlier_size = given.outlier_probability, given.outlier_size_m
    params.misidentified_probability = given.misidentified_probability
    systematic = any(given.bias_m) or any(given.misalignment_deg) or given.scale_error != 0.0
    params.enabled = systematic or given.outlier_probability + given.misidentified_probability > 0.0
    return params


def mounting(rig: Rig) -> np.record:
    """Return MOUNTING: camera on the chaser, LED ring on the target, as far as they are known."""
    return mounting_of(rig, measured_errors(rig))


def mounting_as_built(rig: Rig, scenario: Scenario) -> np.record:
    """Return MOUNTING of mock and emulated rigs: ``mounting`` unless they have errors. scenario: of the truth."""
    return mounting_of(rig, errors_as_built(rig, scenario.bench.errors))


def mounting_of(rig: Rig, vector: Array | None) -> np.record:
    """Return MOUNTING of a machine with the parameters ``vector`` (PARAMETERS,), m and rad; None: an ideal one."""
    params = new(MOUNTING)
    params.camera_position = rig.bench.camera_position_m
    params.q_vc = quat.from_matrix(np.array(rig.bench.camera_axes))
    params.led_ring_position = rig.bench.led_ring_position_m
    params.q_th = quat.from_matrix(np.array(rig.bench.led_ring_axes))
    params.position_variance = square(rig.vmu.bench_sigma_m)
    params.attitude_variance = square(math.radians(rig.vmu.bench_sigma_deg))
    if vector is not None:
        of = parts_of(vector)
        params.camera_position, params.led_ring_position = (
            params.camera_position + of["camera_m"],
            params.led_ring_position + of["ring_m"],
        )
        params.q_vc = quat.multiply(params.q_vc, quat.from_rotation_vector(of["camera_deg"]))
        params.q_th = quat.multiply(params.q_th, quat.from_rotation_vector(of["ring_deg"]))
    return params


def camera(rig: Rig) -> tuple[np.record, Array]:
    """Return CAMERA, and the LEDs of the ring in t, (n, 3), m; without a vision unit its images have no pixels."""
    params = new(CAMERA)
    settings = rig.vmu.camera
    params.focal = settings.focal_px
    params.width, params.height = (settings.width_px, settings.height_px) if rig.has_vmu else (0.0, 0.0)
    params.baseline = settings.baseline_m
    return params, np.array(rig.vmu.leds_m, dtype=float)


def least_light(scenario: Scenario) -> float:
    """Return the least light of a visible LED, 1/m^2: that of an LED which is not dimmed, over its distance squared.

    The spot of a point of light, a Gaussian of known width s, has the flux F with the variance ``4 pi s^2 v + F / e``
    of read and background noise v per pixel and of shot noise, e electrons per level: the root of F = LEAST_SNR sigma.
    """
    images = scenario.vmu.images
    per_pixel = square(images.read_noise_levels) + images.background_levels / images.electrons_per_level
    dark, half = (
        4.0 * math.pi * square(images.psf_sigma_px) * per_pixel,
        0.5 * square(LEAST_SNR) / images.electrons_per_level,
    )
    return (half + math.sqrt(half * half + square(LEAST_SNR) * dark)) / images.led_flux_1m_levels
