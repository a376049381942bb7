"""Lines that are printed before a run: what its bench does not show, and what its verdict cannot reach."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hil.bench.kinematics import unseen
from hil.checks.ephemeris import ephemeris_warnings
from hil.checks.go_level import go_warnings
from hil.checks.observability import observed_by
from hil.checks.planned_trajectory import moments
from hil.checks.reachability import axis_demands
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, Array, new
from hil.maths import quat
from hil.params import bench as bench_params
from hil.params.dynamics import initial_truth
from hil.params.held_back import STEP_S, HeldBack, held_back_text


def unseen_plan(scenario: Scenario, rig: Rig) -> Array:
    """Return the largest part of the plan's poses that the bench does not show, (6,): along H, m, about c, rad.

    Raises ValueError where the thruster layout cannot move an axis.
    """
    plan = axis_demands(scenario, rig).plan
    r, q = np.array([m.r_CT_H for m in plan]), np.array([quat.from_rotation_vector(m.rotation) for m in plan])
    out = np.empty((len(plan), 6))
    unseen(bench_params.bench(rig, scenario.step_s, scenario.bench), r, q, new(AXES), out)
    largest: Array = np.abs(out).max(axis=0)
    return largest


def unseen_warnings(scenario: Scenario, rig: Rig) -> list[str]:
    """Return lines with what a plane holds back, what the bench does not show of the plan, and what lag costs."""
    try:
        late = [*held_back_lines(scenario), *(lag_lines(scenario, rig) if rig.robots else [])]
        if not rig.hidden:
            return late
        largest = unseen_plan(scenario, rig)
    except ValueError:  # refused by the check of the plan
        return []
    return [
        *late,
        f"{rig.name} has no drive for {', '.join(rig.hidden)}: of the plan it does not show {unseen_text(largest)}; "
        "the vision unit does not see that motion, the IMU and the verdict have it",
    ]


def held_back_lines(scenario: Scenario) -> list[str]:
    """Return a line with the acceleration across the plane of a planar chaser along its plan, if there is any."""
    if not scenario.chaser.planar or scenario.truth.relative_motion == "free":
        return []
    plan = [moment for moment in moments(scenario) if moment.abort_s is None]
    t_s = np.arange(0.0, scenario.duration_s, STEP_S)
    r, v = (
        np.array([np.interp(t_s, [m.t_s for m in plan], [getattr(m, name)[k] for m in plan]) for k in range(3)]).T
        for name in ("r_CT_H", "v_CT_H")
    )
    held, truth = HeldBack(scenario), kernel_record(initial_truth(scenario))
    for place, velocity in zip(r, v, strict=True):
        truth.r_CT_H, truth.v_CT_H = place, velocity
        held.add(truth)
    return [text] if (text := held_back_text(held.largest_mps2, held.impulse_mps)) else []


def lag_lines(scenario: Scenario, rig: Rig) -> list[str]:
    """Return a line for the robots of ``rig`` with what their lag costs most, and one for each whose lag is unknown."""
    from hil.checks.arm import lag_costs  # of few rigs

    worst = max(lag_costs(axis_demands(scenario, rig), rig), default=None)
    unknown = [
        f"{name}.lag_s is not set: what the lag costs is unknown" for name, r in rig.robots.items() if r.lag_s is None
    ]
    return unknown if worst is None else [f"{worst.key} {worst.text}", *unknown]


def unseen_text(largest: Array) -> str:
    """Return positions, m, and angles, rad, (6,), as text."""
    metres, degrees = (" ".join(f"{value:.3f}" for value in each) for each in (largest[:3], np.degrees(largest[3:])))
    return f"up to x y z {metres} m in H, {degrees} deg about c"


class BeforeRun(NamedTuple):
    """All lines, and those of them about the GNC's orbit, which the summary of a complete run repeats."""

    lines: list[str]
    ephemeris: list[str]


def before_run(scenario: Scenario, rig: Rig, length_s: float, seed: int | None = None) -> BeforeRun:
    """Return the lines before a run of ``length_s``; arguments: see ``ephemeris_limit``."""
    ephemeris = ephemeris_warnings(scenario, rig, length_s, seed)
    return BeforeRun(
        [*observed_by(scenario, rig), *unseen_warnings(scenario, rig), *go_warnings(scenario, rig), *ephemeris],
        ephemeris,
    )
