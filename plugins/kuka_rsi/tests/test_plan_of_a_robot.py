"""Plans that the robot cannot follow are refused before motion, in one line; on a mock rig, too."""

from __future__ import annotations

from pathlib import Path

import pytest

import hil_kuka_rsi
from hil.checks.arm import check_arm
from hil.config.load import load_rig, load_scenario
from hil.errors import BadInput

RIG = str(Path(hil_kuka_rsi.__file__).parent / "rigs" / "emulated-arm-kuka.toml")
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
    assert "s of the plan" in problem.message


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (['rig.turntable.driver="cia402"'], 'turntable.driver = "cia402": does not go with [arm], allowed "arm"'),
        (["rig.rails.y.fixed_m=0.0"], 'driver "arm": drives x, y, z, here x, z'),
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
