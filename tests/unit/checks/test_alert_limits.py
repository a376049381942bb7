"""Alert limits below the noise of the vision unit are rejected before a run."""

from __future__ import annotations

import pytest

from hil.checks.compatibility import check_approach
from hil.config.load import load_scenario


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        (
            "integrity.alert_attitude_deg=0.09",
            "0.09: the alert limit at the ready point is 0.09 deg and must be at least",
        ),
        ("integrity.alert_corridor_fraction=0.1", "0.01 m and must be at least 0.015 m, 3 sigma of a pose"),
    ],
)
def test_alert_limit_below_the_noise_is_rejected(setting: str, text: str) -> None:
    (problem,) = check_approach(load_scenario("scheme-1", [setting]))
    assert (problem.source, problem.key) == ("--set", setting.partition("=")[0])
    assert text in problem.message


def test_axial_limit_below_the_noise_is_rejected() -> None:
    settings = ["integrity.alert_axial_m=0.01", "integrity.alert_axial_per_range_scale=0.01"]
    (problem,) = check_approach(load_scenario("scheme-1", settings))
    assert problem.key == "integrity.alert_axial_m"


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3", "scheme-1-printed"])
def test_shipped_limits_are_above_the_noise(scheme: str) -> None:
    assert check_approach(load_scenario(scheme)) == []


def test_vision_alone_reports_no_protection_level_that_could_exceed_a_limit() -> None:
    settings = ["integrity.alert_attitude_deg=0.01", 'gnc.navigation.backend="vision_alone"']
    assert check_approach(load_scenario("scheme-1", settings)) == []
