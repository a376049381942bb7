"""Twins are compared in their own sigmas."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.messages import CYCLE
from hil.report.comparison import divergences
from hil.report.figures import thin

STEP_S = 0.02


def flight(n: int = 500) -> np.ndarray:
    rows = np.zeros(n, CYCLE)
    rows["t_s"] = STEP_S * np.arange(n)
    rows["truth"]["q_CH"][:, 3] = 1.0
    rows["navigation"]["valid"] = 1
    for name in ("sigma_r_m", "sigma_v_mps", "sigma_attitude_rad"):
        rows["navigation"][name] = 0.003
    return rows


def test_a_run_against_itself_never_leaves(scheme_1: Scenario) -> None:
    found = divergences(flight(), flight(), scheme_1)
    assert len(found) == 9
    assert all((p.largest, p.sigmas, p.beyond, p.left_s) == (0.0, 0.0, 0.0, None) for p in found)


def test_where_and_by_how_much_a_twin_leaves(scheme_1: Scenario) -> None:
    other = flight()
    other["truth"]["r_CT_H"][100:110, 1] = 0.05  # too short to count as leaving
    other["truth"]["r_CT_H"][300:, 1] = 0.04
    found = {p.name: p for p in divergences(flight(), other, scheme_1)}["position y"]
    assert found.largest == pytest.approx(50.0)
    assert found.at_s == pytest.approx(2.0)
    control = scheme_1.gnc.control
    deadband = (control.deadband_m + control.deadband_sigmas * 0.003) / np.sqrt(3.0)  # equally likely anywhere in it
    assert found.sigmas == pytest.approx(0.05 / (np.hypot(0.003, deadband) * np.sqrt(2.0)))
    assert found.left_s == pytest.approx(6.0)
    assert found.beyond == pytest.approx(210 / 500)
    assert found.of_tolerance == pytest.approx(0.05 / scheme_1.requirements.radial_distance_m)


def test_without_sigmas_only_the_distance_is_reported(scheme_1: Scenario) -> None:
    a, b = flight(), flight(400)
    a["navigation"]["sigma_r_m"] = np.nan
    b["truth"]["r_CT_H"][:, 0] = 0.01
    found = divergences(a, b, scheme_1)[0]
    assert (found.sigmas, found.left_s) == (None, None)
    assert found.largest == pytest.approx(10.0)


def test_a_thinned_line_keeps_its_extremes(rng: np.random.Generator) -> None:
    values = rng.standard_normal(100_000)
    values[54_321] = 40.0
    values[54_322] = -50.0
    t_s, kept = thin(np.arange(100_000.0), values)
    assert len(kept) <= 1500
    assert (kept.max(), kept.min()) == (40.0, -50.0)
    assert t_s[np.argmax(kept)] == 54_321.0
