"""Whether the robot of a bench can follow the whole plan of a scenario, aborts included.

The path of the plan is followed in the robot's configuration, with all turns of the joints since the start: by its
model, and its links against the bodies of the lab.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.bench.kinematics import axes_of_pose
from hil.checks.planned_trajectory import PlanSample
from hil.checks.reachability import axis_demands
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import AXES, Array, new
from hil.drivers.arm.model import ArmKinematics, Unreachable
from hil.errors import Problem
from hil.maths import quat
from hil.maths.convex import separation
from hil.params import bench as bench_params

_BETWEEN: Final = {False: 12, True: 4}  # points between two moments of the approach, and of an abort
_LEAST_S: Final = 0.2  # span over which the speed of a joint is a mean


def check_arm(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for the first moment of the plan at which the robot cannot take the pose, or may not.

    Raises ValueError where the thruster layout cannot move an axis.
    """
    path = _Path(scenario.value, rig.value)
    before: PlanSample | None = None
    approach: dict[float, tuple[PlanSample, Array]] = {}
    joints: Array | None = None
    for sample in axis_demands(scenario.value, rig.value).plan:
        begins = before is None or before.abort_s != sample.abort_s or sample.t_s < before.t_s
        if sample.abort_s is not None and begins:
            before, joints = approach[sample.abort_s]  # each abort begins on the approach
        try:
            joints = path.follow(before, sample, joints)
        except Unreachable as refused:
            begun = "" if sample.abort_s is None else f", in an abort begun at {sample.abort_s:.1f} s"
            text = f"arm: {refused}, at {sample.t_s:.1f} s of the plan or before{begun}"
            return [Problem(scenario.where(sample.point_key), sample.point_key, text)]
        before = sample
        if sample.abort_s is None:
            approach[sample.t_s] = sample, joints
    return []


class _Path:
    """Follows the plan with the joints of the robot."""

    def __init__(self, scenario: Scenario, rig: Rig) -> None:
        self._bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._arm, self._least_m = ArmKinematics(rig), rig.bench.bodies_distance_m
        bodies = [(number, body) for number, body in enumerate(rig.bench.bodies, 1) if body.on == "lab"]
        self._bodies = [(number, np.array(body.vertices_m), body.radius_m) for number, body in bodies]
        self._axes, self._rest, self._normal = new(AXES), np.zeros(3), np.empty(3)

    def follow(self, before: PlanSample | None, sample: PlanSample, joints: Array | None) -> Array:
        """Return the joints at ``sample``, coming from ``before`` with ``joints``. Raises Unreachable."""
        if before is None or joints is None:
            return self._at(sample.r_CT_H, sample.rotation, None)
        steps = _BETWEEN[sample.abort_s is not None]
        duration_s = (sample.t_s - before.t_s) / steps
        for fraction in np.linspace(0.0, 1.0, steps + 1)[1:]:
            r = before.r_CT_H + fraction * (sample.r_CT_H - before.r_CT_H)
            reached = self._at(r, before.rotation + fraction * (sample.rotation - before.rotation), joints)
            self._arm.model.check_rate(joints, reached, max(duration_s, _LEAST_S))
            joints = reached
        return joints

    def _at(self, r_CT_H: Array, rotation: Array, near: Array | None) -> Array:
        axes_of_pose(self._bench, r_CT_H, self._rest, quat.from_rotation_vector(rotation), self._rest, self._axes)
        joints = self._arm.target(np.concatenate([self._axes.rail_m, self._axes.gimbal_rad]), 0.0, near).joints_rad
        assert joints is not None
        radius = self._arm.model.link_radius
        for name, link in {} if radius is None else self._arm.model.links(joints).items():
            for number, vertices, rounding in self._bodies:
                distance = separation(link, 2, vertices, len(vertices), self._normal) - radius - rounding
                if distance < self._least_m:
                    raise Unreachable(
                        f"the {name} would be {max(0.0, distance):.3f} m from body {number} of rig.bench.bodies, "
                        f"allowed from {self._least_m:g} m"
                    )
        return joints
