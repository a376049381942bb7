"""Closed loop about a target on an ellipse: the filters are consistent if the GNC has its elements."""

from __future__ import annotations

import numpy as np
import pytest

import hil
from hil.config.load import load_scenario
from hil.errors import BadInput
from hil.parts.campaigns.dispersions import Design


@pytest.mark.parametrize("eccentricity", [0.005, 0.09])
def test_filters_are_consistent_on_an_ellipse(eccentricity: float) -> None:
    found = hil.run("scheme-1", overrides={"orbit.eccentricity": eccentricity, "orbit.true_anomaly_deg": 60.0})
    assert found.passed
    assert np.nanmean(found.history["nees_attitude"]) < 12.0  # 6 expected, correlated in time
    assert np.nanmean(found.history["nees_position"]) < 18.0  # 9 expected


def test_gnc_that_takes_the_ellipse_for_a_circle_is_found_inconsistent() -> None:
    wrong = {"orbit.eccentricity": 0.005, "orbit.true_anomaly_deg": 60.0, "gnc.ephemeris.eccentricity_error": -0.005}
    assert np.nanmean(hil.run("scheme-1", overrides=wrong).history["nees_attitude"]) > 100.0


def test_case_of_a_campaign_gives_the_gnc_the_dispersed_orbit_with_the_errors_of_its_ephemeris() -> None:
    scenario = load_scenario(
        "scheme-1",
        [
            "orbit.eccentricity=0.01",
            'dispersions.gnc.ephemeris.true_anomaly_error_deg={kind="normal", sigma=0.1}',
        ],
    )
    design = Design(scenario, 1)
    truth, known = design.apply(design.values(3))
    assert known.orbit == truth.orbit
    assert known.orbit.true_anomaly_deg != scenario.value.orbit.true_anomaly_deg
    assert known.gnc.ephemeris.true_anomaly_error_deg != 0.0
    assert known.initial == scenario.value.initial


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("gnc.ephemeris.eccentricity_error=-0.01", "-0.01: the GNC would have -0.01, allowed 0 to 0.7"),
        ("gnc.ephemeris.semi_major_axis_error_m=-1e6", "-1e+06: the GNC would have an orbit inside the Moon"),
    ],
)
def test_impossible_ephemeris_is_rejected(setting: str, text: str) -> None:
    key, value = setting.split("=")
    with pytest.raises(BadInput, match=r"gnc\.ephemeris") as caught:
        hil.run("scheme-1", overrides={key: float(value)})
    assert text in str(caught.value)
