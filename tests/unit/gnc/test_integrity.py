"""Integrity of the navigation: which poses are admitted, what the monitors find, and how far errors are bounded."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.gnc_records import GncHealth
from hil.core.messages import NAVIGATION, POSE, new
from hil.gnc.estimation import integrity
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.gnc.estimation.integrity import INTEGRITY_STATE
from hil.gnc.estimation.sensor_fusion import SENSOR_FUSION_PARAMS
from hil.params import gnc as gnc_params


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.integrity(scheme_1)


def pose(t_s: float = 1.0, **fields: object) -> np.record:
    """Return a pose from 3 m with these fields."""
    made = new(POSE)
    made.t_s, made.z_TC_C, made.q_CH = t_s, (-3.0, 0.1, 0.2), (0.0, 0.0, 0.0, 1.0)
    made.covariance_position, made.covariance_attitude = 1e-4 * np.eye(3), 1e-6 * np.eye(3)
    for name, value in fields.items():
        made[name] = value
    return made


def skewed(size: float) -> np.ndarray:
    matrix = 1e-4 * np.eye(3)
    matrix[0, 1] += size
    return matrix


@pytest.mark.parametrize(
    "fields",
    [
        {"z_TC_C": (1e200, 0.0, 0.0)},
        {"z_TC_C": (math.nan, 0.0, 0.0)},
        {"z_TC_C": (0.0, 101.0, 0.0)},
        {"q_CH": (0.0, 0.0, 0.0, 0.9)},
        {"q_CH": (math.nan, 0.0, 0.0, 1.0)},
        {"t_s": math.nan},
        {"covariance_position": -1e-4 * np.eye(3)},
        {"covariance_position": np.zeros((3, 3))},
        {"covariance_position": np.full((3, 3), math.nan)},
        {"covariance_position": 2.0 * np.eye(3)},
        {"covariance_position": skewed(1e-6)},
        {"covariance_position": 1e-4 * (np.eye(3) + 1.5 * (np.eye(3, k=1) + np.eye(3, k=-1)))},
        {"covariance_attitude": np.diag([1e-6, 1e-6, -1e-6])},
        {"covariance_attitude": np.diag([1e-6, math.inf, 1e-6])},
    ],
)
def test_pose_that_is_no_measurement_is_refused_and_counted(params: np.record, fields: dict[str, object]) -> None:
    state = new(INTEGRITY_STATE)
    assert not integrity.admits(params, state, pose(**fields))
    assert (state.refused, state.refused_in_a_row) == (1, 1)
    assert integrity.admits(params, state, pose())
    assert (state.refused, state.refused_in_a_row) == (1, 0)


def test_pose_with_correlated_errors_is_admitted(params: np.record) -> None:
    covariance = 1e-4 * (np.eye(3) + 0.6 * (np.eye(3, k=1) + np.eye(3, k=-1)))
    assert integrity.admits(params, new(INTEGRITY_STATE), pose(covariance_position=covariance))


def test_pose_that_repeats_with_all_digits_is_frozen(params: np.record) -> None:
    state = new(INTEGRITY_STATE)
    admitted = [integrity.admits(params, state, pose(0.16 * k)) for k in range(6)]
    assert admitted == [True] * 3 + [False] * 3
    assert integrity.admits(params, state, pose(2.0, z_TC_C=(-3.0, 0.1, 0.21)))
    again = pose(2.0, z_TC_C=(-3.0, 0.1, 0.21))  # the same frame once more
    assert all(integrity.admits(params, state, again) for _ in range(9))


def watched(params: np.record, innovations: np.ndarray) -> np.record:
    state = new(INTEGRITY_STATE)
    for row in innovations:
        integrity.monitor(params, state, row, float(row[:3] @ row[:3]), float(row[3:] @ row[3:]))
    return state


def health(params: np.record, state: np.record, age_s: float = 0.1, rejected: int = 0) -> int:
    found: int = integrity.vision_health(params, state, age_s, rejected, 1.0)
    return found


def test_consistent_innovations_are_healthy(params: np.record, rng: np.random.Generator) -> None:
    state = watched(params, rng.standard_normal((20_000, 6)))
    assert health(params, state) == GncHealth.HEALTHY


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_bias_far_below_the_gate_is_found_and_stays_found(
    params: np.record, rng: np.random.Generator, axis: int, sign: float
) -> None:
    innovations = rng.standard_normal((150, 6))
    innovations[:, axis] += sign * 0.7
    state = watched(params, innovations)
    assert health(params, state) == GncHealth.VISION_SUSPECT
    for row in rng.standard_normal((1000, 6)):
        integrity.monitor(params, state, row, 3.0, 3.0)
    assert health(params, state) == GncHealth.VISION_SUSPECT


def test_noise_beyond_the_reported_one_is_suspect_until_it_ends(params: np.record, rng: np.random.Generator) -> None:
    state = watched(params, 2.0 * rng.standard_normal((40, 6)))
    assert health(params, state) == GncHealth.VISION_SUSPECT
    state.biased = 0
    for row in rng.standard_normal((60, 6)):
        integrity.monitor(params, state, row, float(row[:3] @ row[:3]), float(row[3:] @ row[3:]))
    assert state.mean_nis.max() < params.nis_limit


def test_rejections_in_a_row_are_suspect_and_age_is_loss(params: np.record) -> None:
    state = new(INTEGRITY_STATE)
    assert health(params, state, rejected=3) == 0
    assert health(params, state, rejected=4) == GncHealth.VISION_SUSPECT
    assert health(params, state, age_s=params.lost_after_s) == 0
    assert health(params, state, age_s=params.lost_after_s + 0.1) == GncHealth.VISION_LOST
    state.refused_in_a_row = 4
    assert health(params, state) == GncHealth.VISION_SUSPECT


def levels(params: np.record, state: np.record, t_s: float, **fields: float) -> np.record:
    """Return NAVIGATION with protection levels at ``t_s`` after a pose at 10 s, with these fields of FUSION_STATE."""
    fused, out = new(FUSION_STATE), new(NAVIGATION)
    fused.accepted, fused.last_accepted_s, fused.interval_s = 1000, 10.0, 0.16
    fused.noise_m, fused.noise_rad = 0.005, 1e-3
    for name, value in fields.items():
        fused[name] = value
    out.sigma_r_m, out.sigma_attitude_rad = (0.001, 0.002, 0.003), 1e-4
    integrity.protect(params, new(SENSOR_FUSION_PARAMS), state, fused, t_s, out)
    return out


def test_protection_level_without_a_bias_is_that_of_the_integrity_risk(params: np.record, scheme_1: Scenario) -> None:
    out = levels(params, new(INTEGRITY_STATE), 10.0)
    tail = math.erfc(params.sigmas / math.sqrt(2.0))
    assert 8.0 * tail * scheme_1.duration_s / 10.0 == pytest.approx(scheme_1.gnc.integrity.risk_probability, rel=1e-6)
    np.testing.assert_allclose(out.protection_level_m, params.sigmas * np.array([0.001, 0.002, 0.003]))
    assert out.protection_level_rad == pytest.approx(params.sigmas * 1e-4)


def test_fault_of_the_poses_that_is_found_soon_is_missed_for_few_poses(params: np.record) -> None:
    assert integrity.missed_shift(params, 8) == (params.gate, 2.0)


def test_ramp_is_no_larger_than_the_dynamics_permit(params: np.record) -> None:
    state, fused = new(INTEGRITY_STATE), new(FUSION_STATE)
    fused.accepted, fused.gain_position, fused.gain_velocity, fused.interval_s = 10_001, 0.03, 0.003, 0.16
    fused.noise_m, state.spread_mps = 0.005, 1e-5
    integrity.follow(params, state, fused, 0.02)
    assert state.followed_speed * 0.005 == pytest.approx(6e-5)  # six standard deviations, m/s
    bounded = state.followed
    state.spread_mps = 1.0
    integrity.follow(params, state, fused, 0.02)
    assert state.followed > bounded


def test_gains_within_a_minute_of_a_change_of_the_dynamics_do_not_count(params: np.record) -> None:
    state, fused, followed = new(INTEGRITY_STATE), new(FUSION_STATE), []
    fused.accepted, fused.gain_position, fused.gain_velocity, fused.interval_s = 10_001, 0.03, 0.003, 0.16
    fused.thrust.jumped = 2000
    for cycle, gain in ((2000, 0.03), (2100, 0.1), (5000, 0.1)):  # 0 s, 2 s, and 60 s after it
        fused.cycle, fused.gain_position = cycle, gain
        integrity.follow(params, state, fused, 0.02)
        followed.append(float(state.followed))
    assert followed[0] == followed[1] != followed[2]


def test_level_is_not_larger_when_poses_return_after_a_gap(params: np.record) -> None:
    state = new(INTEGRITY_STATE)
    state.followed, state.followed_speed = 1.0, 0.1
    before = levels(params, state, 15.0).protection_level_m.copy()
    state.followed = 5.0  # with the gains after a gap
    after = levels(params, state, 15.02, last_accepted_s=15.0, updated=1).protection_level_m
    assert np.all(after <= before + 0.1 * 0.005 * 0.02 + 1e-12)


def test_bias_that_was_found_has_no_bound(params: np.record) -> None:
    state = new(INTEGRITY_STATE)
    state.biased = 1
    out = levels(params, state, 10.0)
    assert np.isinf([*out.protection_level_m, out.protection_level_rad]).all()


def worst_error(params: np.record, gain: float, gain_v: float, dt_s: float, kind: str) -> float:
    """Return the largest error, in sigmas, of a two-state filter by a step or ramp just before the monitors find it."""
    sizes = np.geomspace(1e-3, 30.0, 20_000)
    r, v, total, largest, worst = (np.zeros(len(sizes)) for _ in range(5))
    lost = np.ones(len(sizes), bool)
    for j in range(1, 145):
        r = r + v
        innovation = (sizes if kind == "step" else sizes * j) - r
        r = r + gain * innovation
        v = v + gain_v * dt_s * innovation
        total, largest = total + innovation, np.maximum(largest, np.abs(r))
        is_found = lost & ((innovation > params.gate) | (total > params.cusum_limit + params.mean_shift * j))
        worst[is_found] = largest[is_found]
        lost &= ~is_found
    return float(worst.max())


@pytest.mark.parametrize(("gain", "gain_v"), [(0.03, 0.0028), (0.1, 0.03), (0.3, 0.3)])
def test_level_is_the_error_of_the_fault_that_is_found_last(params: np.record, gain: float, gain_v: float) -> None:
    state, fused = new(INTEGRITY_STATE), new(FUSION_STATE)
    fused.accepted, fused.gain_position, fused.gain_velocity, fused.interval_s = 10_001, gain, gain_v, 0.16
    integrity.follow(params, state, fused, 0.02)
    expected = max(worst_error(params, gain, gain_v, 0.16, kind) for kind in ("step", "ramp"))
    assert state.followed == pytest.approx(expected, rel=0.05)
    plain = levels(params, state, 10.0).protection_level_m  # gains of zero: only what is in ``state``
    found = levels(params, state, 12.0, gain_position=gain, gain_velocity=gain_v).protection_level_m
    np.testing.assert_allclose(plain - params.sigmas * np.array([0.001, 0.002, 0.003]), 0.005 * state.followed)
    np.testing.assert_allclose(found - plain, 2.0 * 0.005 * state.followed_speed)


def test_second_sensor_bounds_the_error_until_it_is_old_or_the_filters_start_again(params: np.record) -> None:
    state, gains = new(INTEGRITY_STATE), {"gain_position": 0.1}
    state.followed = 10.0
    alone = levels(params, state, 10.0, **gains).protection_level_m[0]
    integrity.set_second(state, 0.02, 10.0)
    assert levels(params, state, 10.0, **gains).protection_level_m[0] == 0.02 < alone
    # a monitor that is wrong: its bound is not below what is possible without a fault of poses and IMU
    integrity.set_second(state, 1e-6, 10.0)
    without = params.sigmas * 0.001 + 2.0 * params.mean_shift * 0.005
    assert levels(params, state, 10.0, **gains).protection_level_m[0] == pytest.approx(without)
    integrity.set_second(state, 0.02, 9.0)
    older = levels(params, state, 10.0, **gains).protection_level_m[0]
    assert 0.02 + params.gate * 0.005 * 0.1 / 0.16 <= older < alone
    integrity.set_second(state, 0.02, 0.0)
    assert levels(params, state, 10.0, **gains).protection_level_m[0] == alone
    integrity.set_second(state, 0.02, 10.0)
    state.restarted_s = 10.5
    assert levels(params, state, 11.0, **gains).protection_level_m[0] >= alone
    state.restarted_s, state.biased = 0.0, 1
    assert np.isinf(levels(params, state, 11.0, **gains).protection_level_m).all()
