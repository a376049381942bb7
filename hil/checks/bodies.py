"""Whether bodies of chaser, target and bench stay apart along the whole plan of a scenario, aborts included."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from hil.bench.guard import GUARD
from hil.checks.planned_trajectory import PlanSample, moments
from hil.checks.reachability import position_margin
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array, new
from hil.errors import Problem
from hil.maths import quat
from hil.models.bodies import PAIR, WHICH, clearance
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params

_BETWEEN: Final = 10  # points between two moments of the plan
_NO_TURN: Final = np.array([0.0, 0.0, 0.0, 1.0])
_FAR_M: Final = 1e6


def check_bodies(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for the bodies of the chaser, and one for those of the bench, that the plan brings too near.

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
        guard = bench_params.axis_guard(rig.value, scenario.value)
        nearest = _Nearest(scenario.value, guard, float(guard.deceleration), np.array(rig.value.bench.lever_arm_m))
        problems += _problem(scenario, plan, nearest, "rig.bench.bodies", rig.value.bench.bodies_distance_m)
    return problems


def _chaser(scenario: Scenario) -> np.record:
    """Return GUARD with the bodies of chaser and target in place of those of turntable and lab."""
    monitor, guard = gnc_params.approach_monitor(scenario), new(GUARD)
    guard.turntable, guard.lab = monitor.chaser, monitor.target
    return guard


class _Nearest:
    """Distance that braking leaves between bodies. guard: GUARD. lever_arm_m: of the centre of rotation, in c."""

    def __init__(
        self, scenario: Scenario, guard: np.record, brake_mps2: float, lever_arm_m: Array | None = None
    ) -> None:
        self._guard = guard
        self._brake = brake_mps2
        self._arm = np.zeros(3) if lever_arm_m is None else lever_arm_m
        self._band_rad = math.radians(scenario.reachability.attitude_margin_deg)
        self._found = np.empty(4)

    def at(self, r: Array, rotation: Array, v: Array, margin_m: float) -> tuple[float, int]:
        """Return the distance, m, and the number of the pair, for a chaser at ``r`` (3,) with ``rotation`` from H."""
        guard, q = self._guard, quat.from_rotation_vector(rotation)
        centre = r - quat.transform_back(q, self._arm)
        least, which = math.inf, 0
        for bodies, attitude in ((guard.carriage, _NO_TURN), (guard.turntable, q)):
            turned = 0.0 if bodies is guard.carriage else self._band_rad
            left = clearance(
                bodies, centre, attitude, v, 0.0, guard.lab, 0.0, self._brake, 1.0, _FAR_M, self._found
            )  # fmt: skip
            left -= margin_m + turned * float(bodies.arm.max())
            if bodies.n and left < least:
                least, which = left, int(self._found[WHICH])
        return least, which


def _points(plan: list[PlanSample], margins: Array) -> Iterator[tuple[PlanSample, Array, Array, Array, float]]:
    """Yield the moments of the plan, and points between them, with position, rotation, velocity and half band, m."""
    for k, moment in enumerate(plan):
        before = plan[k - 1] if k and plan[k - 1].abort_s == moment.abort_s else moment
        for fraction in np.linspace(0.0, 1.0, _BETWEEN + 1)[1:] if before is not moment else (1.0,):
            r = before.r_CT_H + fraction * (moment.r_CT_H - before.r_CT_H)
            rotation = before.rotation + fraction * (moment.rotation - before.rotation)
            v = before.v_CT_H if np.linalg.norm(before.v_CT_H) > np.linalg.norm(moment.v_CT_H) else moment.v_CT_H
            yield moment, r, rotation, v, float(np.linalg.norm(margins[k]))


def _problem(
    scenario: Loaded[Scenario], plan: list[PlanSample], nearest: _Nearest, key: str, least_m: float
) -> list[Problem]:
    """Return a problem for the moment at which the bodies of the list ``key`` are nearest, if that is too near."""
    margins = position_margin(scenario.value, np.array([moment.far_m for moment in plan]))
    (left_m, which), moment = min(
        ((nearest.at(r, rotation, v, margin), moment) for moment, r, rotation, v, margin in _points(plan, margins)),
        key=lambda found: found[0][0],
    )
    if left_m >= least_m:
        return []
    first, second = divmod(which, PAIR)
    begun = "" if moment.abort_s is None else f", in an abort begun at {moment.abort_s:.1f} s"
    text = (
        f"{first} and {second} would be {left_m:.3f} m apart at {moment.t_s:.1f} s{begun}, with the band about the "
        f"plan and after braking; allowed {least_m:g} m or more"
    )
    return [Problem(scenario.where(moment.point_key), key, text)]
