"""Simulated observations of a known target by known cameras, for tests and studies of the calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hil.core.messages import Array
from hil.maths import euler, quat
from hil.vmu.calibration.model import Observations, Setup, TurntableModel, project_view
from hil.vmu.kernels.chain import CAMERA_POSITION, TARGET_POSITION


def plan(
    setup: Setup,
    turntable: TurntableModel,
    count: int,
    range_m: tuple[float, float],
    turn_deg: float,
    generator: np.random.Generator,
    spread: float = 0.3,
) -> Array:
    """Return axis positions of the bench, (count, 6), that distribute the target over the images.

    range_m: from camera to target, log-uniform. turn_deg: largest angle of each gimbal.
    spread: largest distance of the target from the optical axis, as the tangent of the angle.
    """
    arm = turntable.lever_arm + setup.theta[CAMERA_POSITION : CAMERA_POSITION + 3]
    axes = np.empty((count, 6))
    for row in axes:
        row[3:] = np.radians(generator.uniform(-turn_deg, turn_deg, 3))
        z = np.exp(generator.uniform(*np.log(range_m)))
        p_v = z * np.array([*generator.uniform(-spread, spread, 2), 1.0])
        a_ch = quat.to_matrix(euler.to_quaternion(row[3:], turntable.order))
        row[:3] = setup.theta[TARGET_POSITION : TARGET_POSITION + 3] - a_ch.T @ (setup.camera_axes.T @ p_v + arm)
    return axes


def observe(
    setup: Setup,
    turntable: TurntableModel,
    axes: Array,
    axis_sigma: Array,
    pixel_sigma: float,
    generator: np.random.Generator,
    margin_px: float = 3.0,
) -> Observations:
    """Return the observations with the axes at ``axes`` (n, 6) and encoder errors of sigma ``axis_sigma`` (6,)."""
    encoders = axes + generator.standard_normal(axes.shape) * axis_sigma
    pixels = np.array([project_view(setup, turntable, row).pixels for row in axes])
    pixels += generator.standard_normal(pixels.shape) * pixel_sigma
    size = setup.sizes[None, :, None, :]
    outside = ~((pixels > margin_px) & (pixels < size - margin_px)).all(axis=-1)
    pixels[outside] = np.nan
    covariance = np.broadcast_to(pixel_sigma**2 * np.eye(2), (*pixels.shape, 2)).copy()
    return Observations(tuple(f"{k:04d}" for k in range(len(axes))), encoders, pixels, covariance)


def shifted(setup: Setup, **changes: float | Array) -> Setup:
    """Return ``setup`` with changes to theta: ``shifted(setup, CAMERA_ROTATION=[0, 1e-3, 0])``."""
    from hil.vmu.kernels import chain

    theta = setup.theta.copy()
    for name, change in changes.items():
        first = getattr(chain, name)
        theta[first : first + np.size(change)] += change
    return replace(setup, theta=theta).folded()
