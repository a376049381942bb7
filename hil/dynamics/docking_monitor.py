"""Virtual docking monitor: the true pose of its camera relative to the docking target, with noise by range.

A statistical model of the measurements that the docking monitor makes from its images
(``docs/explanation/docking-monitor.md``): range, line of sight and attitude, each with its standard deviation. Far from
the target, pitch and yaw are not observable; outside the image and outside the ranges at which the target can be
measured there is no measurement.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.maths.arrays import copy_into, fill_matrix
from hil.models.camera_timing import TIME_SLACK_S, exposure_time
from hil.models.mounting import MOUNTING, camera_pose

MONITOR_NOISE = 7  # standard normals per measurement: range, line of sight in three axes, rotation about v's axes
UNOBSERVED_RAD = 1.0
"""Standard deviation of an angle that is not observed."""

MONITOR_MODEL = np.dtype(
    [
        ("rate_hz", "f8"),  # of the measurements
        ("latency_s", "f8"),
        ("mounting", MOUNTING),  # of the television camera and the docking target
        ("reference_range", "f8"),  # m, from the camera to the target's disc, as all ranges here
        ("sigma_range", "f8"),  # fraction of the range; proportional to range beyond the reference, as the following
        ("sigma_sight", "f8"),  # rad, of the line of sight
        ("sigma_angle", "f8"),  # rad, of the attitude
        ("range_min", "f8"),  # m
        ("range_near", "f8"),  # m, up to which pitch and yaw are observed
        ("range_max", "f8"),  # m
        ("field", "f8", 2),  # tangents of the half angles of the image, right and up
    ],
    align=True,
)


@kernel
def is_due(model, number, t_s):
    """Return whether measurement ``number`` is due at ``t_s`` of the run."""
    return exposure_time(number, model.rate_hz) <= t_s + TIME_SLACK_S


@kernel
def measure_target(model, r_CT_H, q_CH, noise, t_v, q_vt, covariance):
    """Write the pose of the docking target in the camera and its covariance; return False if it is not seen.

    model: MONITOR_MODEL. noise: standard normals, (MONITOR_NOISE,). t_v: (3,), m, from the camera to the disc's centre,
    in the camera's axes. q_vt: (4,). covariance: (6, 6), of t_v and of e in ``R_est = exp([e]x) R_true``.
    """
    camera_pose(model.mounting, r_CT_H, q_CH, t_v, q_vt)
    distance = math.sqrt(t_v[0] ** 2 + t_v[1] ** 2 + t_v[2] ** 2)
    ahead = t_v[2]
    if not model.range_min <= distance <= model.range_max or ahead <= 0.0:
        return False
    if abs(t_v[0]) > model.field[0] * ahead or abs(t_v[1]) > model.field[1] * ahead:
        return False
    factor = max(1.0, distance / model.reference_range)
    of_range, across = factor * model.sigma_range * distance, factor * model.sigma_sight * distance
    angle = factor * model.sigma_angle
    sight, rotation, turn, before = stack.vector(3), stack.vector(3), stack.vector(4), stack.vector(4)
    along = 0.0
    for i in range(3):
        sight[i] = t_v[i] / distance
        along += sight[i] * noise[1 + i]
    is_near = distance <= model.range_near
    fill_matrix(covariance, 0.0)
    for i in range(3):
        t_v[i] += of_range * noise[0] * sight[i] + across * (noise[1 + i] - along * sight[i])
        covariance[i, i] = across**2
        for j in range(3):
            covariance[i, j] += (of_range**2 - across**2) * sight[i] * sight[j]
        # exp([e]x) rotates the vector, from_rotation_vector the frame: hence the minus
        rotation[i] = -angle * noise[4 + i]
        is_observed = is_near or i == 2
        covariance[3 + i, 3 + i] = angle**2 if is_observed else UNOBSERVED_RAD**2
    copy_into(before, q_vt)
    quat.from_rotation_vector_into(rotation, turn)
    quat.multiply_into(turn, before, q_vt)
    return True
