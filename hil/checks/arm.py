"""Whether the robots of a bench can follow the whole plan of a scenario, aborts included, and show it in time.

The path of the plan is followed in the robots' configurations, with all turns of the joints since the start: by their
models, and their links against the bodies of the lab and each other.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from hil.bench.kinematics import axes_of_pose
from hil.checks.reachability import Demands, axis_demands
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
_DEGREES: Final = math.degrees(1.0)
_LEAST_S: Final = 0.2  # span over which the speed of a joint is a mean
_LAG_ERROR: Final = (1e-4, 0.01)  # m and deg that a lag may cost where the poses claim to be better


def check_arm(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for the first moment of the plan at which a robot cannot take the pose, or may not.

    If there is none, one for the axis that the lag of its robot makes too late. Raises ValueError where the thruster
    layout cannot move an axis.
    """
    asked = axis_demands(scenario.value, rig.value)
    path, plan = _Path(scenario.value, rig.value, asked), asked.plan
    approach: dict[float, tuple[int, list[Array]]] = {}
    before, joints = 0, list[Array]()
    for k, sample in enumerate(plan):
        begins = plan[before].abort_s != sample.abort_s or sample.t_s < plan[before].t_s
        if sample.abort_s is not None and begins:
            before, joints = approach[sample.abort_s]  # each abort begins on the approach
        try:
            joints = path.follow(before, k, joints)
        except Unreachable as refused:
            begun = "" if sample.abort_s is None else f", in an abort begun at {sample.abort_s:.1f} s"
            text = f"{path.robot}: {refused}, at {sample.t_s:.1f} s of the plan or before{begun}"
            return [scenario.problem(sample.point_key, text)]
        before = k
        if sample.abort_s is None:
            approach[sample.t_s] = k, joints
    worst = max(lag_costs(asked, rig.value), default=None)
    return [] if worst is None or worst.of_allowed <= 1.0 else [rig.problem(worst.key, worst.text)]


class LagCost(NamedTuple):
    """Largest error that the lag of a robot adds to an axis of the plan. of_allowed: fraction of what is allowed."""

    of_allowed: float
    key: str
    text: str


def lag_costs(asked: Demands, rig: Rig) -> list[LagCost]:
    """Return what the lag of each robot that declares it costs, by its axes."""
    own = [k for k, sample in enumerate(asked.plan) if sample.abort_s is None]
    elapsed_s = np.maximum(np.diff([asked.plan[k].t_s for k in own]), _LEAST_S)[:, None]
    rates = {"rails": asked.axes.planned_rate[own, :3], "turntable": asked.axes.rate[own, 3:]}
    rates["target"] = np.diff(asked.target_at[own], axis=0) / elapsed_s
    costs = []
    for name, robot in rig.robots.items():
        for group, part in rig.robot_axes(name).items():
            scale, unit, sigma, allowed = 1e3, "mm", "m", 1e3 * max(_LAG_ERROR[0], rig.vmu.bench_sigma_m)
            if group != "rails":
                scale, unit, sigma, allowed = _DEGREES, "deg", "deg", max(_LAG_ERROR[1], rig.vmu.bench_sigma_deg)
            speeds = scale * np.abs(rates[group]).max(axis=0)
            for axis, table, number in zip(part.axis_names, part.axes, part.axis_numbers, strict=True):
                late_s, speed = (robot.lag_s or 0.0) - table.lead_s, float(speeds[number])
                cost = abs(late_s) * speed
                text = (
                    f"{table.lead_s:g}: leaves {1e3 * late_s:.3g} ms of {name}.lag_s, {cost:.3g} {unit} at "
                    f"{speed:.3g} {unit}/s of the plan, allowed {allowed:g} {unit} by vmu.bench_sigma_{sigma}"
                )
                key = "rotary_manipulator" if group == "target" else group
                if robot.lag_s is not None:
                    costs.append(LagCost(cost / allowed, f"rig.{key}.{axis}.lead_s", text))
    return costs


class _Path:
    """Follows the plan with the joints of the robots. robot: the one that was followed last."""

    def __init__(self, scenario: Scenario, rig: Rig, asked: Demands) -> None:
        self._bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._robots, self._least_m = [ArmKinematics(rig, name) for name in rig.robots], rig.bench.bodies_distance_m
        self._bodies = [
            (f"body {number} of rig.bench.bodies", np.array(body.vertices_m), body.radius_m)
            for number, body in enumerate(rig.bench.bodies, 1)
            if body.on == "lab"
        ]
        self._plan = asked.plan
        self._poses = np.hstack([[[*m.r_CT_H, *m.rotation] for m in asked.plan], asked.target_at])
        self._axes, self._rest, self._normal = new(AXES), np.zeros(3), np.empty(3)
        self.robot = ""

    def follow(self, before: int, now: int, joints: list[Array]) -> list[Array]:
        """Return the joints of each robot at sample ``now``, coming from ``before`` with ``joints``.

        Raises Unreachable.
        """
        if not joints:
            return self._at(self._poses[now], None)
        steps = _BETWEEN[self._plan[now].abort_s is not None]
        duration_s = max((self._plan[now].t_s - self._plan[before].t_s) / steps, _LEAST_S)
        for fraction in np.linspace(0.0, 1.0, steps + 1)[1:]:
            reached = self._at(self._poses[before] + fraction * (self._poses[now] - self._poses[before]), joints)
            for robot, near, at in zip(self._robots, joints, reached, strict=True):
                self.robot = robot.name
                robot.model.check_rate(near, at, duration_s)
            joints = reached
        return joints

    def _at(self, pose: Array, near: list[Array] | None) -> list[Array]:
        q_CH = quat.from_rotation_vector(pose[3:6])
        axes_of_pose(self._bench, pose[:3], self._rest, q_CH, self._rest, self._axes)
        six = np.concatenate([self._axes.rail_m, self._axes.gimbal_rad])
        reached, links = list[Array](), list[tuple[str, Array, float]]()
        for number, robot in enumerate(self._robots):
            self.robot = robot.name
            axes = np.concatenate([self._rest, pose[6:]]) if robot.name == "target_arm" else six
            joints = robot.target(axes[robot.numbers], 0.0, None if near is None else near[number]).joints_rad
            assert joints is not None
            reached.append(joints)
            if (radius := robot.model.link_radius) is not None:
                base, ends = robot.base_moved_by(axes), robot.model.links(joints)
                own = [(name, base + link, radius) for name, link in ends.items()]
                self._check_distances(own, self._bodies + links)
                links += [(f"{name} of {robot.name}", link, radius) for name, link, _ in own]
        return reached

    def _check_distances(self, links: list[tuple[str, Array, float]], others: list[tuple[str, Array, float]]) -> None:
        """Raise Unreachable if one of ``links`` is too near one of ``others``: names, vertices (n, 3), m, and radii."""
        for name, link, radius in links:
            for other, vertices, rounding in others:
                distance = separation(link, 2, vertices, len(vertices), self._normal) - radius - rounding
                if distance < self._least_m:
                    raise Unreachable(
                        f"the {name} would be {max(0.0, distance):.3f} m from {other}, allowed from {self._least_m:g} m"
                    )
