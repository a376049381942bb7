"""Scenarios of published missions: the truth has the published numbers (docs/explanation/missions.md)."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest

import hil
from hil.config.load import load_scenario
from hil.core.messages import Array
from hil.params.dynamics import mean_motion

FOOT = 0.3048
pytestmark = pytest.mark.xdist_group("campaign")


@lru_cache(maxsize=5)
def flown(name: str) -> tuple[Array, Array, Array, Array]:
    """Return times, s, positions (n, 3), m, ranges, m, and closing rates, m/s, of an accepted run."""
    run = hil.run(name)
    assert run.accepted
    r, v = np.asarray(run.truth.r_CT_H), np.asarray(run.truth.v_CT_H)
    ranges = np.linalg.norm(r, axis=1)
    return np.asarray(run.t_s), r, ranges, -np.sum(r * v, axis=1) / ranges


def cruise(name: str, low: float, high: float) -> Array:
    """Return the closing rates between the ranges ``low`` and ``high``, m/s."""
    _, _, ranges, closing = flown(name)
    return closing[(ranges > low) & (ranges < high)]


def test_shuttle_closes_from_thirty_feet_with_a_tenth_of_a_foot_per_second() -> None:
    t_s, _, ranges, _ = flown("shuttle-vbar")
    assert ranges[0] == pytest.approx(30.0 * FOOT, abs=0.1)
    assert np.median(cruise("shuttle-vbar", 1.0, 8.0)) == pytest.approx(0.1 * FOOT, rel=0.1)
    arrived = t_s[np.argmax(ranges < 0.41)]
    assert arrived == pytest.approx((30.0 * FOOT - 0.4) / (0.1 * FOOT), rel=0.05)
    scenario = load_scenario("shuttle-vbar").value
    assert scenario.chaser.mass_kg == pytest.approx(120.0 * 907.185, rel=0.01)
    assert scenario.orbit.altitude_m == pytest.approx(220.0 * 1609.344, rel=0.01)


def test_torva_turns_about_the_target_at_twice_orbital_rate() -> None:
    t_s, r, ranges, _ = flown("torva")
    angle = np.degrees(np.arctan2(r[:, 2], r[:, 0]))
    top = int(np.argmax(angle))
    twice = 2.0 * math.degrees(mean_motion(load_scenario("torva").value.orbit))
    on_arc = (np.arange(len(t_s)) > top) & (angle > 2.0) & (angle < 18.0)
    rate = np.polyfit(t_s[on_arc], -angle[on_arc], 1)[0]
    assert rate == pytest.approx(twice, rel=0.03)
    assert t_s[on_arc][-1] - t_s[on_arc][0] == pytest.approx(16.0 / twice, rel=0.05)
    of_range = ranges[-1] / ranges[top]
    assert of_range == pytest.approx(400.0 / (400.0 + 200.0 * 20.0 / 90.0), rel=0.01)


def test_ets_vii_holds_at_two_metres_for_a_quarter_of_an_hour_and_closes_with_a_centimetre_per_second() -> None:
    t_s, _, ranges, _ = flown("ets-vii")
    left = t_s[np.argmax(ranges < 1.97)]
    assert left == pytest.approx(900.0, abs=10.0)
    assert np.abs(ranges[t_s < 900.0] - 2.0).max() < 0.05
    assert np.median(cruise("ets-vii", 0.6, 1.8)) == pytest.approx(0.01, rel=0.1)
    scenario = load_scenario("ets-vii").value
    assert (scenario.orbit.altitude_m, scenario.orbit.inclination_deg) == (550e3, 35.0)
    assert scenario.chaser.mass_kg == 2540.0


def test_atv_closes_from_its_last_hold_below_seven_centimetres_per_second() -> None:
    _, r, ranges, closing = flown("atv")
    assert ranges[0] == pytest.approx(12.0, abs=1.0)
    assert closing.max() < 0.07
    assert np.hypot(r[-1500:, 1], r[-1500:, 2]).max() < 0.1


def test_apollo_closes_within_what_its_docking_system_takes() -> None:
    _, r, _, _ = flown("apollo")
    rates = cruise("apollo", 1.0, 9.0)
    assert np.median(rates) >= 0.1 * FOOT
    assert rates.max() <= 1.0 * FOOT
    assert np.hypot(r[-1500:, 1], r[-1500:, 2]).max() < FOOT
    assert load_scenario("apollo").value.orbit.altitude_m == pytest.approx(111e3, rel=0.01)
