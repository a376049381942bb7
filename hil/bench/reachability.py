"""Demands of a plan with its dispersion on the six axes and on the view of the cameras.

Axes are numbered as in BENCH_PARAMS: rails x y z in m, gimbals roll pitch yaw in rad.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from hil.bench.field_of_view import view_margins
from hil.bench.kinematics import axes_of_pose
from hil.core.messages import AXES, Array, new
from hil.maths import linear, quat
from hil.maths.elementary import square

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_AT_REST = np.zeros(3)


@dataclass(frozen=True, slots=True)
class ControlBounds:
    """Bounds of the motion that control may add to the plan, each (3,), in c: m/s, rad/s, m/s^2, rad/s^2.

    swing_mps, swing_mps2: (n,), of the rails in addition, at each of the n times, where the target is rotated and a
    rotation of the chaser is a motion about the target.
    """

    speed: Array
    rate: Array
    acceleration: Array
    slewing: Array
    swing_mps: Array = field(default_factory=lambda: np.zeros(1))
    swing_mps2: Array = field(default_factory=lambda: np.zeros(1))


@dataclass(frozen=True, slots=True)
class Attitude:
    """The bench at one attitude and at the corners of its band, the chaser's reference point in the origin of L.

    planned: (6,). corners: (8, 6), m and rad. turned: (6, 3), axis rates by body rate. a_CH: (3, 3).
    """

    planned: Array
    corners: Array
    turned: Array
    a_CH: Array


@dataclass(frozen=True, slots=True)
class Envelope:
    """Demands on each axis at each of n times, (n, 6): position, its band with the braking distance, and largest speed
    and acceleration."""

    planned: Array
    low: Array
    high: Array
    planned_rate: Array
    rate: Array
    acceleration: Array


def attitude(params: np.record, turn: Array, band_rad: float) -> Attitude:
    """Return the bench at the rotation vector ``turn`` (3,), rad, and ``band_rad`` about each body axis of it."""
    q = quat.from_rotation_vector(turn)
    corners = [
        _axes(params, quat.multiply(quat.from_rotation_vector(band_rad * corner), q), _AT_REST)[0]
        for corner in _CORNERS
    ]
    turned = np.column_stack([_axes(params, q, unit)[1] for unit in np.eye(3)])
    return Attitude(_axes(params, q, _AT_REST)[0], np.array(corners), turned, quat.to_matrix(q))


def rails_of(params: np.record) -> Array:
    """Return the matrix (3, 3) that takes a displacement in H to that of the rails; params: BENCH_PARAMS."""
    along = quat.to_matrix(quat.conjugate(params.q_HL)) if params.reduced else np.eye(3)
    moved: Array = along * (params.fixed[:3, None] == 0)
    return moved


def _axes(params: np.record, q_CH: Array, w_CH_C: Array) -> tuple[Array, Array]:
    """Return positions and rates, (6,) each, of the axes for a chaser in the origin."""
    axes = new(AXES)
    axes_of_pose(params, _AT_REST, _AT_REST, q_CH, w_CH_C, axes)
    return np.concatenate([axes.rail_m, axes.gimbal_rad]), np.concatenate([axes.rail_mps, axes.gimbal_radps])


def envelope(
    params: np.record,
    attitudes: list[Attitude],
    r_CT_H: Array,
    v_CT_H: Array,
    margin_m: Array,
    control: ControlBounds,
) -> Envelope:
    """Return the demands on the axes.

    attitudes: n of them. r_CT_H, v_CT_H: (n, 3), m, m/s. margin_m: (n, 3), half the band of positions.
    control: motion that may come on top of the plan.
    """
    n, to_rails = len(attitudes), rails_of(params)
    moves = (params.fixed[:3] == 0).astype(float)
    at = np.hstack([linear.product(r_CT_H, to_rails.T), np.zeros((n, 3))])
    half = np.hstack([linear.product(margin_m, np.abs(to_rails).T), np.zeros((n, 3))])
    corners = np.array([a.corners for a in attitudes])
    turned = np.abs([a.turned for a in attitudes])
    to_l = np.abs([linear.product(to_rails, a.a_CH.T) for a in attitudes])
    own_rate = linear.product(turned, control.rate)
    planned_rate = np.hstack([np.abs(linear.product(v_CT_H, to_rails.T)), np.zeros((n, 3))])
    fastest = planned_rate + own_rate
    fastest[:, :3] += linear.product(to_l, control.speed) + control.swing_mps[:, None] * moves
    hardest = linear.product(turned, control.slewing)
    centripetal = linear.length(params.lever_arm) * float(linear.product(control.rate, control.rate))
    hardest[:, :3] += linear.product(to_l, control.acceleration) + (centripetal + control.swing_mps2[:, None]) * moves
    hardest[:, 3:] += square(own_rate[:, 3:])
    room = square(fastest) / (2.0 * params.acceleration_max)
    return Envelope(
        planned=at + [a.planned for a in attitudes],
        low=at + corners.min(axis=1) - half - room,
        high=at + corners.max(axis=1) + half + room,
        planned_rate=planned_rate,
        rate=fastest,
        acceleration=hardest,
    )


def view(
    params: np.record,
    mounting: np.record,
    camera: np.record,
    leds: Array,
    attitudes: list[Attitude],
    r_CT_H: Array,
    margin_m: Array,
) -> tuple[Array, Array]:
    """Return the least distance of an LED from an image's edge, px, (n,): as planned, and in the whole band.

    attitudes: n of them. r_CT_H: (n, 3), m. margin_m: (n, 3), m, half the band of positions.
    """
    n, to_rails = len(attitudes), rails_of(params)
    rails_m = linear.product(r_CT_H, to_rails.T)
    planned = _margins(
        params, mounting, camera, leds, rails_m, np.array([a.planned for a in attitudes]).reshape(n, 1, 6)
    )
    shifted = rails_m[:, None, :] + linear.product(margin_m[:, None, :] * _CORNERS, to_rails.T)  # (n, 8, 3)
    corners = np.array([a.corners for a in attitudes])  # (n, 8, 6)
    least = planned[:, 0]
    for k in range(len(_CORNERS)):
        least = np.minimum(least, _margins(params, mounting, camera, leds, shifted[:, k], corners).min(axis=1))
    return planned[:, 0], least


def _margins(
    params: np.record, mounting: np.record, camera: np.record, leds: Array, rails_m: Array, axes: Array
) -> Array:
    """Return the view margins (n, m), px, of n displacements (n, 3), each with m attitudes of the bench (n, m, 6)."""
    rail = np.ascontiguousarray((axes[:, :, :3] + rails_m[:, None, :]).reshape(-1, 3))
    gimbal = np.ascontiguousarray(axes[:, :, 3:].reshape(-1, 3))
    out = np.empty(len(rail))
    view_margins(params, mounting, camera, leds, rail, gimbal, out)
    return out.reshape(axes.shape[:2])
