"""Plans that a robot cannot follow are refused before motion, in one line, and stopped in the cycle, also on a mock."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil_kuka_rsi
from hil.checks.arm import check_arm
from hil.checks.before_run import unseen_warnings
from hil.config.load import load_rig, load_scenario
from hil.drivers.arm.mock import MockRobots
from hil.errors import BadInput, DeviceError
from hil.parts.campaigns.python_cases import case_runner

RIGS = Path(hil_kuka_rsi.__file__).parent / "rigs"
RIG, TWO_ARMS = str(RIGS / "emulated-arm-kuka.toml"), str(RIGS / "emulated-two-arms.toml")
MOCK = ['rig.kind="mock"', *(f'rig.{device}.driver="mock"' for device in ("rails", "turntable", "vmu", "io"))]
KEY = "rig.arm.kuka_rsi.geometry"
SIDEWAYS = "[[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]"

WIDE = f"{KEY}.joint_travel_deg=[[-185.0, 185.0], [-130.0, 20.0], [-100.0, 144.0], [-350.0, 350.0], [-170.0, 170.0], "
REFUSED = {
    "the wrist is ": [f"{KEY}.base_m=[3.0, -4.0, -1.0]"],
    "joint 6 at ": [f"{WIDE}[90.0, 350.0]]"],
    "joints 4 and 6 twist the cables by ": [f"{KEY}.twist_max_deg=40.0"],
    "deg from a singular wrist": [
        f"{KEY}.tool_axes={SIDEWAYS}", f"{WIDE}[-350.0, 350.0]]", f"{KEY}.wrist_angle_min_deg=45.0"
    ],
    "the elbow is bent by ": [f"{KEY}.base_m=[3.0, -2.6, -1.0]"],
    "the forearm would be ": [f"{KEY}.link_radius_m=0.8"],
    "0: leaves 12 ms of arm.lag_s, 0.358 mm": ["rig.arm.lag_s=0.012", "rig.rails.x.lead_s=0.0"],
}  # fmt: skip
"""Part of the line that refuses scheme 1 -> settings."""


@pytest.mark.parametrize("kind", [[], MOCK], ids=["emulated", "mock"])
def test_plan_within_the_limits_passes(kind: list[str]) -> None:
    rig = load_rig(RIG, kind)
    assert check_arm(load_scenario("scheme-1"), rig) == []
    assert ("arm" in rig.value.device_tables()) == (not kind)


@pytest.mark.parametrize(("text", "settings"), REFUSED.items(), ids=REFUSED.keys())
def test_plan_beyond_a_limit_is_refused_in_one_line(text: str, settings: list[str]) -> None:
    (problem,) = check_arm(load_scenario("scheme-1"), load_rig(RIG, settings))
    assert "\n" not in str(problem)
    assert text in problem.message
    assert "of the plan" in problem.message


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (['rig.turntable.driver="cia402"'], 'turntable.driver = "cia402": does not go with [arm], allowed "arm"'),
        (
            ['rig.turntable.controllers=[{axes=["roll"], driver="cia402"}]'],
            "turntable.controllers: do not go with [arm]",
        ),
        (['rig.linear_axes.lamp={driver="arm", place_m=[0.0], x={travel_m=[0.0, 1.0]}}'], "linear_axes.lamp"),
        ([f"{KEY}.signs=[1, 1, 1, 1, 1, 2]"], "signs"),
        ([f"{KEY}.base_axes=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]"], "right-handed"),
    ],
)
def test_wrong_rig_is_refused(settings: list[str], text: str) -> None:
    with pytest.raises(BadInput) as refused:
        load_rig(RIG, settings)
    assert text in str(refused.value)


def test_rails_without_a_robot_are_refused() -> None:
    with pytest.raises(BadInput, match=r'rails.driver = "arm": needs the table \[arm\] of the robot'):
        load_rig("emulated", ['rig.rails.driver="arm"'])


def test_what_the_lag_costs_is_said_before_the_run_and_so_is_a_lag_that_is_not_known() -> None:
    scenario = load_scenario("scheme-1").value
    (line,) = unseen_warnings(scenario, load_rig(RIG, ["rig.arm.lag_s=0.005"]).value)
    assert line.startswith("rig.")
    assert "leaves 2 ms of arm.lag_s" in line
    rig = load_rig(RIG).value
    assert rig.arm is not None
    without = rig.model_copy(update={"arm": rig.arm.model_copy(update={"lag_s": None})})
    (line,) = unseen_warnings(scenario, without)
    assert line == "arm.lag_s is not set: what the lag costs is unknown"


def test_axes_in_memory_fail_at_a_limit_of_their_robot() -> None:
    rig = load_rig(RIG, MOCK).value
    robots = MockRobots(rig)
    rails, turntable = robots.axes("rails", rig.rails), robots.axes("turntable", rig.turntable)
    for axes in (rails, turntable):
        axes.open(0.0)
    at, rest, now_s = np.array([3.0, 0.0, 0.0]), np.zeros(3), 0.0

    def approach_its_base() -> None:
        nonlocal now_s
        while at[1] > -0.9:
            rails.send(at, rest, now_s)
            turntable.send(rest, rest, now_s)
            turntable.read(now_s)
            at[1], now_s = at[1] - 0.005, now_s + 0.02

    with pytest.raises(DeviceError, match=r"^arm: .*allowed"):
        approach_its_base()
    assert -0.9 < at[1] < -0.1
    rails.open(now_s)
    turntable.open(now_s)
    assert rails.read(now_s).position == pytest.approx(at, abs=0.02)


@pytest.mark.parametrize("text", ["joints 4 and 6 twist the cables by ", "the wrist is "])
def test_case_in_memory_stops_in_the_cycle_at_a_limit_of_the_robot(text: str) -> None:
    rig = load_rig(RIG, [*REFUSED[text], *MOCK]).value
    _, stop = case_runner(load_scenario("scheme-1").value, rig, 2.0).run(load_scenario("scheme-1").value, 0)
    assert stop.startswith(f"arm: {text}")


def test_plan_of_two_robots_passes_and_each_of_them_is_named() -> None:
    scenario = load_scenario("tumbling-1")
    assert check_arm(scenario, load_rig(TWO_ARMS)) == []
    (problem,) = check_arm(scenario, load_rig(TWO_ARMS, ["rig.target_arm.kuka_rsi.geometry.base_m=[-4.5, 0.0, -1.0]"]))
    assert problem.message.startswith("target_arm: the wrist is ")
    (problem,) = check_arm(scenario, load_rig(TWO_ARMS, ["rig.target_arm.kuka_rsi.geometry.link_radius_m=0.9"]))
    assert " of arm, allowed from" in problem.message or "from body" in problem.message
