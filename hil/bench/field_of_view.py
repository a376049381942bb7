"""What the cameras of the bench have in view while its axes move."""

from __future__ import annotations

import math

import numpy as np

from hil.bench.kinematics import pose_of_axes, pose_on_bench
from hil.core.jit import kernel
from hil.maths import elementary, quat
from hil.sensors.mounting import camera_pose
from hil.sensors.vision_unit.camera import view_margin


@kernel
def view_margins(params, mounting, camera, leds, rail_m, gimbal_rad, out):
    """Write for each row of ``rail_m`` and ``gimbal_rad`` (n, 3) the least distance of an LED from an image's edge, px.

    params: BENCH_PARAMS. mounting: MOUNTING. camera: CAMERA. leds: (m, 3), m, in t. out: (n,).
    """
    r, q = np.empty(3), np.empty(4)
    t_v, q_vt = np.empty(3), np.empty(4)
    for k in range(out.shape[0]):
        pose_on_bench(params, rail_m[k], gimbal_rad[k], r, q)
        camera_pose(mounting, r, q, t_v, q_vt)
        out[k] = view_margin(camera, leds, t_v, q_vt)


@kernel
def camera_errors(params, mounting, rail_m, gimbal_rad, r_CT_H, q_CH, distance, angle):
    """Write how far, m, and by which angle, rad, the left camera is from where the chaser's pose has it, (n,) each.

    params: BENCH_PARAMS. mounting: MOUNTING. rail_m, gimbal_rad: (n, 3), where the axes are. r_CT_H
    (n, 3), m, q_CH (n, 4): the pose that they were to show.
    """
    r, q = np.empty(3), np.empty(4)
    for k in range(distance.shape[0]):
        pose_of_axes(params, rail_m[k], gimbal_rad[k], r, q)
        here = quat.transform_back(q, mounting.camera_position)
        there = quat.transform_back(q_CH[k], mounting.camera_position)
        square = 0.0
        for i in range(3):
            square += (r[i] + here[i] - r_CT_H[k, i] - there[i]) ** 2
        distance[k] = math.sqrt(square)
        turn = quat.multiply(q, quat.conjugate(q_CH[k]))
        sine = math.sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2)
        angle[k] = 2.0 * elementary.atan2(sine, abs(turn[3]))
