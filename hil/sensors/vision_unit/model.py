"""Virtual VMU: the true camera pose with noise that increases with range, and with the errors of its error model.

``sigma(r) = sigma_0 * max(1, r / r_ref)`` for position and angle, r the distance of the reference points.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import entry, kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill, fill_matrix
from hil.sensors.mounting import camera_pose
from hil.sensors.vision_unit import errors as vmu_errors
from hil.sensors.vision_unit.camera import view_margin
from hil.sensors.vision_unit.errors import LEAST_LEDS, PLACES, VISION_ERRORS

VISION_NOISE = 6  # standard normals per frame: position in v, small rotation about v's axes
ALL_LEDS = 0x3F  # mask of the six LEDs of the ring

VISION_PARAMS = np.dtype(
    [
        ("sigma_position", "f8"),  # m
        ("sigma_angle", "f8"),  # rad
        ("reference_range", "f8"),  # m
        ("reported_scale", "f8"),  # reported over actual sigmas
        ("errors", VISION_ERRORS),
    ],
    align=True,
)


@kernel
def range_factor(params, r_CT_H):
    """Return max(1, r / r_ref)."""
    distance = math.sqrt(r_CT_H[0] ** 2 + r_CT_H[1] ** 2 + r_CT_H[2] ** 2)
    return max(1.0, distance / params.reference_range)


@kernel
def add_noise(params, r_CT_H, noise, t_v, q_vt, covariance):
    """Add the unit's noise to a pose t -> v, in place, and write the covariance that it reports.

    params: VISION_PARAMS. r_CT_H: (3,), m, of the chaser. noise: standard normals, (6,). t_v: (3,), m. q_vt: (4,).
    covariance: (6, 6), of t_v and of e in ``R_est = exp([e]x) R_true``.
    """
    factor = range_factor(params, r_CT_H)
    rotation, noise_q, q_true = stack.vector(3), stack.vector(4), stack.vector(4)
    fill_matrix(covariance, 0.0)
    for i in range(3):
        t_v[i] += params.sigma_position * factor * noise[i]
        # exp([e]x) rotates the vector, from_rotation_vector the frame: hence the minus
        rotation[i] = -params.sigma_angle * factor * noise[3 + i]
        covariance[i, i] = (params.reported_scale * params.sigma_position * factor) ** 2
        covariance[3 + i, 3 + i] = (params.reported_scale * params.sigma_angle * factor) ** 2
    copy_into(q_true, q_vt)
    quat.from_rotation_vector_into(rotation, noise_q)
    quat.multiply_into(noise_q, q_true, q_vt)


@kernel
def _look(camera, leds, t_v, q_vt, frame):
    """Write the LEDs in view of a camera at the true pose; return whether they are enough for a pose in both images."""
    left = vmu_errors.leds_in_view(camera, leds, 0.0, t_v, q_vt)
    right = vmu_errors.leds_in_view(camera, leds, camera.baseline, t_v, q_vt)
    if leds.shape[0] <= 62:
        frame.leds_left, frame.leds_right = left, right
    return vmu_errors.count_leds(left & right) >= min(LEAST_LEDS, leds.shape[0])


@entry
def measure_frame(params, camera, leds, mounting, r_CT_H, q_CH, noise, t_s, memory, frame):
    """Write pose, covariance and LEDs of ``frame`` (VMU_FRAME) of a chaser at ``r_CT_H`` with ``q_CH``.

    The pose has the noise and the errors of the unit; without one ``t_v`` is nan. params: VISION_PARAMS.
    camera: CAMERA. leds: (n, 3), m, in t. mounting: MOUNTING. noise: standard normals, (6,). t_s: of the exposure,
    bench time. memory: VISION_MEMORY.
    """
    errors = params.errors
    mixed = stack.vector(6)
    frame.leds_left = frame.leds_right = ALL_LEDS
    copy_into(mixed, noise)
    if errors.correlated_fraction > 0.0:
        vmu_errors.correlate(errors, memory, t_s, noise, mixed)
    camera_pose(mounting, r_CT_H, q_CH, frame.t_v, frame.q_vt)
    memory.view_margin = view_margin(camera, leds, frame.t_v, frame.q_vt)
    has_pose = True
    if errors.needs_view != 0 and (memory.view_margin < 0.0 or leds.shape[0] != PLACES):
        has_pose = _look(camera, leds, frame.t_v, frame.q_vt, frame)
    add_noise(params, r_CT_H, mixed, frame.t_v, frame.q_vt, frame.covariance)
    if errors.enabled != 0:
        vmu_errors.distort(errors, memory.exposures, frame.t_v, frame.q_vt)
    if not has_pose:
        fill(frame.t_v, math.nan)
    memory.exposures += 1
    memory.t_s = t_s
