"""Interlock: the navigation's estimate against the docking monitor."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import NAVIGATION, VMU_FRAME, new
from hil.dynamics.docking_monitor import MONITOR_NOISE, measure_target
from hil.loop.monitor_stage import write_measurement
from hil.maths import quat
from hil.monitor.kernels.interlock import INTERLOCK_STATE, compare_estimate
from hil.monitor.kernels.quantities import of_chaser
from hil.monitor.results import QUANTITIES, Portion
from hil.params import monitor as monitor_params

R_M = np.array([3.0, -0.2, 0.1])
AHEAD = np.array([1.0, 0.0, 0.0])
Q = quat.from_rotation_vector(np.array([0.02, -0.03, 0.01]))


class Interlock:
    """Interlock of scheme-1, with a chaser at R_M and Q of which both sensors know."""

    def __init__(self) -> None:
        scenario = load_scenario("scheme-1", ("monitor.source=model",)).value
        self.params, self.model = monitor_params.interlock(scenario), monitor_params.monitor_model(scenario)
        self.state, self.estimate, self.frame = new(INTERLOCK_STATE), new(NAVIGATION), new(VMU_FRAME)
        estimate = self.estimate
        estimate.valid, estimate.r_CT_H, estimate.q_CH = 1, R_M, Q
        estimate.sigma_r_m, estimate.sigma_v_mps, estimate.sigma_attitude_rad = 1e-3, 1e-4, 1e-4

    def compare(self, r: np.ndarray = R_M, q: np.ndarray = Q, age_s: float = 0.0, far: bool = False) -> int:
        """Compare with a measurement of a chaser at ``r`` and ``q``; return whether the interlock is set."""
        frame = self.frame
        measure_target(self.model, r, q, np.zeros(MONITOR_NOISE), frame.t_v, frame.q_vt, frame.covariance)
        variance = np.diag(frame.covariance).copy()
        if far:
            variance[3:5] = 1.0
        compare_estimate(
            self.params, self.model.mounting, self.state, 100.0, 100.0 - age_s - float(self.params.step_s),
            frame.t_v, frame.q_vt, variance, self.estimate,
        )  # fmt: skip
        return int(self.state.disagrees)


@pytest.fixture
def interlock() -> Interlock:
    return Interlock()


def test_two_disagreements_in_a_row_set_it_and_two_agreements_release_it(interlock: Interlock) -> None:
    off = R_M + AHEAD * 0.05
    assert [interlock.compare(r) for r in (off, R_M, off, off, R_M, R_M)] == [0, 0, 0, 1, 1, 0]
    assert (interlock.state.compared, interlock.state.beyond) == (6, 3)


@pytest.mark.parametrize("axis", range(3))
def test_the_limit_is_the_mounting_and_five_sigmas_of_both(interlock: Interlock, axis: int) -> None:
    distance = float(np.linalg.norm(R_M + AHEAD * 1.1))
    limit = 0.005 + np.radians(0.1) * distance + 5.0 * np.hypot(1e-3, distance * 1e-4)
    step = limit * np.eye(3)[axis]
    assert [interlock.compare(R_M + 0.95 * step) for _ in range(3)] == [0, 0, 0]
    assert [interlock.compare(R_M + 1.10 * step) for _ in range(2)] == [0, 1]
    assert interlock.state.value == pytest.approx(1.1 * limit, rel=0.02)
    assert interlock.state.limit == pytest.approx(limit, rel=0.02)


@pytest.mark.parametrize("axis", range(3))
def test_attitude_counts_where_it_is_measured(interlock: Interlock, axis: int) -> None:
    turned = quat.multiply(quat.from_rotation_vector(np.radians(0.3) * np.eye(3)[axis]), Q)
    interlock.params.position = 0.1
    assert [interlock.compare(q=turned) for _ in range(2)] == [0, 1]
    assert interlock.state.component >= 3
    assert [interlock.compare(q=turned, far=True) for _ in range(2)] == [1, 0]


def test_the_estimate_is_carried_back_to_the_measurement(interlock: Interlock) -> None:
    interlock.estimate.v_CT_H, interlock.estimate.w_CH_C = (-0.1, 0.02, 0.0), (0.0, 0.0, 0.02)
    before = R_M - 0.5 * np.asarray(interlock.estimate.v_CT_H)
    q_before = quat.multiply(quat.from_rotation_vector(np.array([0.0, 0.0, -0.01])), Q)
    assert [interlock.compare(before, q_before, age_s=0.5) for _ in range(2)] == [0, 0]
    assert interlock.state.beyond == 0
    assert [interlock.compare(age_s=0.5) for _ in range(2)] == [0, 1]


def test_old_measurements_and_those_before_the_first_estimate_do_not_count(interlock: Interlock) -> None:
    off = R_M + AHEAD * 0.5
    assert [interlock.compare(off, age_s=2.5) for _ in range(3)] == [0, 0, 0]
    interlock.estimate.valid = 0
    assert [interlock.compare(off) for _ in range(3)] == [0, 0, 0]
    assert interlock.state.compared == 0


def test_an_estimate_without_sigmas_is_taken_as_it_is_and_one_that_is_none_disagrees(interlock: Interlock) -> None:
    interlock.estimate.sigma_r_m = interlock.estimate.sigma_v_mps = interlock.estimate.sigma_attitude_rad = np.nan
    assert [interlock.compare() for _ in range(2)] == [0, 0]
    interlock.estimate.r_CT_H = np.nan
    assert [interlock.compare() for _ in range(2)] == [0, 1]


def test_a_measurement_bounds_the_error_of_an_estimate_that_is_wrong(
    interlock: Interlock, rng: np.random.Generator
) -> None:
    """Whatever the errors of the estimate and, within the mounting's, of the monitor."""
    interlock.estimate.protection_level_rad = np.nan
    distance = float(np.linalg.norm(R_M + AHEAD * 1.1))
    for _ in range(50):
        error, angle = rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.005, 3)
        mounting = 0.005 * (lambda v: v / np.linalg.norm(v))(rng.normal(size=3))
        interlock.compare(R_M - error + mounting, quat.multiply(quat.from_rotation_vector(angle), Q))
        most = np.linalg.norm(error) + 0.06 + 2.5 * distance * np.linalg.norm(angle)
        assert np.abs(error).max() <= interlock.state.bound_m <= most
    interlock.compare()
    least = 0.005 + 2.0 * np.radians(0.1) * distance
    assert least < interlock.state.bound_m < 1.5 * least
    nearly = float(interlock.state.bound_m)
    interlock.compare(far=True)
    assert interlock.state.bound_m == 0.0  # neither sensor knows the attitude
    interlock.estimate.protection_level_rad = 1e-3
    interlock.compare(far=True)
    assert interlock.state.bound_m == pytest.approx(0.005 + (np.radians(0.1) + 1e-3) * distance, rel=0.1)
    assert interlock.state.bound_m < nearly


@pytest.mark.parametrize("status", ["near", "far"])
def test_a_portion_measures_what_the_model_measures(interlock: Interlock, status: str) -> None:
    values, sigmas = np.empty(12), np.full(12, 1e-4)
    of_chaser(interlock.model.mounting, R_M, Q, values)
    if status == "far":
        for name in ("d1_m", "d2_m", "d3_m", "phi1_rad", "phi2_rad"):
            values[QUANTITIES.index(name)] = sigmas[QUANTITIES.index(name)] = np.nan
    modelled, found = interlock.frame, new(VMU_FRAME)
    measure_target(interlock.model, R_M, Q, np.zeros(MONITOR_NOISE), modelled.t_v, modelled.q_vt, modelled.covariance)
    assert write_measurement(Portion(1.0, 10, status, values, sigmas), found)
    np.testing.assert_allclose(found.t_v, modelled.t_v, atol=1e-12)
    assert (found.covariance[3, 3] == 1.0) == (status == "far")
    if status == "near":
        np.testing.assert_allclose(found.q_vt, modelled.q_vt, atol=1e-12)


def test_a_portion_without_a_target_is_no_measurement() -> None:
    nothing = np.full(12, np.nan)
    assert not write_measurement(Portion(1.0, 0, "no_target", nothing, nothing), new(VMU_FRAME))
