"""Plan of calibration views: bench positions that the axes can reach safely and that determine the calibration best."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import AXES, Array, new
from hil.errors import BadInput
from hil.loop.bench_stage import Move
from hil.maths import euler, quat
from hil.safety.motion_guards import JogGuard
from hil.vmu.calibration.model import Setup, TurntableModel, project_view
from hil.vmu.calibration.refine import Prior
from hil.vmu.kernels.chain import CAMERA_POSITION, TARGET_POSITION

_CANDIDATES: Final = 200
_TRIES: Final = 60  # per candidate
_MARGIN_PX: Final = 12.0  # distance of an LED from the image's edge
_LEAST_LEDS: Final = 3  # in each image
_TRAVEL_MARGIN: Final = 0.02  # fraction of the travel
_SIGMA_PX: Final = 0.05
_SAMPLES: Final = 64  # samples of a move

IsClear = Callable[[Array, Array], bool]
"""Whether a move between two positions of the axes, (6,), stays clear of the target."""


@dataclass(frozen=True)
class PlanRequest:
    """Views to plan: how many, ranges from camera to target, m, and the largest angle of each gimbal, rad."""

    count: int
    near_m: float
    far_m: float
    turn_rad: float


class Clearance:
    """Guard volume of the bench for moves outside a run.

    bench: BENCH_PARAMS. guard: GUARD. margin_m: by which its distances are larger. brakes: whether the axes must also
    be able to brake before it at each position of a move.
    """

    def __init__(self, bench: np.record, guard: np.record, margin_m: float, brakes: bool = False) -> None:
        self._bench, self._brakes = bench, brakes
        self._guard = guard.copy()
        self._guard.zone.radius += margin_m
        self._guard.zone.plane += margin_m
        self._guard.distance += margin_m
        self._volume = JogGuard(self._guard)

    def __call__(self, start: Array, target: Array) -> bool:
        """Return whether all positions of a slow move from ``start`` to ``target``, (6,), are outside the volume."""
        move = Move(self._bench, axes_record(start), axes_record(target))
        axes = new(AXES)
        for t_s in np.linspace(0.0, move.duration_s, _SAMPLES):
            move.at(t_s, axes)
            if self._volume.check_position(axes) is not None:
                return False
            if self._brakes and self._volume.check_motion(axes) is not None:
                return False
        return True


def axes_record(position: Array) -> np.record:
    """Return AXES at rest at ``position`` (6,), rails, m, and gimbals, rad."""
    axes = new(AXES)
    axes.rail_m, axes.gimbal_rad = position[:3], position[3:]
    return axes


def plan_views(
    setup: Setup, bench: np.record, held: Prior, request: PlanRequest, is_clear: IsClear, rng: np.random.Generator
) -> Array:
    """Return the axes, (n, 6), of the views in the order of a short way; at most ``request.count``.

    The views are chosen one after the other from random ones within travel, image and clearance, each with the largest
    gain of information: the determinant of the information matrix of all parameters and LEDs, with the errors of the
    encoders as unknowns of each view. setup: the nominal one. bench: BENCH_PARAMS. Raises BadInput if there are none.
    """
    turntable = TurntableModel(np.array(bench.lever_arm), np.array(bench.order))
    candidates = _candidates(setup, turntable, bench, request, is_clear, rng)
    if len(candidates) < request.count:
        text = f"{len(candidates)} views with the LEDs in both images within the travel, {request.count} are required"
        raise BadInput.single("--drive", "", text)
    chosen = _most_informative([_information(setup, turntable, held, axes) for axes in candidates], request.count)
    views = candidates[chosen]
    return views[short_way(views, bench, is_clear)]


def _candidates(
    setup: Setup,
    turntable: TurntableModel,
    bench: np.record,
    request: PlanRequest,
    is_clear: IsClear,
    rng: np.random.Generator,
) -> Array:
    low, high = np.asarray(bench.low), np.asarray(bench.high)
    margin = _TRAVEL_MARGIN * (high - low)
    spread = 0.5 * setup.sizes[0] / setup.theta[:2]  # tangent of the angle to the image's edge
    arm = turntable.lever_arm + setup.theta[CAMERA_POSITION : CAMERA_POSITION + 3]
    target = setup.theta[TARGET_POSITION : TARGET_POSITION + 3]
    candidates: list[Array] = []
    for _ in range(_TRIES * _CANDIDATES):
        axes = np.empty(6)
        axes[3:] = rng.uniform(-request.turn_rad, request.turn_rad, 3)
        z = float(np.exp(rng.uniform(np.log(request.near_m), np.log(request.far_m))))
        p_v = z * np.array([*(rng.uniform(-1.0, 1.0, 2) * spread), 1.0])
        a_ch = quat.to_matrix(euler.to_quaternion(axes[3:], turntable.order))
        axes[:3] = target - a_ch.T @ (setup.camera_axes.T @ p_v + arm)
        within = (axes >= low + margin).all() and (axes <= high - margin).all()
        if within and _is_seen(setup, turntable, axes) and is_clear(axes, axes):
            candidates.append(axes)
            if len(candidates) == _CANDIDATES:
                break
    return np.array(candidates).reshape(-1, 6)


def _is_seen(setup: Setup, turntable: TurntableModel, axes: Array) -> bool:
    pixels = project_view(setup, turntable, axes).pixels
    inside = ((pixels > _MARGIN_PX) & (pixels < setup.sizes[:, None] - 1.0 - _MARGIN_PX)).all(axis=-1)
    return bool(inside.sum(axis=1).min() >= max(_LEAST_LEDS, len(setup.points) - 1))


def _information(setup: Setup, turntable: TurntableModel, held: Prior, axes: Array) -> Array:
    """Return the information matrix of a view in units of the prior's standard deviations."""
    seen = project_view(setup, turntable, axes)
    m = len(setup.points)
    rows = np.isfinite(seen.pixels).all(axis=-1).repeat(2)
    by_points = np.zeros((2, m, 2, m, 3))
    for k in range(m):
        by_points[:, k, :, k] = seen.by_point[:, k]
    slopes = np.concatenate(
        [
            (seen.by_common * held.sigma)[..., held.free].reshape(4 * m, -1),
            by_points.reshape(4 * m, 3 * m) * held.layout_sigma,
        ],
        axis=1,
    )[rows]
    by_axes = (seen.by_axes * held.axis_sigma).reshape(4 * m, 6)[rows]
    covariance = _SIGMA_PX**2 * np.eye(len(slopes)) + by_axes @ by_axes.T
    information: Array = slopes.T @ np.linalg.solve(covariance, slopes)
    return information


def _most_informative(matrices: list[Array], count: int) -> list[int]:
    total = np.eye(len(matrices[0]))
    remaining = list(range(len(matrices)))
    chosen: list[int] = []
    for _ in range(count):
        gains = [float(np.linalg.slogdet(total + matrices[k])[1]) for k in remaining]
        best = remaining.pop(int(np.argmax(gains)))
        total = total + matrices[best]
        chosen.append(best)
    return chosen


def short_way(views: Array, bench: np.record, is_clear: IsClear) -> list[int]:
    """Return the numbers of ``views`` (n, 6) in the order of clear ways: from the farthest, each the nearest left.

    One that has no clear way from the last is put between two others; if there are none such, it is left out.
    """
    rates = np.asarray(bench.rate_max)
    remaining = list(range(len(views)))
    way = [remaining.pop(int(np.argmax(views[:, 0])))]
    while remaining:
        here = views[way[-1]]
        near_first = sorted(remaining, key=lambda k: float((np.abs(views[k] - here) / rates).max()))
        following = next((k for k in near_first if is_clear(here, views[k])), None)
        if following is None:
            break
        remaining.remove(following)
        way.append(following)
    for k in remaining:
        for position in range(len(way) - 1, 0, -1):
            if is_clear(views[way[position - 1]], views[k]) and is_clear(views[k], views[way[position]]):
                way.insert(position, k)
                break
    return way
