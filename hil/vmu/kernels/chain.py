"""Projection of a target in the lab into both cameras on the turntable, from the bench's axes, with derivatives.

    p_L = exp([e_t]x) B0 (s p_t) + target_position         target to lab; B0 is A(q_th).T initially
    p_v = exp([e_c]x) A0 (A(gimbals) (p_L - rails) - lever_arm - camera_position)
    p_r = exp([r]x).T (p_v - baseline)

Equivalent to ``hil.bench.kinematics.pose_of_axes`` followed by ``hil.sensors.mounting.camera_pose``.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import euler, quat
from hil.vmu.kernels.lens import LENS, distort, lens_slopes, project_slopes

# indices of the shared unknowns in a vector of COMMON
LEFT: Final = 0  # fx fy cx cy k1 k2 p1 p2 k3
RIGHT: Final = 9
ROTATION: Final = 18  # rotation vector of the right camera's axes in the left one's
BASELINE: Final = 21
CAMERA_ROTATION: Final = 24
CAMERA_POSITION: Final = 27
TARGET_ROTATION: Final = 30
TARGET_POSITION: Final = 33
SCALE: Final = 36
COMMON: Final = 37


@kernel
def rotation_matrix(e):
    """Return exp([e]x), (3, 3)."""
    return quat.to_matrix(quat.from_rotation_vector(-e))


@kernel
def left_jacobian(e):
    """Return J (3, 3) with exp([e + d]x) = exp([J d]x) exp([e]x) to first order (left Jacobian of SO(3))."""
    angle2 = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]
    if angle2 < 1e-8:
        a, b = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = math.sqrt(angle2)
        a, b = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    j = np.empty((3, 3))
    for m in range(3):
        for n in range(3):
            j[m, n] = b * e[m] * e[n]
        j[m, m] += 1.0 - b * angle2
    j[0, 1] -= a * e[2]
    j[0, 2] += a * e[1]
    j[1, 0] += a * e[2]
    j[1, 2] -= a * e[0]
    j[2, 0] -= a * e[1]
    j[2, 1] += a * e[0]
    return j


@kernel
def gimbal_axes(angles, order):
    """Return the three gimbal axes in the innermost frame, (3, 3): row m is the axis of angle m."""
    axes = np.zeros((3, 3))
    middle = euler.axis_quaternion(order[1], angles[order[1]])
    inner = euler.axis_quaternion(order[2], angles[order[2]])
    unit = np.zeros(3)
    unit[order[0]] = 1.0
    outer_axis = quat.transform(inner, quat.transform(middle, unit))
    unit[order[0]] = 0.0
    unit[order[1]] = 1.0
    middle_axis = quat.transform(inner, unit)
    for m in range(3):
        axes[order[0], m] = outer_axis[m]
        axes[order[1], m] = middle_axis[m]
    axes[order[2], order[2]] = 1.0
    return axes


@kernel
def _times(a, v):
    out = np.empty(3)
    for m in range(3):
        out[m] = a[m, 0] * v[0] + a[m, 1] * v[1] + a[m, 2] * v[2]
    return out


@kernel
def _product(a, b):
    out = np.empty((3, 3))
    for m in range(3):
        for n in range(3):
            out[m, n] = a[m, 0] * b[0, n] + a[m, 1] * b[1, n] + a[m, 2] * b[2, n]
    return out


@kernel
def _minus_cross(v):
    """Return -[v]x, (3, 3): the derivative of exp([e]x) v at e = 0."""
    out = np.zeros((3, 3))
    out[0, 1] = v[2]
    out[0, 2] = -v[1]
    out[1, 0] = -v[2]
    out[1, 2] = v[0]
    out[2, 0] = v[1]
    out[2, 1] = -v[0]
    return out


@kernel
def fill_lens(lens, theta, first):
    """Write the nine numbers of ``theta`` from ``first`` on to ``lens`` (a record of LENS)."""
    lens.fx = theta[first]
    lens.fy = theta[first + 1]
    lens.cx = theta[first + 2]
    lens.cy = theta[first + 3]
    lens.k1 = theta[first + 4]
    lens.k2 = theta[first + 5]
    lens.p1 = theta[first + 6]
    lens.p2 = theta[first + 7]
    lens.k3 = theta[first + 8]


@kernel
def _add(out, slope, a, first):
    """Write slope (2, 3) times ``a`` (3, n) to the columns of ``out`` (2, N) from ``first`` on."""
    for m in range(2):
        for n in range(a.shape[1]):
            out[m, first + n] = slope[m, 0] * a[0, n] + slope[m, 1] * a[1, n] + slope[m, 2] * a[2, n]


@kernel
def project_target(
    theta, camera_axes, target_axes, lever_arm, order, axes, points, pixels, by_common, by_point, by_axes
):
    """Write the pixels of all points in both cameras for one view, and their derivatives.

    theta: (COMMON,). camera_axes, target_axes: (3, 3), A0 and B0. lever_arm: (3,), m. order: (3,), gimbals
    outer to inner. axes: (6,), rails, m, and gimbals, rad. points: (m, 3), m, in t.
    Out: pixels (2, m, 2); by_common (2, m, 2, COMMON); by_point (2, m, 2, 3), px/m; by_axes (2, m, 2, 6).
    Pixels of a point that is not in front of a camera are NaN, and their derivatives zero.
    """
    lens = np.zeros(2, LENS)
    fill_lens(lens[0], theta, LEFT)
    fill_lens(lens[1], theta, RIGHT)
    e_c, e_t, r = (
        theta[CAMERA_ROTATION:CAMERA_POSITION],
        theta[TARGET_ROTATION:TARGET_POSITION],
        theta[ROTATION:BASELINE],
    )
    a_vc = _product(rotation_matrix(e_c), camera_axes)
    b_lt = _product(rotation_matrix(e_t), target_axes)
    a_rv = rotation_matrix(-r)
    a_ch = quat.to_matrix(euler.to_quaternion(axes[3:6], order))
    a_vl = _product(a_vc, a_ch)
    gimbals = gimbal_axes(axes[3:6], order)
    j_c, j_t, j_r = left_jacobian(e_c), left_jacobian(e_t), left_jacobian(-r)
    slope = np.empty((2, 3))
    inner = np.empty((2, 9))
    scaled = np.empty(3)
    from_target = np.empty(3)
    p_c = np.empty(3)
    by_gimbal = np.empty((3, 3))
    scale_slope = np.empty((3, 1))
    for k in range(points.shape[0]):
        for m in range(3):
            scaled[m] = theta[SCALE] * points[k, m]
        turned = _times(b_lt, scaled)
        for m in range(3):
            from_target[m] = turned[m] + theta[TARGET_POSITION + m] - axes[m]
        p_rc = _times(a_ch, from_target)
        for m in range(3):
            p_c[m] = p_rc[m] - lever_arm[m] - theta[CAMERA_POSITION + m]
        p_v = _times(a_vc, p_c)
        # derivatives of p_v
        by_camera_turn = _product(_minus_cross(p_v), j_c)
        by_target_turn = _product(a_vl, _product(_minus_cross(turned), j_t))
        point_slope = _product(a_vl, b_lt)
        one = _times(point_slope, points[k])
        for m in range(3):
            scale_slope[m, 0] = one[m]
        for m in range(3):
            by_gimbal[0, m] = p_rc[1] * gimbals[m, 2] - p_rc[2] * gimbals[m, 1]
            by_gimbal[1, m] = p_rc[2] * gimbals[m, 0] - p_rc[0] * gimbals[m, 2]
            by_gimbal[2, m] = p_rc[0] * gimbals[m, 1] - p_rc[1] * gimbals[m, 0]
        gimbal_slope = _product(a_vc, by_gimbal)
        for camera in range(2):
            p = p_v
            if camera == 1:
                shifted = np.empty(3)
                for m in range(3):
                    shifted[m] = p_v[m] - theta[BASELINE + m]
                p = _times(a_rv, shifted)
            common = by_common[camera, k]
            for m in range(2):
                for n in range(COMMON):
                    common[m, n] = 0.0
                for n in range(3):
                    by_point[camera, k, m, n] = 0.0
                for n in range(6):
                    by_axes[camera, k, m, n] = 0.0
            if not p[2] > 0.0:
                pixels[camera, k, 0] = np.nan
                pixels[camera, k, 1] = np.nan
                continue
            x, y = p[0] / p[2], p[1] / p[2]
            xd, yd = distort(lens[camera], x, y)
            pixels[camera, k, 0] = lens[camera].fx * xd + lens[camera].cx
            pixels[camera, k, 1] = lens[camera].fy * yd + lens[camera].cy
            lens_slopes(lens[camera], x, y, inner)
            for m in range(2):
                for n in range(9):
                    common[m, LEFT + 9 * camera + n] = inner[m, n]
            project_slopes(lens[camera], p[0], p[1], p[2], slope)
            if camera == 1:
                # exp([-r]x) changes by -J(-r) dr
                turn = _product(_minus_cross(p), j_r)
                for m in range(3):
                    for n in range(3):
                        turn[m, n] = -turn[m, n]
                _add(common, slope, turn, ROTATION)
                _add(common, slope, -a_rv, BASELINE)
                through = np.empty((2, 3))
                _add(through, slope, a_rv, 0)
                for m in range(2):
                    for n in range(3):
                        slope[m, n] = through[m, n]
            _add(common, slope, by_camera_turn, CAMERA_ROTATION)
            _add(common, slope, -a_vc, CAMERA_POSITION)
            _add(common, slope, by_target_turn, TARGET_ROTATION)
            _add(common, slope, a_vl, TARGET_POSITION)
            _add(common, slope, scale_slope, SCALE)
            _add(by_point[camera, k], slope, theta[SCALE] * point_slope, 0)
            _add(by_axes[camera, k], slope, -a_vl, 0)
            _add(by_axes[camera, k], slope, gimbal_slope, 3)
