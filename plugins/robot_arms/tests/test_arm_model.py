"""Kinematics of a six-joint arm: forward against inverse in each configuration, and what limits a pose."""

from __future__ import annotations

import dataclasses
import math
from itertools import product

import numpy as np
import pytest

from hil.drivers.arm.model import Unreachable
from hil_robot_arms.model import ArmModel

WIDE = np.array([[-50.0, 50.0]] * 6)
ARM = ArmModel(
    *(0.5, -0.055, 0.02, 1.045, 1.3, 1.525, 0.29),
    zero=np.radians([10.0, -90.0, 0.0, 0.0, 0.0, 0.0]), sign=np.array([-1.0, 1.0, 1.0, -1.0, 1.0, -1.0]), travel=WIDE,
    rate_max=np.ones(6), shoulder=1, elbow=1, wrist=1, wrist_min=1e-6, elbow_min=1e-6, shoulder_min=1e-6,
    twist_max=1e9, r_B=np.array([3.0, -1.6, -1.0]), a_B=np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    r_T=np.array([0.0, 0.1, 0.2]), a_T=np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
)  # fmt: skip


@pytest.mark.parametrize("sides", list(product((1, -1), repeat=3)), ids=str)
def test_joints_of_a_pose_lead_to_it_in_each_configuration(sides: tuple[int, int, int]) -> None:
    arm = dataclasses.replace(ARM, shoulder=sides[0], elbow=sides[1], wrist=sides[2])
    draws, found = np.random.default_rng(1), 0
    for _ in range(100):
        joints = draws.uniform(-3.0, 3.0, 6)
        flange, axes = arm.points(joints)[3], arm.flange_axes(joints)
        try:
            again = arm.joints_of(flange, axes, joints)
        except Unreachable:  # no such solution in this configuration
            continue
        found += 1
        assert arm.points(again)[3] == pytest.approx(flange, abs=1e-9)
        assert arm.flange_axes(again) == pytest.approx(axes, abs=1e-9)
        assert np.abs(again - joints).max() <= math.pi + 1e-9
    assert found > 40


def test_tool_and_base_are_inverted() -> None:
    turn = ARM.flange_axes(np.array([0.3, -0.2, 0.4, 0.5, -0.6, 0.7]))
    r_L, a_CL = np.array([2.0, 0.1, -0.3]), turn.T
    assert ARM.pose_of(*ARM.flange_of(r_L, a_CL)) == (pytest.approx(r_L), pytest.approx(a_CL))


def test_pose_of_a_data_sheet() -> None:
    """KUKA KR 6 R700: upper arm upright, forearm forward."""
    lengths = {"a1": 0.025, "a2": -0.035, "b": 0.0, "c1": 0.4, "c2": 0.315, "c3": 0.365, "c4": 0.08}
    arm = dataclasses.replace(ARM, **lengths, zero=np.radians([0.0, -90.0, 0.0, 0.0, 0.0, 0.0]))
    points = arm.points(np.radians([0.0, -90.0, 90.0, 0.0, 0.0, 0.0]))
    assert points[3] == pytest.approx([0.025 + 0.365 + 0.08, 0.0, 0.4 + 0.315 + 0.035])


REFUSED = {
    "the wrist is .* m from axis 2, its reach is": (np.array([9.0, 0.0, 0.0]), {}),
    "from axis 1, allowed from 3 m": (np.array([2.0, 0.0, 1.0]), {"shoulder_min": 3.0}),
    "the elbow is bent by": (np.array([2.0, 0.0, 1.0]), {"elbow_min": 1.5}),
    "from a singular wrist": (np.array([2.0, 0.0, 1.0]), {"wrist_min": 1.5}),
    r"joint 1 at .* deg, allowed": (
        np.array([2.0, 0.0, 1.0]),
        {"travel": np.array([[3.1, 3.2]] + [[-50.0, 50.0]] * 5)},
    ),
    "twist the cables by": (np.array([2.0, 0.0, 1.0]), {"twist_max": 0.01}),
}


@pytest.mark.parametrize(("text", "changes"), REFUSED.items(), ids=REFUSED.keys())
def test_limit_is_named(text: str, changes: tuple[np.ndarray, dict[str, object]]) -> None:
    flange, limits = changes
    axes = ARM.flange_axes(np.array([0.2, -1.0, 1.2, 0.4, 0.9, 0.3]))
    with pytest.raises(Unreachable, match=text):
        dataclasses.replace(ARM, **limits).joints_of(flange, axes, np.zeros(6))  # type: ignore[arg-type]


def test_joint_that_would_be_too_fast_is_named() -> None:
    with pytest.raises(Unreachable, match=r"^joint 4 at 114.6 deg/s, allowed 57.2958 deg/s"):
        ARM.check_rate(np.zeros(6), np.array([0.0, 0.1, 0.0, -0.2, 0.0, 0.0]), 0.1)
