"""What of a scenario's motion a bench does not show whose axes do not all have a drive."""

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
    """Return a line with what the bench does not show of the plan; none if all of its axes have a drive."""
    if not rig.hidden:
        return []
    try:
        largest = unseen_plan(scenario, rig)
    except ValueError:  # refused by the check of the plan
        return []
    return [
        f"{rig.name} has no drive for {', '.join(rig.hidden)}: of the plan it does not show {unseen_text(largest)}; "
        "the vision unit does not see that motion, the IMU and the verdict have it"
    ]


def unseen_text(largest: Array) -> str:
    """Return positions, m, and angles, rad, (6,), as text."""
    metres, degrees = (" ".join(f"{value:.3f}" for value in each) for each in (largest[:3], np.degrees(largest[3:])))
    return f"up to x y z {metres} m in H, {degrees} deg about c"
