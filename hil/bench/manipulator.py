"""Axes that move the target during a run: the relative pose, divided between them and the chaser's rig.

A rotary manipulator rotates the target, the frame H with it, against the lab: its angles give ``q_HL``. Rails carry it
along the axes of the lab. The chaser's rig shows the pose of the chaser in L, which ``shown_motion`` gives exactly for
any position of the target's axes. What these get is therefore free. ``wanted_angles`` gives a rotary manipulator the
whole relative rotation, so that the turntable stands still, and a chaser that coasts near a target that tumbles stands
still in the lab. ``wanted_axes`` gives the target's rails a path of their own, or the part of each relative position by
which both vehicles have the same fraction of their travel left. What their limits do not allow is left to the chaser's
rig. docs/explanation/moving-targets.md
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.bench.kinematics import axes_of_pose, pose_of_axes
from hil.core.messages import AXES, Array, new
from hil.maths import elementary, euler, linear, quat

PATH_MAX: Final = 64
"""Points of a path of the target."""

MANIPULATOR = np.dtype(
    [
        ("order", "i8", 3),  # gimbals outer to inner, 0 roll, 1 pitch, 2 yaw
        ("arm", "f8", 3),  # m, in H, from the centre of rotation to the target's reference point
        ("rails", "i8"),  # 1: rails carry the target, 0: gimbals rotate it
        ("to_H", "f8", (3, 3)),  # from the lab, along whose axes the rails run
        ("fraction", "f8", 3),  # part of a relative position that each rail of the target shows
        ("offset", "f8", 3),  # m, its position where the rail of the chaser would be at 0
        ("points", "i8"),  # of a path; 0: the relative position is shared
        ("path_s", "f8", PATH_MAX),
        ("path_m", "f8", (PATH_MAX, 3)),
    ],
    align=True,
)

_SINGULAR = 0.05  # cosine of the middle angle below which the wanted rates are left to the limits of the axes
_REST = np.zeros(3)
_UNITS = np.eye(3)


class ChaserMotion(NamedTuple):
    """Pose and motion of the chaser, in H or in L: r (3,), m, v (3,), m/s, q (4,), and its rate w (3,), rad/s, in c.

    t_s: time of the run.
    """

    r: Array
    v: Array
    q: Array
    w: Array
    t_s: float = 0.0


def angle_rate(params: np.record, angles: Array, rates: Array) -> Array:
    """Return the rate (3,), rad/s, of H against L, in H, at the manipulator's angles, rad, and their rates, rad/s."""
    outer, middle, inner = params.order
    about_outer = quat.transform(euler.to_quaternion(angles, params.order), _UNITS[outer])
    about_middle = quat.transform(euler.axis_quaternion(inner, angles[inner]), _UNITS[middle])
    rate: Array = rates[outer] * about_outer + rates[middle] * about_middle + rates[inner] * _UNITS[inner]
    return rate


def shown_motion(params: np.record, angles: Array, rates: Array, relative: ChaserMotion) -> ChaserMotion:
    """Return the motion of the chaser in L for that relative to the target, at positions and rates of its axes.

    angles: (3,), rad, or positions of its rails, m; rates: likewise per second. L has its origin where the target's
    reference point is with its axes at zero.
    """
    if params.rails:
        r, v = (linear.product(params.to_H, each) for each in (angles, rates))
        return relative._replace(r=relative.r + r, v=relative.v + v)
    q_hl, w_HL_H = euler.to_quaternion(angles, params.order), angle_rate(params, angles, rates)
    arm = relative.r + params.arm
    return ChaserMotion(
        quat.transform_back(q_hl, arm) - params.arm,
        quat.transform_back(q_hl, relative.v + np.cross(w_HL_H, arm)),
        quat.multiply(relative.q, q_hl),
        relative.w + quat.transform(relative.q, w_HL_H),
        relative.t_s,
    )


def relative_pose(params: np.record, angles: Array, r_L: Array, q_CL: Array) -> tuple[Array, Array]:
    """Return the chaser's pose relative to the target, (3,), m, and (4,), for its pose in L: as in ``shown_motion``."""
    if params.rails:
        return r_L - linear.product(params.to_H, angles), q_CL
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


def wanted_axes(params: np.record, bench: np.record, relative: ChaserMotion, near: Array) -> tuple[Array, Array]:
    """Return positions (3,), m or rad, and rates of the target's axes for a relative motion, without their limits.

    bench: BENCH_PARAMS of the chaser's rig. near: angles of a rotary manipulator, as in ``wanted_angles``.
    """
    if not params.rails:
        return wanted_angles(params, relative.q, relative.w, near)
    if params.points:
        return _on_path(params, relative.t_s)
    axes = _axes_of(bench, relative)
    return params.offset - params.fraction * axes.rail_m, -params.fraction * axes.rail_mps


def _on_path(params: np.record, t_s: float) -> tuple[Array, Array]:
    """Return position (3,), m, and velocity on the path at ``t_s``: it begins and ends at rest."""
    n = int(params.points)
    times, points = params.path_s[:n], params.path_m[:n]
    after = int(np.searchsorted(times, t_s, "right"))
    if after in (0, n):
        return points[min(after, n - 1)].copy(), np.zeros(3)
    rate: Array = (points[after] - points[after - 1]) / (times[after] - times[after - 1])
    return points[after - 1] + rate * (t_s - times[after - 1]), rate


def _axes_of(bench: np.record, motion: ChaserMotion) -> np.record:
    """Return AXES for a motion; axes that are fixed count as driven, since those of this pose need not exist."""
    if bench.reduced:
        bench = bench.copy()
        bench.fixed = 0
    axes: np.record = new(AXES)
    axes_of_pose(bench, motion.r, motion.v, motion.q, motion.w, axes)
    return axes


def start_axes(params: np.record, bench: np.record, limits: np.record, r_CT_H: Array, q_CH: Array) -> Array:
    """Return the positions (3,), m or rad, of the target's axes for a chaser at rest at a pose, within their travel.

    params: MANIPULATOR. bench: BENCH_PARAMS of the chaser's rig. limits: BENCH_PARAMS with the limits of these axes.
    """
    wanted, _ = wanted_axes(params, bench, ChaserMotion(r_CT_H, _REST, q_CH, _REST), _REST)
    at = places(params)
    within: Array = np.clip(wanted, limits.low[at], limits.high[at])
    return within


def places(params: np.record) -> slice:
    """Return which of six axes, as in BENCH_PARAMS, those of the target have. params: MANIPULATOR."""
    return slice(0, 3) if params.rails else slice(3, 6)


def relative_axes(
    bench: np.record, params: np.record | None, rail_m: Array, gimbal_rad: Array, target_at: Array
) -> tuple[Array, Array]:
    """Return rails, m, and gimbals, rad, (3,) each, that would show the same to a target whose axes are at zero.

    What compares positions of rails and turntable with the relative pose, or sees it from them, takes these. Without
    axes that move the target in a run, ``params`` None, they are those given. bench: BENCH_PARAMS. params: MANIPULATOR.
    """
    if params is None:
        return rail_m, gimbal_rad
    r, q = np.empty(3), np.empty(4)
    pose_of_axes(bench, rail_m, gimbal_rad, r, q)
    r, q = relative_pose(params, target_at, r, q)
    axes = _axes_of(bench, ChaserMotion(r, _REST, q, _REST))
    return axes.rail_m.copy(), axes.gimbal_rad.copy()
