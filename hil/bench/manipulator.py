"""Rotary manipulator of the target: the relative pose, divided between its three axes and the chaser's rig.

The manipulator rotates the target, the frame H with it, against the lab: its angles give ``q_HL``. The chaser's rig
shows the pose of the chaser in L, which ``shown_motion`` gives exactly for any angles of the manipulator. What the
manipulator gets is therefore free: ``wanted_angles`` gives it the whole relative rotation, so that the turntable stands
still, and a chaser that coasts near a target that tumbles stands still in the lab. What its limits do not allow is
left to the chaser's rig. docs/explanation/moving-targets.md
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hil.bench.kinematics import axes_of_pose, pose_of_axes
from hil.core.messages import AXES, Array, new
from hil.maths import elementary, euler, linear, quat

MANIPULATOR = np.dtype(
    [
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("arm", "f8", 3),  # m, in H, from the centre of rotation to the target's reference point
    ],
    align=True,
)

_SINGULAR = 0.05  # cosine of the middle angle below which the wanted rates are left to the limits of the axes
_REST = np.zeros(3)
_UNITS = np.eye(3)


class ChaserMotion(NamedTuple):
    """Pose and motion of the chaser, in H or in L: r (3,), m, v (3,), m/s, q (4,), and its rate w (3,), rad/s, in c."""

    r: Array
    v: Array
    q: Array
    w: Array


def angle_rate(params: np.record, angles: Array, rates: Array) -> Array:
    """Return the rate (3,), rad/s, of H against L, in H, at the manipulator's angles, rad, and their rates, rad/s."""
    outer, middle, inner = params.order
    about_outer = quat.transform(euler.to_quaternion(angles, params.order), _UNITS[outer])
    about_middle = quat.transform(euler.axis_quaternion(inner, angles[inner]), _UNITS[middle])
    rate: Array = rates[outer] * about_outer + rates[middle] * about_middle + rates[inner] * _UNITS[inner]
    return rate


def shown_motion(params: np.record, angles: Array, rates: Array, relative: ChaserMotion) -> ChaserMotion:
    """Return the motion of the chaser in L for that relative to the target, at angles, rad, and their rates, rad/s.

    L has its origin where the target's reference point is at angles of zero.
    """
    q_hl, w_HL_H = euler.to_quaternion(angles, params.order), angle_rate(params, angles, rates)
    arm = relative.r + params.arm
    return ChaserMotion(
        quat.transform_back(q_hl, arm) - params.arm,
        quat.transform_back(q_hl, relative.v + np.cross(w_HL_H, arm)),
        quat.multiply(relative.q, q_hl),
        relative.w + quat.transform(relative.q, w_HL_H),
    )


def relative_pose(params: np.record, angles: Array, r_L: Array, q_CL: Array) -> tuple[Array, Array]:
    """Return the chaser's pose relative to the target, (3,), m, and (4,), for its pose in L: as in ``shown_motion``."""
    q_hl = euler.to_quaternion(angles, params.order)
    return quat.transform(q_hl, r_L + params.arm) - params.arm, quat.multiply(q_CL, quat.conjugate(q_hl))


def wanted_angles(params: np.record, q_CH: Array, w_CH_C: Array, near: Array) -> tuple[Array, Array]:
    """Return the angles (3,), rad, nearest to ``near``, and rates (3,), rad/s, that show the whole relative rotation.

    Near +-90 deg of the middle angle, where outer and inner axis are the same, the rates are zero: the limits of the
    axes decide.
    """
    q_hc = quat.conjugate(q_CH)
    angles: Array = euler.from_quaternion(q_hc, params.order)
    rates = np.zeros(3)
    if abs(elementary.cos(angles[params.order[1]])) >= _SINGULAR:
        rates = -linear.product(euler.rate_jacobian(angles, params.order), quat.transform(q_hc, w_CH_C))
    return angles + 2.0 * math.pi * np.round((near - angles) / (2.0 * math.pi)), rates


def start_angles(params: np.record, limits: np.record, q_CH: Array) -> Array:
    """Return the angles (3,), rad, for a chaser at rest with ``q_CH``: the whole relative rotation, within the travel.

    params: MANIPULATOR. limits: BENCH_PARAMS with the limits of the gimbals.
    """
    angles, _ = wanted_angles(params, q_CH, _REST, _REST)
    within: Array = np.clip(angles, limits.low[3:], limits.high[3:])
    return within


def relative_axes(
    bench: np.record, params: np.record | None, rail_m: Array, gimbal_rad: Array, target_rad: Array
) -> tuple[Array, Array]:
    """Return rails, m, and gimbals, rad, (3,) each, that would show the same to a target at angles of zero.

    What compares positions of rails and turntable with the relative pose, or sees it from them, takes these. Without a
    manipulator, ``params`` None, they are those given. bench: BENCH_PARAMS. params: MANIPULATOR.
    """
    if params is None:
        return rail_m, gimbal_rad
    r, q, axes = np.empty(3), np.empty(4), new(AXES)
    pose_of_axes(bench, rail_m, gimbal_rad, r, q)
    r, q = relative_pose(params, target_rad, r, q)
    if bench.reduced:  # the axes of this pose need not exist
        bench = bench.copy()
        bench.fixed = 0
    axes_of_pose(bench, r, _REST, q, _REST, axes)
    return axes.rail_m.copy(), axes.gimbal_rad.copy()
