"""What of a scenario's motion a bench does not show whose axes do not all have a drive, or shows late."""

from __future__ import annotations

import numpy as np

from hil.bench.kinematics import unseen
from hil.checks.reachability import axis_demands
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, Array, new
from hil.maths import quat
from hil.params import bench as bench_params


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
    """Return a line with what the bench does not show of the plan, and one per robot with what its lag costs."""
    try:
        late = lag_lines(scenario, rig) if rig.robots else []
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
