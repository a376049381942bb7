"""Estimated rate and moments of a target that tumbles: motion, errors, and what poses make of them."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE, IMU, TRUTH, new
from hil.errors import BadInput
from hil.gnc.estimation import fusion, navigation, target_motion
from hil.gnc.estimation.error_state import FILTERS, ROTATION, R, V
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.estimation.target_orbit import HILL_STEP
from hil.maths import quat
from hil.models.rotating_frame import tumble_rate
from hil.params import error_state
from hil.params import gnc as gnc_params
from hil.parts.campaigns.case_runner import CaseRunner
from tests.support.plain_filters import PLAIN

SCENARIO = load_scenario("tumbling-5", PLAIN).value
PARAMS = gnc_params.navigation(SCENARIO).fusion
RATE, MOMENTS = int(PARAMS.errors.target_rate), int(PARAMS.errors.target_moments)
DT = SCENARIO.step_s


def begun(rate_error: np.ndarray, moments: np.ndarray) -> np.record:
    """Return filters with estimates of ``rate_error`` beyond the known rate and of the moments' logarithms."""
    state = new(FUSION_STATE)
    state.started, filters = 1, state.filters
    filters.akf.x[:4], filters.akf.x[4:] = [0.02, -0.01, 0.03, 0.99], PARAMS.akf.initial_drift
    filters.akf.x[:4] /= np.linalg.norm(filters.akf.x[:4])
    filters.pkf.x[:6] = 0.9, -0.2, 0.3, 0.01, 0.02, -0.03
    target_motion.start(PARAMS.orbit, PARAMS.errors, 0.0, filters.parameters)
    filters.parameters[RATE : RATE + 3] += rate_error
    filters.parameters[MOMENTS : MOMENTS + 3] = moments
    return state


def carried(state: np.record, steps: int) -> np.ndarray:
    """Return position, velocity, attitude and rate of the target after ``steps`` steps without poses."""
    memory, sample = new_memory(PARAMS), new(IMU)
    sample.rate_C, sample.force_C = (0.01, 0.02, 0.08), (0.002, -0.003, 0.001)
    for k in range(1, steps + 1):
        state.cycle = k
        fusion.advance(PARAMS, state, memory, sample)
    filters = state.filters
    return np.concatenate([filters.pkf.x[:6], filters.akf.x[:4], filters.parameters[RATE : RATE + 3]])


def test_estimated_rate_moves_as_the_closed_solution() -> None:
    state, hill, expected, aside = begun(np.zeros(3), np.zeros(3)), new(HILL_STEP), np.empty(3), np.empty(3)
    for _ in range(5000):
        target_motion.move(PARAMS.orbit, PARAMS.errors, DT, state.filters, hill)
    tumble_rate(PARAMS.orbit.tumble, 5000 * DT, expected, aside)
    np.testing.assert_allclose(hill.rate_after, expected, atol=1e-7)
    found, change = np.empty(3), np.empty(3)
    target_motion.present_rate(PARAMS, state, 5000 * DT, found, change)
    np.testing.assert_allclose(found, expected, atol=1e-7)
    np.testing.assert_allclose(change, aside, atol=1e-7)


@pytest.mark.parametrize("which", range(6))
def test_errors_of_rate_and_moments_move_the_other_errors_as_the_states_do(which: int) -> None:
    """The covariance of one error alone is the square of what it makes of the states."""
    size, steps = 1e-6, 100
    off = size * np.eye(6)[which]
    plain = carried(begun(np.zeros(3), np.zeros(3)), steps)
    moved = carried(begun(off[:3], off[3:]), steps)
    state = begun(np.zeros(3), np.zeros(3))
    state.filters.p[RATE + which, RATE + which] = 1.0
    carried(state, steps)
    turned = np.empty(3)
    quat.rotation_between(moved[6:10], plain[6:10], turned)
    motion = (moved - plain)[10:]
    expected = np.concatenate([(moved - plain)[:6], turned, motion]) / size
    rows = [*range(R, V + 3), *range(ROTATION, ROTATION + 3), *range(RATE, RATE + 3)]
    if which < 3:  # the error itself has moved on
        found, expected = state.filters.p[rows, RATE : RATE + 3], np.outer(expected, motion / size)
    else:
        found = state.filters.p[rows, MOMENTS + which - 3]
    np.testing.assert_allclose(found, expected, atol=1.5 / steps * np.abs(expected).max())  # of first order in a step


def test_walk_of_the_rate_moves_the_velocity_in_the_axes() -> None:
    """A chaser that moves as before has the velocity -dw x r in axes whose rate has changed by dw."""
    state, errors = begun(np.zeros(3), np.zeros(3)), PARAMS.errors.copy()
    errors.target_walk = walk = 1e-10
    target_motion.carry_errors(PARAMS.orbit, errors, 0.0, state.filters)
    change = [np.concatenate([-np.cross(dw, state.filters.pkf.x[:3]), dw]) for dw in np.eye(3)]
    rows = [*range(V, V + 3), *range(RATE, RATE + 3)]
    expected = walk * np.sum([np.outer(each, each) for each in change], axis=0)
    np.testing.assert_allclose(state.filters.p[np.ix_(rows, rows)], expected, atol=1e-9 * walk)


def test_tumble_is_found_from_poses() -> None:
    scenario = load_scenario("tumbling-5", ("duration_s=40.0",))
    error = (0.05, -0.06, 0.08)
    known = load_scenario("tumbling-5", ("duration_s=40.0", f"gnc.target.rate_error_degps={list(error)}")).value
    runner = CaseRunner(known, load_rig("mock").value, 40.0)
    runner.run(scenario.value, 3)
    state = runner._state
    errors, filters = runner._params.gnc.navigation.fusion.errors, state.gnc.navigation.fusion.filters
    k = int(errors.target_rate)
    off = filters.parameters[k : k + 3] - state.now.truth.w_HI_H
    sigma = np.sqrt(np.diag(filters.p)[k : k + 3])
    assert np.degrees(sigma).max() < 6e-3
    assert np.linalg.norm(off / sigma) < 5.0
    assert np.degrees(np.abs(filters.akf.x[4:] - state.now.imu.drift_C)).max() < 1e-4


def test_rate_of_a_target_with_a_limit_cycle_is_followed_through_its_burns() -> None:
    """The burns change it by 0.01 to 0.02 deg/s at 10 m, where the axes then pass the chaser by up to 3.5 mm/s."""
    scenario = load_scenario("limit-cycle", ("duration_s=60.0",)).value
    runner = CaseRunner(scenario, load_rig("mock").value, 60.0)
    cycles = np.zeros(runner.cycles, CYCLE).view(np.recarray)
    runner.run(scenario, 3, cycles)
    rates = np.degrees(cycles.truth.w_HI_H)
    assert np.ptp(rates, axis=0).max() > 0.009  # deg/s: it has been reversed
    state = runner._state
    errors, filters = runner._params.gnc.navigation.fusion.errors, state.gnc.navigation.fusion.filters
    k = int(errors.target_rate)
    off = filters.parameters[k : k + 3] - state.now.truth.w_HI_H
    assert np.linalg.norm(off / np.sqrt(np.diag(filters.p)[k : k + 3])) < 5.0
    assert np.nanmean(cycles.nees_position[cycles.t_s > 20.0]) < 25.0  # 200 and more without the estimate
    assert not np.any(cycles.navigation.health)


def test_known_tumble_is_not_estimated() -> None:
    params = gnc_params.navigation(load_scenario("tumbling-5", ("gnc.target.rate_sigma_degps=0.0",)).value).fusion
    assert (params.orbit.estimated, params.errors.target_rate, params.errors.target_moments) == (0, 0, 0)
    assert target_motion.largest_sigma(params, new(FUSION_STATE)) == 0.0
    assert target_motion.largest_sigma(PARAMS, new(FUSION_STATE)) == np.inf


def test_more_errors_than_the_navigation_holds_are_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(error_state, "ERRORS_MAX", int(PARAMS.errors.n) - 1)
    with pytest.raises(
        BadInput, match=rf"gnc\.navigation\.budget: .* would be errors .* allowed {PARAMS.errors.n - 1} in"
    ):
        gnc_params.navigation(SCENARIO)


@pytest.mark.parametrize(("sigma_degps", "waits"), [(0.1, True), (0.0, False)])
def test_approach_waits_until_the_rate_is_known(sigma_degps: float, waits: bool) -> None:
    settings = (
        "duration_s=6.0",
        "gnc.guidance.phases.settle.duration_s=0.2",
        f"gnc.target.rate_sigma_degps={sigma_degps}",
    )
    scenario = load_scenario("tumbling-1", settings).value
    runner = CaseRunner(scenario, load_rig("mock").value, 6.0)
    cycles = np.zeros(runner.cycles, CYCLE).view(np.recarray)
    runner.run(scenario, 1, cycles)
    begins_s = float(cycles.t_s[np.flatnonzero(cycles.reference.phase == 1)[0]])
    assert begins_s == pytest.approx(0.2) if not waits else begins_s > 1.0


@pytest.mark.parametrize(("estimated", "nees"), [(1, 0.0), (0, 1e2)])
def test_error_of_the_known_rate_is_no_drift_if_the_rate_is_estimated(estimated: int, nees: float) -> None:
    filters, orbit, truth, imu, found = new(FILTERS), PARAMS.orbit.copy(), new(TRUTH), new(IMU), np.empty(2)
    filters.p[:15, :15] = 1e-6 * np.eye(15)
    filters.akf.x[:4] = truth.q_CH = 0.0, 0.0, 0.0, 1.0
    tumble_rate(orbit.tumble, 0.0, truth.w_HI_H, np.empty(3))
    truth.w_HI_H[1] += 0.01
    orbit.estimated = estimated
    navigation.normalised_errors(filters, orbit, truth, imu, found)
    assert found[1] == pytest.approx(nees)
