"""The nonlinear truth: against an integrator of higher order, against its own halved step, and against laws."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params
from tests.support import moon_reference as reference

QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)
ORBIT_S = 7656.0


@pytest.fixture(scope="module")
def drift() -> Scenario:
    """Return scheme-2 with gravity alone, on an inclined, mildly eccentric orbit."""
    return load_scenario(
        "scheme-2",
        (
            "truth.solar_pressure=false",
            "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
            "orbit.eccentricity=0.03",
            "orbit.true_anomaly_deg=40.0",
            "orbit.body_rotation_deg=70.0",
            "initial.velocity_mps=[0.004, -0.006, 0.003]",
        ),
    ).value


def inertial(truth: np.record) -> tuple[np.ndarray, np.ndarray]:
    """Return the chaser's position, m, and velocity, m/s, relative to the target along inertial axes."""
    a = quat.to_matrix(truth.q_HI)
    return a.T @ truth.r_CT_H, a.T @ (truth.v_CT_H + np.cross(truth.w_HI_H, truth.r_CT_H))


def fly(scenario: Scenario, span_s: float, step_s: float, on: np.ndarray = QUIET) -> np.record:
    """Return TRUTH after ``span_s`` in steps of ``step_s``."""
    params, field, truth = (
        dynamics_params.dss(scenario),
        dynamics_params.field(scenario),
        dynamics_params.initial_truth(scenario),
    )
    memory = new(TRUTH_MEMORY)
    params.dt_s = step_s
    for _ in range(round(span_s / step_s)):
        kernels.step(params, field, memory, truth, on)
    return truth


@pytest.mark.parametrize(
    ("span_s", "tolerance_m"),
    [
        pytest.param(400.0, 1e-9, id="400 s"),
        pytest.param(ORBIT_S, 1e-6, id="an orbit", marks=pytest.mark.slow),
    ],
)
def test_relative_position_agrees_with_dop853(drift: Scenario, span_s: float, tolerance_m: float) -> None:
    params, start = dynamics_params.dss(drift), dynamics_params.initial_truth(drift)

    def rate(t_s: float, y: np.ndarray) -> np.ndarray:
        angle = params.gravity.rotation + params.gravity.rate * t_s
        target = reference.gravity(y[0:3], angle)
        return np.concatenate([y[3:6], target, y[9:12], reference.gravity(y[0:3] + y[6:9], angle) - target])

    y_0 = np.concatenate([start.r_T_I, start.v_T_I, *inertial(start)])
    exact = solve_ivp(rate, (0.0, span_s), y_0, method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    found = fly(drift, span_s, drift.step_s)
    r, v = inertial(found)
    np.testing.assert_allclose(r, exact[6:9], atol=tolerance_m)
    np.testing.assert_allclose(v, exact[9:12], atol=1e-3 * tolerance_m)
    np.testing.assert_allclose(found.r_T_I, exact[0:3], atol=1e-4)


def test_halving_the_step_changes_nothing_that_matters(scheme_2: Scenario) -> None:
    coarse, fine = (fly(scheme_2, 400.0, step) for step in (0.02, 0.01))
    turn = quat.to_rotation_vector(quat.multiply(coarse.q_CH, quat.conjugate(fine.q_CH)))
    np.testing.assert_allclose(coarse.r_CT_H, fine.r_CT_H, atol=1e-9)
    np.testing.assert_allclose(turn, 0.0, atol=1e-9)
    assert abs(coarse.eta - fine.eta) < 1e-6


def test_jacobi_constant_holds_about_the_turning_moon(drift: Scenario) -> None:
    params, field, truth = (
        dynamics_params.dss(drift),
        dynamics_params.field(drift),
        dynamics_params.initial_truth(drift),
    )
    memory = new(TRUTH_MEMORY)
    params.gravity.rate = 1e-4  # a Moon that turns visibly
    spin = np.array([0.0, 0.0, params.gravity.rate])

    def jacobi() -> float:
        angle = params.gravity.rotation + params.gravity.rate * truth.t_s
        r = truth.r_T_I
        v = truth.v_T_I - np.cross(spin, r)
        fixed = Rotation.from_rotvec([0.0, 0.0, -angle]).apply(r)
        field_energy = params.gravity.gm / np.linalg.norm(r) + reference.potential(fixed)
        return float(0.5 * v @ v - field_energy - 0.5 * params.gravity.rate**2 * (r[0] ** 2 + r[1] ** 2))

    before = jacobi()
    energy = 0.5 * truth.v_T_I @ truth.v_T_I - params.gravity.gm / np.linalg.norm(truth.r_T_I)
    for _ in range(50000):
        kernels.step(params, field, memory, truth, QUIET)
    kepler = 0.5 * truth.v_T_I @ truth.v_T_I - params.gravity.gm / np.linalg.norm(truth.r_T_I)
    assert jacobi() == pytest.approx(before, rel=2e-14)
    assert abs(kepler - energy) > 1e-6 * abs(energy)  # the harmonics did act


def test_recorded_rate_of_hill_is_that_of_the_recorded_frame(drift: Scenario) -> None:
    params, field, truth = (
        dynamics_params.dss(drift),
        dynamics_params.field(drift),
        dynamics_params.initial_truth(drift),
    )
    memory = new(TRUTH_MEMORY)
    frames, rates = [], []
    for _ in range(101):
        frames.append(quat.to_matrix(truth.q_HI))
        rates.append(truth.w_HI_H.copy())
        kernels.step(params, field, memory, truth, QUIET)
    turn = -Rotation.from_matrix(frames[100] @ frames[0].T).as_rotvec() / 2.0
    np.testing.assert_allclose(turn, rates[50], atol=1e-11)
    assert abs(rates[50][2]) > 1e-9  # the orbit plane turns too
    np.testing.assert_allclose(
        frames[0][2], -dynamics_params.initial_truth(drift).r_T_I / np.linalg.norm(truth.r_T_I), rtol=1e-2
    )


def test_near_the_target_on_a_circle_the_motion_is_hills(plain_2: Scenario) -> None:
    exact = plain_2.model_copy(
        update={"truth": plain_2.truth.model_copy(update={"relative_motion": "nonlinear", "gravity_degree": 0})}
    )
    linear, nonlinear = fly(plain_2, 400.0, 0.02), fly(exact, 400.0, 0.02)
    # the part left out is 3/2 w0^2 r^2 / R: 5e-11 m/s^2 at 10 m
    np.testing.assert_allclose(nonlinear.r_CT_H, linear.r_CT_H, atol=2e-5)
    assert np.abs(nonlinear.r_CT_H - linear.r_CT_H).max() > 1e-7
    np.testing.assert_allclose(nonlinear.q_CH, linear.q_CH, atol=1e-11)
    np.testing.assert_allclose(nonlinear.w_HI_H, linear.w_HI_H, atol=1e-15)
    np.testing.assert_allclose(nonlinear.r_T_I, linear.r_T_I, atol=1e-4)


def test_plain_hill_keeps_its_numbers_to_the_last_bit(plain_2: Scenario) -> None:
    params, field, truth = (
        dynamics_params.dss(plain_2),
        dynamics_params.field(plain_2),
        dynamics_params.initial_truth(plain_2),
    )
    memory = new(TRUTH_MEMORY)
    for i in range(500):
        on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
        if i % 7 < 3:
            on[i % 16] = 1
        if i % 11 == 0:
            on[(5 * i) % 16] = 1
        kernels.step(params, field, memory, truth, on)
    kept = {
        "r_CT_H": ["0x1.3fedc3dafe48fp+3", "-0x1.fe14269ec1450p-2", "0x1.fed8e5cea546bp-2"],
        "v_CT_H": ["-0x1.087d34d33ee11p-11", "0x1.5a21d20059c7fp-13", "-0x1.1576bc5b1d280p-13"],
        "q_CH": ["0x1.793ea9be7fa61p-5", "0x1.585530f13567fp-5", "-0x1.7635aaade9a5dp-5", "0x1.fe77e5f9caa35p-1"],
        "w_CI_C": ["0x1.7b933198378acp-13", "-0x1.77ed75f99f00fp-11", "0x1.540a0fab89593p-14"],
        "mean_rate_C": ["0x1.f02902d8ef7a6p-13", "-0x1.7933bace88890p-11", "0x1.55f5c32d80ddep-14"],
        "mean_force_C": ["0x0.0p+0", "0x0.0p+0", "-0x1.47af124db1f77p-8"],
    }
    for name, values in kept.items():
        np.testing.assert_array_equal(truth[name], [float.fromhex(value) for value in values], err_msg=name)
    assert truth.mass_kg == float.fromhex("0x1.f3fe7b2e8ce00p+9")


def test_attitude_against_hill_follows_from_the_inertial_one(scheme_2: Scenario) -> None:
    truth = fly(scheme_2, 40.0, 0.02)
    rate = np.empty(3)
    kernels.rate_against_hill(truth, rate)
    np.testing.assert_allclose(rate, truth.w_CI_C - quat.to_matrix(truth.q_CH) @ truth.w_HI_H, atol=1e-18)
    assert np.linalg.norm(truth.q_CH) == pytest.approx(1.0, abs=1e-15)
    assert math.degrees(np.abs(rate).max()) < 0.02


def test_attitude_keeps_its_sign_along_a_whole_orbit(scheme_2: Scenario) -> None:
    params, field, truth = (
        dynamics_params.dss(scheme_2),
        dynamics_params.field(scheme_2),
        dynamics_params.initial_truth(scheme_2),
    )
    memory = new(TRUTH_MEMORY)
    params.dt_s = 1.0
    before = truth.q_CH.copy(), truth.q_HI.copy()
    for _ in range(round(ORBIT_S)):
        kernels.step(params, field, memory, truth, QUIET)
        assert truth.q_CH @ before[0] > 0.9
        assert truth.q_HI @ before[1] > 0.9
        before = truth.q_CH.copy(), truth.q_HI.copy()
