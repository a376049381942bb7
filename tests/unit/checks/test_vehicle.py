"""Vehicle against plan: what thrusters give, plans that they cannot follow, and what a go needs of firings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.checks.go_level import go_warnings, predicted_hold
from hil.checks.vehicle import authority, check_vehicle, phase_demands
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.report.authority_figure import polygon

RIG = load_rig("mock").value
CUBESAT = (
    "chaser.mass_kg=50.0",
    "chaser.inertia_kg_m2=[[4.0,0.0,0.0],[0.0,4.0,0.0],[0.0,0.0,4.0]]",
    "chaser.thrusters.force_n=0.05",
)


def test_authority_is_that_of_sets_masses_and_declared_scatter() -> None:
    given = authority(load_scenario("scheme-1", ("truth.force_scatter_sigma=0.0",)).value)
    np.testing.assert_allclose(given.demand[:3], 0.01)  # two thrusters of 5 N move a ton
    np.testing.assert_allclose(given.full, [0.02, 0.01, 0.01])
    assert (given.dead > 0.0).all()
    scattered = authority(load_scenario("scheme-1", ("truth.force_scatter_sigma=0.1",)).value)
    np.testing.assert_allclose(scattered.demand / given.demand, 1.0 - 3.0 * 0.1 / np.sqrt(2.0))


@pytest.mark.parametrize("name", ["scheme-1", "scheme-2", "scheme-3", "leo-vbar", "inspection", "transfer"])
def test_shipped_plans_are_within_what_the_thrusters_give(name: str) -> None:
    scenario = load_scenario(name)
    assert check_vehicle(scenario) == []
    assert all(each.needed_mps2 <= each.given_mps2 for each in phase_demands(scenario.value))


@pytest.mark.parametrize("settings", [("chaser.thrusters.force_n=0.5",), CUBESAT, ("chaser.mass_kg=12000.0",)])
def test_plan_that_the_thrusters_cannot_follow_is_refused_with_both_numbers(settings: tuple[str, ...]) -> None:
    (problem,) = check_vehicle(load_scenario("scheme-1", settings))
    assert problem.key == "gnc.guidance.deceleration_mps2"
    assert "phase approach takes 0.00797 m/s2 along x, chaser.thrusters give" in str(problem)
    gentle = ("gnc.guidance.acceleration_mps2=0.001", "gnc.guidance.deceleration_mps2=0.0005")
    assert check_vehicle(load_scenario("scheme-1", (*settings, *gentle))) == []


def test_plan_that_takes_more_than_a_demand_opens_all_thrusters_that_push() -> None:
    settings = ("chaser.thrusters.force_n=3.0",)
    each = phase_demands(load_scenario("scheme-1", settings).value)[0]
    assert (each.phase, each.axis) == ("approach", 0)
    assert each.given_mps2 == pytest.approx(0.012, rel=0.03)
    assert check_vehicle(load_scenario("scheme-1", settings)) == []


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ((), None),
        (("requirements.angular_rate_degps=0.01",), "the smallest firing changes the rate about x by 0.013 deg/s"),
        (("chaser.thrusters.minimum_on_s=3.0",), "the smallest firing changes the rate along x by 0.03 m/s"),
    ],
)
def test_vehicle_that_can_never_have_a_go_is_named_before_the_run(settings: tuple[str, ...], text: str | None) -> None:
    lines = go_warnings(load_scenario("scheme-1", settings).value, RIG)
    assert (lines == []) if text is None else any(text in line for line in lines)


def test_limit_cycle_takes_its_propellant_at_half_a_firings_change_of_rate() -> None:
    (x, *_) = predicted_hold(load_scenario("scheme-1").value, RIG)
    assert x.period_s == pytest.approx(8.0 * x.amplitude / x.change)
    per_cycle_kg = 2.0 * 2 * 5.0 * 0.02 / (220.0 * 9.80665)
    assert x.propellant_kgph == pytest.approx(3600.0 / x.period_s * per_cycle_kg)


def test_polygon_of_opposed_pairs_is_their_box() -> None:
    corners = polygon(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 2.0], [0.0, -2.0]]))
    assert (corners.min(axis=0).tolist(), corners.max(axis=0).tolist()) == ([-1.0, -2.0], [1.0, 2.0])


def test_page_has_the_numbers_and_refuses_what_cannot_be_flown(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    image = tmp_path / "authority.svg"
    assert execute(["vehicle", "scheme-1", "--json", "-", "--image", str(image)]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {row["axis"] for row in found["authority"]} == {
        f"{how} {axis}" for how in ("along", "about") for axis in "xyz"
    }
    assert found["abort"]["flown_mps2"] == pytest.approx(0.018)
    assert found["no_go"] == []
    assert image.read_text().startswith("<?xml")
    assert execute(["vehicle", "scheme-1", "--set", "chaser.thrusters.force_n=0.5"]) == 2
    assert "chaser.thrusters give 0.00196" in capsys.readouterr().err
