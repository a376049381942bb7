"""The ready phase and its verdict on made-up histories."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.scenario import Requirements, Scenario
from hil.core.messages import CYCLE
from hil.params.ready import ROW_NAMES, tolerances
from hil.report.verdict import Deviations, Verdict, deviations
from tests.support.verdicts import judge, ready_state

DT = 0.1
INSIDE = {"position_m": 0.01, "velocity_mps": 0.01, "attitude_deg": 0.2, "rate_degps": 0.05}
OUTSIDE = {"position_m": 0.2, "velocity_mps": 0.05, "attitude_deg": 2.0, "rate_degps": 0.5}


@pytest.fixture
def required(scheme_1: Scenario) -> Requirements:
    """Return Table III."""
    return scheme_1.requirements


def flown(seconds: float) -> Deviations:
    """Return a run that is inside all tolerances throughout."""
    n = round(seconds / DT) + 1
    return Deviations(np.arange(n) * DT, *(np.full((n, 3), INSIDE[name]) for name in ROW_NAMES))


def away(found: Deviations, begin_s: float, end_s: float, row: str = "position_m", axis: int = 0) -> Deviations:
    """Take one axis of ``found`` out of its tolerance for begin_s <= t < end_s."""
    inside = (found.t_s >= begin_s - 1e-9) & (found.t_s < end_s - 1e-9)
    getattr(found, row)[inside, axis] = -OUTSIDE[row]
    return found


def test_ready_phase_begins_when_the_dwell_is_over(required: Requirements) -> None:
    verdict = judge(away(flown(60.0), 0.0, 20.0), required)
    assert verdict.held_since_s == pytest.approx(20.0)
    assert verdict.ready_time_s == pytest.approx(20.0 + required.dwell_s)
    assert verdict.passed


def test_ready_phase_must_last(required: Requirements) -> None:
    for end_s, passed in ((55.0, True), (54.9, False)):
        verdict = judge(away(flown(end_s), 0.0, 20.0), required)
        assert verdict.passed == passed
        assert verdict.ready_duration_s == pytest.approx(end_s - 25.0)


def test_run_that_never_dwells_has_no_ready_phase(required: Requirements) -> None:
    found = flown(40.0)
    for begin_s in range(0, 40, 4):
        away(found, begin_s, begin_s + 0.1)
    assert judge(found, required) == Verdict(None, None, False, None)
    ready = ready_state(found, required)
    assert (ready.breaks[0], ready.break_s[0]) == (9, 4.0)  # the deviation that ended each dwell


def test_run_that_ends_before_the_dwell_is_over_has_no_ready_phase(required: Requirements) -> None:
    assert judge(away(flown(24.8), 0.0, 20.0), required).ready_time_s is None
    assert judge(away(flown(25.0), 0.0, 20.0), required).ready_time_s == pytest.approx(25.0)


def test_empty_history_has_no_ready_phase(required: Requirements) -> None:
    empty = np.empty((0, 3))
    assert judge(Deviations(np.empty(0), empty, empty, empty, empty), required).ready_time_s is None


@pytest.mark.parametrize("row", ROW_NAMES)
@pytest.mark.parametrize("axis", range(3))
def test_every_row_and_axis_alone_fails_a_run_that_leaves_after_ready(
    required: Requirements, row: str, axis: int
) -> None:
    found = away(away(flown(60.0), 0.0, 20.0), 50.0, 50.1, row, axis)
    verdict = judge(found, required)
    assert verdict.ready_time_s == pytest.approx(25.0)
    assert not verdict.passed
    assert verdict.worst is not None
    for name in ROW_NAMES:
        expected = np.full(3, INSIDE[name])
        if name == row:
            expected[axis] = OUTSIDE[name]
        np.testing.assert_allclose(verdict.worst[name], expected)


@pytest.mark.parametrize("row", ROW_NAMES)
@pytest.mark.parametrize("axis", range(3))
def test_every_row_and_axis_alone_delays_the_ready_phase(required: Requirements, row: str, axis: int) -> None:
    assert judge(away(flown(40.0), 0.0, 12.0, row, axis), required).held_since_s == pytest.approx(12.0)


def test_first_of_two_dwells_is_taken(required: Requirements) -> None:
    found = away(away(flown(80.0), 0.0, 10.0), 30.0, 40.0)
    verdict = judge(found, required)
    assert verdict.held_since_s == pytest.approx(10.0)
    assert not verdict.passed


def test_break_within_the_dwell_restarts_it_and_does_not_fail_the_run(required: Requirements) -> None:
    verdict = judge(away(away(flown(60.0), 0.0, 20.0), 24.0, 24.1), required)
    assert verdict.held_since_s == pytest.approx(24.1)
    assert verdict.passed


def test_worst_deviation_counts_from_the_ready_time_on(required: Requirements) -> None:
    found = away(flown(40.0), 0.0, 20.0)
    found.position_m[found.t_s < 24.95, 1] = 0.019  # within the tolerance, but still approach
    verdict = judge(found, required)
    assert verdict.worst is not None
    assert verdict.worst["position_m"][1] == pytest.approx(INSIDE["position_m"])


def test_nan_is_not_within_a_tolerance(required: Requirements) -> None:
    found = flown(40.0)
    found.rate_degps[-1, 2] = math.nan
    assert not judge(found, required).passed


def test_tolerances_are_table_iii(required: Requirements) -> None:
    allowed = tolerances(required)
    np.testing.assert_array_equal(allowed["position_m"], [0.03, 0.02, 0.02])
    np.testing.assert_array_equal(allowed["velocity_mps"], [0.02, 0.02, 0.02])
    np.testing.assert_array_equal(allowed["attitude_deg"], [0.5, 0.5, 0.5])
    np.testing.assert_array_equal(allowed["rate_degps"], [0.1, 0.1, 0.1])
    assert required.axial_distance_m == 0.4


def test_deviations_are_those_of_the_truth_against_the_ready_state(required: Requirements) -> None:
    w_HI, history = np.array([0.0, -8e-4, 3e-6]), np.zeros(2, CYCLE)
    attitude = Rotation.from_euler("ZYX", [3.0, -2.0, 1.0], degrees=True)
    w_CH = np.radians([0.01, -0.02, 0.03])
    history["t_s"] = [0.0, 0.02]
    truth = history["truth"]
    truth["r_CT_H"], truth["v_CT_H"], truth["q_CH"] = [0.41, -0.01, 0.02], [0.001, 0.002, -0.003], attitude.as_quat()
    truth["w_CI_C"] = w_CH + attitude.inv().apply(w_HI)
    truth["w_HI_H"] = w_HI
    found = deviations(history, required)
    np.testing.assert_allclose(found.position_m[1], [0.01, -0.01, 0.02])
    np.testing.assert_allclose(found.velocity_mps[1], [0.001, 0.002, -0.003])
    np.testing.assert_allclose(found.attitude_deg[1], [1.0, -2.0, 3.0], atol=1e-12)
    np.testing.assert_allclose(found.rate_degps[1], [0.01, -0.02, 0.03], atol=1e-12)
    np.testing.assert_array_equal(truth["r_CT_H"][0], [0.41, -0.01, 0.02])  # the history is left alone
