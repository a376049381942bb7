"""Witness: the navigation's estimate against a sensor that is not fused, here the docking monitor."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import NAVIGATION, new
from hil.core.sensor_records import ACCEPTED, LATE, NOT_USED, REJECTED, SENSOR_SAMPLE
from hil.gnc.estimation.sensor_fusion import SENSOR_FUSION_STATE
from hil.gnc.estimation.sensor_witness import compare_witnesses
from hil.maths import quat
from hil.params import gnc as gnc_params
from hil.params.sensors import sensors_of, settings_row
from hil.parts.monitor.kernels.quantities import of_chaser
from hil.parts.monitor.params import mounting
from hil.parts.monitor.portion_samples import write_sample
from hil.parts.monitor.results import QUANTITIES, Portion
from hil.sensors.check import Trial

R_M = np.array([3.0, -0.2, 0.1])
AHEAD = np.array([1.0, 0.0, 0.0])
Q = quat.from_rotation_vector(np.array([0.02, -0.03, 0.01]))
TO_TARGET_M = np.array([-0.3, 0.0, -0.5]) - R_M
CAMERA_M = np.array([0.8, 0.0, -0.5])


class Interlock:
    """Interlock of scheme-1 with a docking monitor, with a chaser at R_M and Q that both sensors measure."""

    def __init__(self) -> None:
        self.scenario = load_scenario("scheme-1", ("monitor.source=model",)).value
        self.params = gnc_params.navigation(self.scenario).fusion.sensors
        self.sensors, self.estimate = new(SENSOR_FUSION_STATE), new(NAVIGATION)
        self.state = self.sensors.witness[0]
        self.arrival = self.sensors.arrival[0]
        kind, config, _ = sensors_of(self.scenario)["monitor"]
        self._trial = Trial(kind, settings_row(kind, config))
        estimate = self.estimate
        estimate.valid, estimate.r_CT_H, estimate.q_CH = 1, R_M, Q
        estimate.sigma_r_m, estimate.sigma_v_mps, estimate.sigma_attitude_rad = 1e-3, 1e-4, 1e-4

    def measured(self, r: np.ndarray, q: np.ndarray) -> np.record:
        """Return the sample of a chaser at ``r`` and ``q``, without noise."""
        self._trial.truth.r_CT_H, self._trial.truth.q_CH, self._trial.truth.normal = r, q, 0.0
        assert self._trial.measure()
        sample: np.record = self._trial.output.sample
        return sample

    def compare(self, r: np.ndarray = R_M, q: np.ndarray = Q, age_s: float = 0.0, far: bool = False) -> int:
        """Compare with a measurement of a chaser at ``r`` and ``q``; return whether the interlock is set."""
        sample = self.measured(r, q)
        if far:
            sample.covariance[3, 3] = sample.covariance[4, 4] = 1.0
        sample.t_s = 100.0 - age_s - float(self.params.witness.step_s)
        self.arrival.sample, self.sensors.arrived = sample, 1
        return int(compare_witnesses(self.params, self.sensors, 100.0, self.estimate))


@pytest.fixture
def interlock() -> Interlock:
    return Interlock()


def test_two_disagreements_in_a_row_set_it_and_two_agreements_release_it(interlock: Interlock) -> None:
    off = R_M + AHEAD * 0.05
    assert [interlock.compare(r) for r in (off, R_M, off, off, R_M, R_M)] == [0, 0, 0, 1, 1, 0]
    assert (interlock.state.compared, interlock.state.beyond) == (6, 3)
    counts = interlock.sensors.monitor[0]
    assert (counts.accepted, counts.rejected, counts.judged) == (3, 3, 36)


@pytest.mark.parametrize("axis", range(3))
def test_the_limit_is_the_mounting_and_five_sigmas_of_both(interlock: Interlock, axis: int) -> None:
    """An error of the attitude moves the target across its direction from the chaser's reference point."""
    distance = float(np.linalg.norm(TO_TARGET_M - CAMERA_M))
    lever = float(np.linalg.norm(np.cross(np.eye(3)[axis], TO_TARGET_M)))
    limit = 0.005 + np.radians(0.1) * distance + 5.0 * np.hypot(1e-3, lever * 1e-4)
    step = limit * np.eye(3)[axis]
    assert [interlock.compare(R_M + 0.95 * step) for _ in range(3)] == [0, 0, 0]
    assert interlock.arrival.result == ACCEPTED
    assert [interlock.compare(R_M + 1.10 * step) for _ in range(2)] == [0, 1]
    assert interlock.arrival.result == REJECTED
    assert interlock.state.value == pytest.approx(1.1 * limit, rel=0.02)
    assert interlock.state.limit == pytest.approx(limit, rel=0.02)


@pytest.mark.parametrize("axis", range(3))
def test_attitude_counts_where_it_is_measured(interlock: Interlock, axis: int) -> None:
    turned = quat.multiply(quat.from_rotation_vector(np.radians(0.3) * np.eye(3)[axis]), Q)
    interlock.params.slot[0].settings[list(interlock_settings()).index("error_m")] = 0.1
    assert [interlock.compare(q=turned) for _ in range(2)] == [0, 1]
    assert interlock.state.component >= 3
    roll_is_measured = axis == 0
    assert [interlock.compare(q=turned, far=True) for _ in range(2)] == [1, int(roll_is_measured)]


def interlock_settings() -> dict[str, float]:
    kind, config, _ = sensors_of(load_scenario("scheme-1", ("monitor.source=model",)).value)["monitor"]
    return kind.values(config.settings)


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
    assert interlock.arrival.result == LATE
    interlock.estimate.valid = 0
    assert [interlock.compare(off) for _ in range(3)] == [0, 0, 0]
    assert interlock.arrival.result == NOT_USED
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
    distance = float(np.linalg.norm(TO_TARGET_M - CAMERA_M))
    lever = float(np.linalg.norm(TO_TARGET_M))
    for _ in range(50):
        error, angle = rng.normal(0.0, 0.05, 3), rng.normal(0.0, 0.005, 3)
        of_mounting = 0.005 * (lambda v: v / np.linalg.norm(v))(rng.normal(size=3))
        interlock.compare(R_M - error + of_mounting, quat.multiply(quat.from_rotation_vector(angle), Q))
        most = np.linalg.norm(error) + 0.06 + 2.5 * lever * np.linalg.norm(angle)
        assert np.abs(error).max() <= interlock.sensors.bound_m <= most
    interlock.compare()
    least = 0.005 + np.radians(0.1) * (distance + lever)
    assert least < interlock.sensors.bound_m < 1.5 * least
    nearly = float(interlock.sensors.bound_m)
    interlock.compare(far=True)
    assert interlock.state.bound_m == 0.0  # neither sensor measures the attitude
    interlock.estimate.protection_level_rad = 1e-3
    interlock.compare(far=True)
    assert interlock.state.bound_m == pytest.approx(0.005 + np.radians(0.1) * distance + 1e-3 * lever, rel=0.1)
    assert interlock.state.bound_m < nearly


@pytest.mark.parametrize("status", ["near", "far"])
def test_a_portion_measures_what_the_model_measures(interlock: Interlock, status: str) -> None:
    values, sigmas = np.empty(12), np.full(12, 1e-4)
    of_chaser(mounting(interlock.scenario.monitor), R_M, Q, values)
    if status == "far":
        for name in ("d1_m", "d2_m", "d3_m", "phi1_rad", "phi2_rad"):
            values[QUANTITIES.index(name)] = sigmas[QUANTITIES.index(name)] = np.nan
    found, modelled = np.zeros(1, SENSOR_SAMPLE)[0], interlock.measured(R_M, Q)
    assert write_sample(Portion(1.0, 10, status, values, sigmas), found)
    np.testing.assert_allclose(found["value"][:3], modelled.value[:3], atol=1e-12)
    assert (found["covariance"][3, 3] == 1.0) == (status == "far")
    if status == "near":
        np.testing.assert_allclose(found["value"][3:], modelled.value[3:], atol=1e-12)


def test_a_portion_without_a_target_is_no_measurement() -> None:
    nothing = np.full(12, np.nan)
    assert not write_sample(Portion(1.0, 0, "no_target", nothing, nothing), np.zeros(1, SENSOR_SAMPLE)[0])
