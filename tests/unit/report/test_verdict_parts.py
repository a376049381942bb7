"""Energy and security by hand: impulsive least, drift, margins up to an abort."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import CYCLE, new
from hil.loop.compiled.run_stats import NAVIGATION_SUMS, counted
from hil.params import gnc as gnc_params
from hil.params.dynamics import mean_motion
from hil.report.results import Security
from hil.report.verdict_parts import (
    AbortCourse,
    drift,
    drift_over_an_orbit,
    energy_part,
    impulsive_bound,
    navigation_numbers,
    security_part,
    slew_impulse,
)


def test_errors_of_the_navigation_are_root_mean_squares_once_settled() -> None:
    sums = new(NAVIGATION_SUMS)
    sums.estimates[:] = 2, 4
    sums.square_error[1] = [0.04, 0.16, 0.36, 1.0, 4.0, 9.0, 1e-4, 4e-4, 9e-4]
    sums.square_sigma[1] = 0.16
    sums.updates[1], sums.nees[1] = (5, 10), (45.0, 60.0)
    numbers = navigation_numbers(sums)
    assert numbers["position_rmse_m"] == pytest.approx([0.1, 0.2, 0.3])
    assert numbers["velocity_rmse_mps"] == pytest.approx([0.5, 1.0, 1.5])
    assert numbers["attitude_rmse_deg"] == pytest.approx(np.degrees([0.005, 0.01, 0.015]))
    assert numbers["position_sigma_m"] == pytest.approx([0.2] * 3)
    assert (numbers["nees_pkf"], numbers["nees_akf"]) == (9.0, 6.0)
    sums.estimates[1] = 0  # a run that ended before
    sums.square_error[0] = 0.5
    assert navigation_numbers(sums)["position_rmse_m"] == pytest.approx([0.5] * 3)


def flight(n: int = 100) -> np.ndarray:
    """Return a history in which the chaser stands on its line, 3 m out, upright, at full mass."""
    history = np.zeros(n, CYCLE)
    history["t_s"] = 0.02 * np.arange(n)
    for name in ("truth", "navigation"):
        history[name]["r_CT_H"] = [3.0, 0.0, 0.0]
    history["truth"]["q_CH"][:, 3] = 1.0
    history["truth"]["mass_kg"] = 1000.0
    history["reference"]["from_H"] = [5.0, 0.0, 0.0]
    history["reference"]["to_H"] = [0.4, 0.0, 0.0]
    return history


def line_mps(v_CT_H: np.ndarray, scenario: Scenario) -> float:
    """Return what the reference's changes of velocity come to, m/s, with the velocities (n, 3)."""
    history = flight(len(v_CT_H))
    history["reference"]["v_CT_H"] = v_CT_H
    return float(counted(history, scenario).reference_delta_v)


def security(history: np.ndarray, scenario: Scenario) -> Security:
    return security_part(counted(history, scenario))


def test_line_from_rest_to_rest_costs_twice_its_speed_whatever_its_ramps(scheme_1: Scenario) -> None:
    for ramp in (2, 50):
        speed = np.concatenate([np.linspace(0.0, 0.03, ramp), np.full(20, 0.03), np.linspace(0.03, 0.0, ramp)])
        along = np.array([0.6, -0.8, 0.0])
        assert line_mps(speed[:, None] * along, scheme_1) == pytest.approx(0.06)


def test_corner_without_a_stop_costs_the_change_of_direction(scheme_1: Scenario) -> None:
    assert line_mps(np.array([[0.03, 0.0, 0.0], [0.0, 0.04, 0.0]]), scheme_1) == pytest.approx(0.03 + 0.05)


def test_slews_cost_twice_the_angular_momentum_of_a_steady_turn(scheme_1: Scenario) -> None:
    # 3 deg in 10 s; J 900, 1100, 1050 kg m^2; sets of two 5 N thrusters on 1 m arms: 10 N for 10 N m
    rate = math.radians(3.0) / 10.0
    assert slew_impulse(scheme_1) == pytest.approx(2.0 * rate * (900.0 + 1100.0 + 1050.0))


def test_energy_is_judged_against_three_times_the_least(scheme_1: Scenario) -> None:
    history = flight()
    history["reference"]["v_CT_H"][20:60, 0] = -0.03
    history["truth"]["thrust_fraction"][10:80:10, 2] = 0.5
    exhaust = 220.0 * 9.80665
    least = 1000.0 * (1.0 - math.exp(-(0.06 + slew_impulse(scheme_1) / 1000.0) / exhaust))
    for spent, passed in ((2.99 * least, True), (3.01 * least, False)):
        found = energy_part(counted(history, scheme_1), scheme_1, spent)
        assert found.passed is passed
        assert found.least_propellant_kg == pytest.approx(least)
        assert found.delta_v_mps == pytest.approx(-exhaust * math.log(1.0 - spent / 1000.0))
        assert found.firings == 7


def test_security_is_judged_on_the_truth_and_names_the_tightest_moment(scheme_1: Scenario) -> None:
    history = flight()
    assert security(history, scheme_1).passed
    history["truth"]["r_CT_H"][40] = [3.0, 0.3, 0.0]
    found = security(history, scheme_1)
    assert not found.passed
    assert found.corridor_margin_m == pytest.approx(math.hypot(3.0, 0.3) * math.tan(math.radians(5.0)) - 0.3)
    assert found.corridor_margin_at_s == pytest.approx(0.8)
    history = flight()
    history["truth"]["v_CT_H"][10, 0] = -0.041
    found = security(history, scheme_1)
    assert not found.passed
    assert found.closing_margin_mps == pytest.approx(-0.001)


def test_security_is_judged_up_to_the_abort_alone(scheme_1: Scenario) -> None:
    history = flight()
    history["supervision"]["aborted"][50:] = 3
    history["reference"]["phase"][50:80] = 3
    history["reference"]["phase"][80:] = 4
    history["truth"]["r_CT_H"][60:] = [4.0, 2.0, 0.0]
    assert security(history, scheme_1).passed
    followed = AbortCourse(scheme_1)
    for rows in np.split(history, [3, 45, 70, 85]):
        followed.add(rows)
    abort = followed.course()
    assert abort is not None
    assert (abort.at_s, abort.range_m, abort.cause) == (pytest.approx(1.0), pytest.approx(3.0), "ordered")
    assert abort.hold_since_s == pytest.approx(1.6)
    assert abort.drift_from_end["from_s"] == pytest.approx(history["t_s"][-1])


@pytest.mark.parametrize("e", [0.0, 0.05])
def test_drift_is_that_of_the_integrated_motion(scheme_1: Scenario, rng: np.random.Generator, e: float) -> None:
    r, v, n = np.array([5.0, 0.2, -0.1]), 1e-3 * rng.standard_normal(3), mean_motion(scheme_1.orbit)
    target = scheme_1.orbit.model_copy(update={"eccentricity": e, "true_anomaly_deg": 40.0})

    def derivative(_t: float, y: np.ndarray) -> list[float]:
        rho = 1.0 + e * math.cos(y[6])
        w, k = n * rho**2 / (1.0 - e**2) ** 1.5, (n * (rho / (1.0 - e**2)) ** 1.5) ** 2
        turning = -2.0 * e * math.sin(y[6]) * w**2 / rho  # of w, by the time
        along = 2.0 * w * y[5] + turning * y[2] + (w**2 - k) * y[0]
        return [*y[3:6], along, -k * y[1], -2.0 * w * y[3] - turning * y[0] + (w**2 + 2.0 * k) * y[2], w]

    row = flight(1)[0]
    row["truth"]["r_CT_H"], row["truth"]["v_CT_H"] = r, v
    t_s, start = np.linspace(0.0, 2.0 * math.pi / n, 721), [*r, *v, math.radians(40.0)]
    truth = solve_ivp(derivative, (0.0, t_s[-1]), start, t_eval=t_s, rtol=1e-12, atol=1e-13).y[:3].T
    np.testing.assert_allclose(drift(r, v, target, math.radians(40.0), t_s), truth, atol=1e-6)
    found = drift_over_an_orbit(row, target)
    np.testing.assert_allclose(found["after_one_orbit_m"], truth[-1], atol=1e-6)
    assert found["nearest_m"] == pytest.approx(np.linalg.norm(truth, axis=1).min(), abs=1e-6)


def test_drift_from_rest_on_the_v_bar_stays_there(scheme_1: Scenario) -> None:
    row = flight(1)[0]
    found = drift_over_an_orbit(row, scheme_1.orbit)
    assert found["nearest_m"] == pytest.approx(3.0)
    assert found["farthest_m"] == pytest.approx(3.0)
    assert found["orbit_s"] == pytest.approx(2.0 * math.pi / mean_motion(scheme_1.orbit))


def test_parts_of_a_run_without_a_cycle_are_not_passed(scheme_1: Scenario) -> None:
    assert not security(flight(0), scheme_1).passed
    assert not energy_part(counted(flight(0), scheme_1), scheme_1, 0.0).passed


def test_abort_acceleration_is_within_what_the_thrusters_give(scheme_1: Scenario) -> None:
    _, strength = gnc_params.allocation(scheme_1.chaser)
    abort = scheme_1.gnc.abort
    assert gnc_params.guidance(scheme_1).brake == abort.brake_mps2
    assert abort.brake_mps2 < strength[6] / scheme_1.chaser.mass_kg
    # from the greatest closing rate the chaser stops within 0.05 m
    assert scheme_1.gnc.corridor.closing_rate_max_mps**2 / (2.0 * abort.brake_mps2) < 0.05


def moved(scenario: Scenario, duration_s: float) -> np.record:
    """Return RUN_STATS of a reference that stands at 10 m and, in its next phase, at 6 m after ``duration_s``."""
    history = flight(4)
    history["t_s"] = [0.0, 1.0, 1.0 + duration_s, 2.0 + duration_s]
    history["reference"]["phase"] = [0, 1, 2, 2]
    history["reference"]["r_CT_H"][:2, 0], history["reference"]["r_CT_H"][2:, 0] = 10.0, 6.0
    return counted(history, scenario)


def test_bound_of_a_short_move_is_twice_its_mean_speed_and_of_an_orbit_what_drifts_there(scheme_1: Scenario) -> None:
    n = mean_motion(scheme_1.orbit)
    assert impulsive_bound(moved(scheme_1, 20.0), scheme_1) == pytest.approx(2.0 * 4.0 / 20.0, rel=0.01)
    orbit = impulsive_bound(moved(scheme_1, 2.0 * math.pi / n), scheme_1)
    assert orbit == pytest.approx(2.0 * n * 4.0 / (6.0 * math.pi), rel=0.01)
    found = energy_part(moved(scheme_1, 20.0), scheme_1, 1.0)
    slews = slew_impulse(scheme_1) / 1000.0
    assert found.impulsive_bound_kg == pytest.approx(1000.0 * (0.4 + slews) / (220.0 * 9.80665), rel=0.01)


def test_axes_that_tumble_have_no_impulsive_bound() -> None:
    tumbling = load_scenario("tumbling-1").value
    assert energy_part(moved(tumbling, 20.0), tumbling, 1.0).impulsive_bound_kg is None


def test_transfer_costs_its_burns_and_not_what_the_orbit_changes() -> None:
    scenario = load_scenario("transfer").value
    history = flight(200)
    history["reference"]["phase"] = 1
    history["reference"]["v_CT_H"][:, 2] = np.linspace(0.0, 0.2, 200)
    history["reference"]["a_CT_H"][50:100, 0] = -0.006
    assert counted(history, scenario).reference_delta_v == pytest.approx(50 * 0.02 * 0.006)
