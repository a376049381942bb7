"""Drawn plans and robots: all that an independent judge calls impossible are refused before motion, none of the others.

The judge is a program of its own (plan_judge.py) for a Python that has roboticstoolbox-python 1.5.0, rtb-data 2.0.0:

    ROBOTICS_TOOLBOX_PYTHON=/path/to/python pytest -m slow plugins/robot_arms/tests/test_drawn_plans.py
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.checks.arm import check_arm
from hil.checks.reachability import axis_demands
from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.maths import quat
from hil_robot_arms.settings import arm_model

kuka = pytest.importorskip("hil_kuka_rsi")
RIG = str(Path(kuka.__file__).parent / "rigs" / "emulated-arm-kuka.toml")
TRAVEL = [[-185.0, 185.0], [-130.0, 20.0], [-100.0, 144.0], [-350.0, 350.0], [-120.0, 120.0], [-350.0, 350.0]]
JUDGE = os.environ.get("ROBOTICS_TOOLBOX_PYTHON")
PLANS = int(os.environ.get("PLANS", "500"))
UNDECIDED = 0.5  # deg or cm of margin within which the two may differ
KINDS = ("free", "reach", "joint", "twist", "wrist", "link")


def box(low: np.ndarray, high: np.ndarray) -> list[list[float]]:
    """Return the vertices of a box."""
    return [
        [float(x), float(y), float(z)] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])
    ]


def near_singular_wrist(rig: Rig, r_L: np.ndarray, draws: np.random.Generator) -> list[list[float]] | None:
    """Return axes of a tool with which joint 5 is some degrees from 0 at ``r_L``; None if the robot cannot reach it."""
    assert rig.arm is not None
    arm = arm_model(rig.arm)
    target = arm.a_B @ (r_L - arm.r_B)
    away = np.radians(draws.uniform(0.0, 25.0))
    axes = np.eye(3)
    joints = np.zeros(6)
    for _ in range(50):
        wrist = target - axes @ arm.r_T - arm.c4 * axes[:, 2]
        q1 = np.arctan2(wrist[1], wrist[0])
        forward, up = np.hypot(*wrist[:2]) - arm.a1, wrist[2] - arm.c1
        far, fore = np.hypot(forward, up), np.hypot(arm.a2, arm.c3)
        if not abs(arm.c2 - fore) < far < arm.c2 + fore:
            return None
        q2 = np.arctan2(forward, up) - np.arccos((far**2 + arm.c2**2 - fore**2) / (2.0 * far * arm.c2))
        q3 = np.arccos((far**2 - arm.c2**2 - fore**2) / (2.0 * arm.c2 * fore)) - np.arctan2(arm.a2, arm.c3)
        joints[:3] = q1, q2, q3
        joints[3:] = 0.0, away, 0.0
        axes = arm.flange_axes(arm.zero + arm.sign * joints)
    return [[float(value) for value in row] for row in arm.a_B.T @ axes]


def drawn(draws: np.random.Generator, kind: str) -> tuple[Loaded[Scenario], Loaded[Rig]]:
    """Return scheme 1 from a drawn start, and a drawn robot that ``kind`` makes hard to follow it with."""
    position = [float(draws.uniform(2.5, 5.0)), *(float(v) for v in draws.uniform(-0.3, 0.3, 2))]
    scenario = load_scenario(
        "scheme-1",
        [f"initial.position_m={position}", f"initial.attitude_deg={[float(v) for v in draws.uniform(-6.0, 6.0, 3)]}"],
    )
    low, high = ([2.7, -1.8, -1.15], [3.2, -1.5, -0.9]) if kind != "reach" else ([1.5, -3.2, -1.6], [4.5, -1.2, -0.4])
    geometry: dict[str, Any] = {"base_m": [float(v) for v in draws.uniform(low, high)]}
    travel = [[*pair] for pair in TRAVEL]
    if kind == "joint":
        joint, side = draws.integers(6), draws.integers(2)
        travel[joint][side] *= float(draws.uniform(0.05, 0.95))
    if kind == "twist":
        geometry["twist_max_deg"] = float(draws.uniform(20.0, 320.0))
    geometry["joint_travel_deg"] = travel
    rig = load_rig(RIG, [f"rig.arm.kuka_rsi.geometry.{key}={json.dumps(value)}" for key, value in geometry.items()])
    if kind == "wrist":
        moments = axis_demands(scenario.value, rig.value).plan
        moment = moments[draws.integers(len(moments))]
        tool = near_singular_wrist(rig.value, moment.r_CT_H, draws)
        if tool is not None:
            a_CL = quat.to_matrix(quat.from_rotation_vector(moment.rotation))
            geometry |= {"tool_axes": (a_CL @ np.array(tool)).tolist(), "twist_max_deg": 1000.0}
            geometry["joint_travel_deg"] = [*travel[:3], [-720.0, 720.0], [-170.0, 170.0], [-720.0, 720.0]]
    if kind == "link":
        centre = draws.uniform([0.3, -1.4, -0.8], [3.5, -0.5, 0.6])
        half = draws.uniform(0.1, 0.35, 3)
        bodies = [box(np.array([-1.0, -0.6, -0.6]), np.array([0.0, 0.6, 0.6])), box(centre - half, centre + half)]
        tables = [{"on": "lab", "vertices_m": each} for each in bodies]
        plate = {"on": "turntable", "vertices_m": [[0.0, 0.0, 0.0]]}
        value = rig.value.model_dump(mode="json")
        value["bench"]["bodies"] = [plate, *tables]
        return scenario, Loaded(Rig.model_validate(value, strict=False), rig.source, rig.origin)
    return scenario, load_rig(RIG, [f"rig.arm.kuka_rsi.geometry.{key}={json.dumps(v)}" for key, v in geometry.items()])


def for_the_judge(scenario: Scenario, rig: Rig) -> dict[str, Any]:
    """Return the plan and the robot as numbers."""
    assert rig.arm is not None
    plan = axis_demands(scenario, rig).plan
    return {
        "geometry": json.loads(rig.arm.settings.geometry.model_dump_json()),
        "bodies": [[[*map(list, b.vertices_m)], b.radius_m] for b in rig.bench.bodies if b.on == "lab"],
        "least_m": rig.bench.bodies_distance_m,
        "plan": [[s.t_s, s.abort_s, *s.r_CT_H.tolist(), *s.rotation.tolist()] for s in plan],
    }


@pytest.mark.slow
@pytest.mark.skipif(JUDGE is None, reason="ROBOTICS_TOOLBOX_PYTHON names no Python that has roboticstoolbox-python")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_plans_are_refused_that_a_judge_calls_impossible_and_no_others(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    draws, refusals, kinds, lines = np.random.default_rng(seed), [], [], []
    for number in range(PLANS):
        kinds.append(KINDS[number % len(KINDS)])
        scenario, rig = drawn(draws, kinds[-1])
        refusals.append([str(problem) for problem in check_arm(scenario, rig)])
        lines.append(json.dumps(for_the_judge(scenario.value, rig.value)))
    (tmp_path / "plans.json").write_text("\n".join(lines), encoding="utf-8")
    command = [str(JUDGE), str(Path(__file__).with_name("plan_judge.py")), str(tmp_path / "plans.json")]
    answers = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    wrong, undecided, counts = [], 0, Counter[str]()
    for kind, refusal, answer in zip(kinds, refusals, answers, strict=True):
        margin, name = json.loads(answer)
        assert len(refusal) <= 1
        assert "\n" not in "".join(refusal)
        undecided += abs(margin) < UNDECIDED
        counts[name if refusal else "accepted"] += 1
        if abs(margin) >= UNDECIDED and (margin < 0.0) != bool(refusal):
            wrong.append((kind, margin, name, refusal))
    with capsys.disabled():
        sys.stdout.write(f"\nseed {seed}: {dict(counts)}, {undecided} within {UNDECIDED} deg or cm of a limit\n")
    assert wrong == []
    assert undecided < 0.05 * PLANS
    assert PLANS < 100 or {"wrist", "twist", "link", "reach"} <= set(counts)
