"""Poses of a bench by several sets of parameters of its geometry, and the covariance of a pose by theirs."""

from __future__ import annotations

import math

from hil.bench.kinematics import pose_on_bench
from hil.core.jit import kernel
from hil.maths import quat, stack
from hil.sensors.mounting import camera_pose


@kernel
def poses_of_machines(machines, rail_m, gimbal_rad, r, q):
    """Write the chaser's poses ``r`` (m, n, 3), m, ``q`` (m, n, 4) of ``machines`` (m,) of BENCH_PARAMS.

    rail_m, gimbal_rad: (n, 3), encoders.
    """
    for k in range(machines.shape[0]):
        for n in range(rail_m.shape[0]):
            pose_on_bench(machines[k], rail_m[n], gimbal_rad[n], r[k, n], q[k, n])


@kernel
def camera_poses_of_machines(machines, mountings, rail_m, gimbal_rad, t_v, q_vt):
    """Write the poses of the LED ring in the camera, ``t_v`` (m, n, 3), m, ``q_vt`` (m, n, 4), likewise.

    mountings: (m,) of MOUNTING.
    """
    r, q = stack.vector(3), stack.vector(4)
    for k in range(machines.shape[0]):
        for n in range(rail_m.shape[0]):
            pose_on_bench(machines[k], rail_m[n], gimbal_rad[n], r, q)
            camera_pose(mountings[k], r, q, t_v[k, n], q_vt[k, n])


@kernel
def pose_sigmas(machines, steps, covariance, rail_m, gimbal_rad, slopes, out):
    """Write the standard deviations ``out`` (6,) of the pose at the encoders' values (3,): in H, m, and in c, rad.

    machines: of BENCH_PARAMS, the first one as it is, the others with one parameter each larger by its step. steps:
    (m,). covariance: (m, m) of the parameters. slopes: (6, m), overwritten.
    """
    r, q, r_0, q_0, turned = stack.vector(3), stack.vector(4), stack.vector(3), stack.vector(4), stack.vector(3)
    pose_on_bench(machines[0], rail_m, gimbal_rad, r_0, q_0)
    parameters = steps.shape[0]
    for k in range(parameters):
        pose_on_bench(machines[k + 1], rail_m, gimbal_rad, r, q)
        quat.rotation_between(q, q_0, turned)
        for i in range(3):
            slopes[i, k], slopes[3 + i, k] = (r[i] - r_0[i]) / steps[k], turned[i] / steps[k]
    for i in range(6):
        variance = 0.0
        for k in range(parameters):
            row = 0.0
            for j in range(parameters):
                row += covariance[k, j] * slopes[i, j]
            variance += slopes[i, k] * row
        out[i] = math.sqrt(max(0.0, variance))
