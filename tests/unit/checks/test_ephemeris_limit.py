"""How long the GNC's orbit is good for: stated before a run, and when vision is accused in the closed loop."""

from __future__ import annotations

import math

import pytest

import hil
from hil.checks import ephemeris
from hil.checks.ephemeris import EphemerisLimit, check_length, ephemeris_limit, ephemeris_warnings
from hil.checks.truth import check_truth
from hil.config.load import load_rig, load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.loop.compiled.run_stats import SETTLED
from hil.parts.campaigns.case_runner import CaseRunner
from hil.report.verdict_parts import navigation_means

RIG = load_rig("mock").value
HOLD_S = 18000.0


def test_line_before_a_run_names_the_limit_and_the_key() -> None:
    scenario = load_scenario("scheme-1").value
    (line,) = ephemeris_warnings(scenario, RIG, HOLD_S)
    assert line.startswith("the GNC's orbit is good for 2.4 h of 5 h, by the noise of the poses 2.2 to 3.3: ")
    assert "gnc.ephemeris.gravity_degree is 0, truth.gravity_degree 8" in line


@pytest.mark.parametrize("name", ["scheme-1", "leo-vbar", "geo", "tumbling-3", "planar"])
def test_shipped_runs_are_within_the_limit(name: str) -> None:
    scenario = load_scenario(name).value
    assert ephemeris_warnings(scenario, RIG, scenario.duration_s) == []


def test_orbit_with_the_harmonics_of_the_truth_is_good_for_the_whole_hold() -> None:
    perturbed = load_scenario("scheme-1", ("gnc.ephemeris.gravity_degree=8",)).value
    limit = ephemeris_limit(perturbed, RIG, HOLD_S, None)
    assert limit is not None
    assert math.isinf(limit.good_for_s)
    assert math.degrees(limit.error_radps) < 1e-9


def test_vision_is_accused_at_the_limit() -> None:
    scenario, length_s = load_scenario("leo-vbar").value, 4400.0
    runner = CaseRunner(scenario, RIG, length_s)
    for seed in (0, 4):
        limit = ephemeris_limit(scenario, RIG, length_s, seed)
        stats, _ = runner.run(scenario, seed)
        assert limit is not None
        assert float(stats.integrity.limits.aborted_at_s) == pytest.approx(limit.good_for_s, rel=0.02)


def test_line_states_the_nees_of_a_run_that_no_alarm_ends() -> None:
    scenario = load_scenario("leo-vbar", ("duration_s=5000",)).value
    limit = ephemeris_limit(scenario, RIG, 5000.0, None)
    assert limit is not None
    assert math.isinf(limit.good_for_s)
    (line,) = ephemeris_warnings(scenario, RIG, 5000.0)
    assert f"mean NEES {limit.nees:.2g}, 6 expected" in line
    stats, _ = CaseRunner(scenario, RIG, 5000.0).run(scenario, 0)
    assert navigation_means(stats.navigation, SETTLED)["nees_akf"] == pytest.approx(limit.nees, rel=0.2)


def test_filters_follow_the_harmonics_of_their_ephemeris() -> None:
    perturbed = ("gnc.ephemeris.gravity_degree=6", "gnc.ephemeris.rate_sigma_degps=[0,3e-7,1e-8]")
    scenario, length_s = load_scenario("leo-vbar", perturbed).value, 4400.0
    stats, _ = CaseRunner(scenario, RIG, length_s).run(scenario, 4)
    assert not stats.integrity.limits.aborted
    means = navigation_means(stats.navigation, SETTLED)
    assert means["nees_akf"] < 12.0  # mean 6, of few independent samples; 77 about a point mass


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (("truth.relative_motion=hill", "truth.gravity_degree=0"), 'truth.relative_motion = "nonlinear"'),
        (("gnc.ephemeris.gravity_degree=9",), "9: too high for the field of the Moon, allowed 0 to 8"),
    ],
)
def test_harmonics_that_do_not_act_are_refused(settings: tuple[str, ...], text: str) -> None:
    problems = check_truth(load_scenario("scheme-1", ("gnc.ephemeris.gravity_degree=8", *settings)))
    assert [problem.key for problem in problems] == ["gnc.ephemeris.gravity_degree"]
    assert text in problems[0].message


def test_run_that_is_longer_than_the_ephemeris_is_refused() -> None:
    perturbed = load_scenario("scheme-1", ("gnc.ephemeris.gravity_degree=8",))
    assert check_length(perturbed, 90_000.0) == []
    (problem,) = check_length(perturbed, 110_000.0)
    assert problem.message == "8: the ephemeris reaches to 99718 s, the run to 110000 s, allowed 0"


def test_limit_is_computed_once_for_a_complete_run_and_again_for_one_that_broke_off(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    lengths_s: list[float] = []

    def counted(scenario: Scenario, rig: Rig, length_s: float, seed: int | None) -> EphemerisLimit | None:
        lengths_s.append(length_s)
        return ephemeris_limit(scenario, rig, length_s, seed)

    monkeypatch.setattr(ephemeris, "ephemeris_limit", counted)
    hil.run("leo-vbar", duration_s=1.0)
    assert lengths_s == [1.0]
    lengths_s.clear()
    broken = hil.run(
        "leo-vbar", duration_s=1.0, faults=[{"device": "rails.x", "kind": "offset", "value": 1.0, "at_s": 0.5}]
    )
    assert broken.stop != "completed"
    assert lengths_s[0] == 1.0
    assert lengths_s[1] < 1.0
