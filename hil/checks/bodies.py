"""Whether bodies of chaser, target and bench stay apart along the whole plan of a scenario, aborts included."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np

from hil.bench.guard import GUARD
from hil.bench.kinematics import axes_of_pose
from hil.checks.planned_trajectory import PlanSample, moments
from hil.checks.reachability import axis_demands, position_margin
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, Array, new
from hil.errors import Problem
from hil.maths import euler, linear, quat
from hil.maths.elementary import square
from hil.models.bodies import PAIR, WHICH, clearance
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params

_BETWEEN: Final = 10  # points between two moments of the plan
_NO_TURN: Final = np.array([0.0, 0.0, 0.0, 1.0])
_FAR_M: Final = 1e6
_ROUNDING_M: Final = 1e-9


def check_bodies(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem each for bodies of the chaser and of the bench that the plan brings too near.

    What counts is the distance after braking from the planned speed, less the band of positions and attitudes about the
    plan that the reachability check uses as well. Without bodies, or with thrusters that cannot move an axis, there is
    none.
    """
    of_chaser, of_bench = scenario.value.keep_out.bodies, rig.value.bench.bodies
    if not of_chaser and not of_bench:
        return []
    try:
        plan = moments(scenario.value)
    except ValueError:  # refused by the check of the plan
        return []
    problems = []
    if of_chaser:
        nearest = _Nearest(scenario.value, _chaser(scenario.value), scenario.value.gnc.abort.brake_mps2)
        problems += _problem(scenario, plan, nearest, "keep_out.bodies", scenario.value.keep_out.distance_m)
    if of_bench:
        guard, arm = bench_params.axis_guard(rig.value, scenario.value), np.array(rig.value.bench.lever_arm_m)
        shown, to_L = _lab_of(scenario.value, rig.value), np.array(rig.value.bench.lab_axes)
        of_target = bench_params.target_guards(rig.value, scenario.value)
        left = plan if rig.value.shared_rails is None else axis_demands(scenario.value, rig.value).plan
        parts = [(left, guard, arm, shown)]
        if of_target is not None:
            moves = [
                replace(rest, r_CT_H=rest.r_CT_H - whole.r_CT_H, v_CT_H=rest.v_CT_H - whole.v_CT_H)
                for rest, whole in zip(left, plan, strict=True)
            ]
            parts += [(plan, of_target[0], arm, shown), (moves, of_target[1], np.zeros(3), partial(_in_lab, to_L))]
        for each, bodies, lever, to_lab in parts:
            nearest = _Nearest(scenario.value, bodies, float(bodies.deceleration), lever, to_lab)
            problems += _problem(scenario, each, nearest, "rig.bench.bodies", rig.value.bench.bodies_distance_m)
    return problems


def _chaser(scenario: Scenario) -> np.record:
    """Return GUARD with the bodies of chaser and target in place of turntable and lab."""
    monitor, guard = gnc_params.approach_monitor(scenario), new(GUARD)
    guard.turntable, guard.lab = monitor.chaser, monitor.target
    return guard


def _lab_of(scenario: Scenario, rig: Rig) -> Callable[[_Points], _Points] | None:
    """Return what takes the points of a plan to those that a bench shows in L; None if they are the same."""
    if not rig.is_reduced:
        return None
    bench, axes, rest = bench_params.bench(rig, scenario.step_s, scenario.bench), new(AXES), np.zeros(3)

    def shown(points: _Points) -> _Points:
        r, q, v = points.r.copy(), points.q.copy(), points.v.copy()
        for k in range(len(r)):
            axes_of_pose(bench, points.r[k], points.v[k], points.q[k], rest, axes)
            q[k] = euler.to_quaternion(axes.gimbal_rad, bench.order)
            r[k], v[k] = axes.rail_m + quat.transform_back(q[k], bench.lever_arm), axes.rail_mps
        return points._replace(r=r, q=q, v=v)

    return shown


def _in_lab(to_L: Array, points: _Points) -> _Points:
    """Return ``points`` in H in the axes of L, whose rows in H are ``to_L``."""
    return points._replace(r=linear.product(points.r, to_L.T), v=linear.product(points.v, to_L.T))


class _Nearest:
    """Distance that braking leaves between bodies. guard: GUARD. lever_arm_m: of the centre of rotation, in c.

    shown: see ``_lab_of``.
    """

    def __init__(
        self,
        scenario: Scenario,
        guard: np.record,
        brake_mps2: float,
        lever_arm_m: Array | None = None,
        shown: Callable[[_Points], _Points] | None = None,
    ) -> None:
        self.shown = shown or (lambda points: points)
        self._fixed = guard.lab
        self._brake = brake_mps2
        self._arm = np.zeros(3) if lever_arm_m is None else lever_arm_m
        band_rad = math.radians(scenario.reachability.attitude_margin_deg)
        kinds = ((guard.carriage, False), (guard.turntable, True))
        self._moving = [(moving, turns, band_rad * float(moving.arm.max())) for moving, turns in kinds if moving.n]
        self._found = np.empty(4)

    def bounds(self, points: _Points) -> Array:
        """Return a lower bound of the distance at each of ``points``, (n,), m, from the spheres about the bodies."""
        centre = points.r - _back(points.q, self._arm)
        fixed, m = self._fixed, int(self._fixed.n)
        speed = linear.lengths(points.v)
        least = np.full(len(centre), math.inf)
        for moving, turns, band_m in self._moving:
            for i in range(int(moving.n)):
                at = centre + (_back(points.q, moving.centre[i]) if turns else moving.centre[i])
                apart = linear.lengths(at[:, None] - fixed.centre[:m]) - fixed.reach[:m]
                nearest = apart.min(axis=1, initial=_FAR_M) - moving.reach[i] - band_m
                np.minimum(least, nearest, out=least)
        bounds: Array = least - square(speed) / (2.0 * self._brake) - points.margin
        return bounds

    def at(self, points: _Points, k: int) -> tuple[float, int]:
        """Return the distance, m, and the number of the pair, at point ``k``."""
        q, v = points.q[k], points.v[k]
        centre = points.r[k] - quat.transform_back(q, self._arm)
        least, which = math.inf, 0
        for moving, turns, band_m in self._moving:
            attitude = q if turns else _NO_TURN
            gap = clearance(moving, centre, attitude, v, 0.0, self._fixed, 0.0, self._brake, 1.0, _FAR_M, self._found)
            gap -= points.margin[k] + band_m
            if gap < least:
                least, which = gap, int(self._found[WHICH])
        return least, which


class _Points(NamedTuple):
    """Points along a plan: number of the moment; position and velocity, (n, 3), m, m/s; attitude; half band, m."""

    moment: np.ndarray
    r: Array
    q: Array
    v: Array
    margin: Array


def _points(plan: list[PlanSample], margins: Array) -> _Points:
    """Return the moments of the plan, and points between them."""
    numbers, r, rotation, v = [], [], [], []
    between = np.linspace(0.0, 1.0, _BETWEEN + 1)[1:, None]
    for k, moment in enumerate(plan):
        previous = plan[k - 1] if k and plan[k - 1].abort_s == moment.abort_s else moment
        fraction = between if previous is not moment else between[-1:]
        numbers += [k] * len(fraction)
        r.append(previous.r_CT_H + fraction * (moment.r_CT_H - previous.r_CT_H))
        rotation.append(previous.rotation + fraction * (moment.rotation - previous.rotation))
        faster = previous if linear.length(previous.v_CT_H) > linear.length(moment.v_CT_H) else moment
        v.append(np.broadcast_to(faster.v_CT_H, (len(fraction), 3)))
    q = np.array([quat.from_rotation_vector(each) for each in np.concatenate(rotation)])
    half = linear.lengths(margins)[numbers]
    return _Points(np.array(numbers), np.concatenate(r), q, np.concatenate(v), half)


def _back(q: Array, x: Array) -> Array:
    """Return ``x`` (3,) transformed by the inverse of each quaternion of ``q`` (n, 4), (n, 3)."""
    turned: Array = np.array([quat.transform_back(each, x) for each in q]) if x.any() else np.zeros((len(q), 3))
    return turned


def _problem(
    scenario: Loaded[Scenario], plan: list[PlanSample], nearest: _Nearest, key: str, least_m: float
) -> list[Problem]:
    """Return a problem for the moment at which the bodies of the list ``key`` are nearest, if that is too near."""
    points = nearest.shown(_points(plan, position_margin(scenario.value, np.array([moment.far_m for moment in plan]))))
    bounds = nearest.bounds(points)
    left_m, first_k, which = math.inf, 0, 0
    for k in np.argsort(bounds):
        if bounds[k] > left_m + _ROUNDING_M:
            break
        found_m, pair = nearest.at(points, k)
        if (found_m, k) < (left_m, first_k):
            left_m, first_k, which = found_m, k, pair
    moment = plan[points.moment[first_k]]
    if left_m >= least_m:
        return []
    first, second = divmod(which, PAIR)
    begun = "" if moment.abort_s is None else f", in an abort begun at {moment.abort_s:.1f} s"
    text = (
        f"{first} and {second} would be {left_m:.3f} m apart at {moment.t_s:.1f} s{begun}, with the band about the "
        f"plan and after braking; allowed {least_m:g} m or more"
    )
    return [Problem(scenario.where(moment.point_key), key, text)]
