"""Motion of the target: torque-free tumble against closed solutions, and the limit cycle of its own control."""

from __future__ import annotations

import math
from itertools import permutations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hil.config.load import load_scenario
from hil.config.tables.target import MovingTarget
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.target_attitude import TARGET_ATTITUDE, limit_cycle, tumble
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import euler, quat
from hil.maths.special import STEPS, jacobi_into, landen_moduli
from hil.models.rotating_frame import euler_acceleration, tumble_rate
from hil.params import dynamics as dynamics_params
from hil.params import target as target_params

TILTED = (30.0, 20.0, -50.0)
ORDERS = [*permutations((1500.0, 2000.0, 3000.0)), (2000.0, 2000.0, 3000.0), (3000.0, 2000.0, 2000.0)]


def body(moments: tuple[float, ...], rate: np.ndarray) -> MovingTarget:
    table = {"motion": "tumble", "moments_kg_m2": moments, "principal_axes_deg": TILTED}
    return MovingTarget.model_validate(table | {"rate_degps": tuple(np.degrees(rate))}, strict=False)


def closed(target: MovingTarget, rate: np.ndarray, t_s: float) -> tuple[np.ndarray, np.ndarray]:
    found = np.empty(3), np.empty(3)
    tumble_rate(target_params.tumble(target, rate), t_s, *found)
    return found


@pytest.mark.parametrize("moments", [*ORDERS, (2000.0, 2000.0, 2000.0)])
def test_closed_tumble_of_any_body_is_eulers_equation_integrated(
    moments: tuple[float, ...], rng: np.random.Generator
) -> None:
    rate = 0.06 * rng.standard_normal(3)
    target = body(moments, rate)
    axes = quat.to_matrix(euler.to_quaternion(np.radians(TILTED), euler.YAW_PITCH_ROLL))

    def change(_t: float, w: np.ndarray) -> np.ndarray:
        out = np.empty(3)
        euler_acceleration(np.array(moments), axes @ w, out)
        return axes.T @ out

    path = solve_ivp(change, (0.0, 400.0), rate, method="DOP853", rtol=1e-12, atol=1e-15, t_eval=[100.0, 400.0])
    for t_s, w in zip(path.t, path.y.T, strict=True):
        found, rate_of_change = closed(target, rate, float(t_s))
        np.testing.assert_allclose(found, w, atol=1e-11)
        np.testing.assert_allclose(rate_of_change, change(0.0, w), atol=1e-12)


def test_symmetric_body_precesses_at_the_textbook_rate_in_closed_form() -> None:
    target = MovingTarget.model_validate(
        {"motion": "tumble", "rate_degps": (1.0, 0.0, 4.0), "moments_kg_m2": (2000.0, 2000.0, 3000.0)}, strict=False
    )
    rate = np.radians([1.0, 0.0, 4.0])
    turned = (3000.0 - 2000.0) / 2000.0 * rate[2] * 77.0
    expected = [rate[0] * math.cos(turned), rate[0] * math.sin(turned), rate[2]]
    np.testing.assert_allclose(closed(target, rate, 77.0)[0], expected, atol=1e-15)


@pytest.mark.parametrize("rate", [(0.05, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, -0.05)])
def test_rotation_about_a_principal_axis_is_steady(rate: tuple[float, float, float]) -> None:
    target = MovingTarget.model_validate({"motion": "tumble", "moments_kg_m2": (1500.0, 2000.0, 3000.0)}, strict=False)
    found, change = closed(target, np.array(rate), 123.0)
    np.testing.assert_array_equal(found, rate)
    np.testing.assert_array_equal(change, 0.0)


def test_elliptic_functions_satisfy_their_differential_equation() -> None:
    value, after, before, moduli = np.empty(3), np.empty(3), np.empty(3), np.empty(STEPS)
    for m in (0.0, 0.3, 0.9, 0.999):
        n = landen_moduli(m, moduli)
        for u in np.linspace(-9.0, 9.0, 19):
            jacobi_into(u, moduli, n, value)
            jacobi_into(u + 1e-5, moduli, n, after)
            jacobi_into(u - 1e-5, moduli, n, before)
            sn, cn, dn = value
            np.testing.assert_allclose((after - before) / 2e-5, [cn * dn, -sn * dn, -m * sn * cn], atol=1e-9)


@pytest.mark.parametrize("moments", ORDERS[:3])
def test_integrated_tumble_follows_the_closed_one_and_keeps_the_momentum(moments: tuple[float, ...]) -> None:
    rate = np.radians([0.75, 1.0, 4.84])
    target, params = body(moments, rate), new(TARGET_ATTITUDE)
    params.moments = moments
    params.q_PB = euler.to_quaternion(np.radians(TILTED), euler.YAW_PITCH_ROLL)
    axes, q, w = quat.to_matrix(params.q_PB), np.array([0.1, -0.2, 0.3, math.sqrt(0.86)]), rate.copy()

    def momentum() -> np.ndarray:
        return quat.to_matrix(q).T @ axes.T @ (np.array(moments) * (axes @ w))

    first = momentum()
    for _ in range(20_000):
        tumble(params, 0.02, q, w)
    np.testing.assert_allclose(w, closed(target, rate, 400.0)[0], atol=1e-10)
    np.testing.assert_allclose(momentum(), first, atol=1e-8 * np.linalg.norm(first))


def test_free_chaser_in_the_axes_of_a_tumbling_target_is_that_of_the_hill_frame() -> None:
    """Both truths are one motion: the tumble changes the axes it is given in, not the motion."""
    settings = ("truth.gravity_gradient=false", "truth.solar_pressure=false", "truth.flexible_array=false")
    plain, turned = (load_scenario(name, settings).value for name in ("scheme-1", "tumbling-5"))
    states = [dynamics_params.initial_truth(scenario) for scenario in (plain, turned)]
    hill, axes = states
    # the same start: position, velocity and attitude of the first in the axes of the second, which are aligned at first
    hill.r_CT_H = axes.r_CT_H
    hill.v_CT_H = np.cross(axes.w_HI_H - hill.w_HI_H, axes.r_CT_H)
    hill.q_CH, hill.w_CI_C = axes.q_CH, axes.w_CI_C
    for scenario, state in zip((plain, turned), states, strict=True):
        params, field, memory = dynamics_params.dss(scenario), dynamics_params.field(scenario), new(TRUTH_MEMORY)
        for _ in range(500):
            kernels.step(params, field, memory, state, np.zeros(MAX_THRUSTERS, dtype=np.int64))
    inertial = [quat.to_matrix(state.q_HI).T @ state.r_CT_H for state in states]
    np.testing.assert_allclose(inertial[1], inertial[0], atol=1e-9)
    attitudes = [quat.to_matrix(state.q_CH) @ quat.to_matrix(state.q_HI) for state in states]
    np.testing.assert_allclose(attitudes[1], attitudes[0], atol=1e-9)
    assert np.linalg.norm(axes.r_CT_H - hill.r_CT_H) > 0.5


def test_limit_cycle_drifts_between_its_ends_and_is_reversed_by_burns() -> None:
    amplitude, rate, acceleration, out = 0.01, 4e-4, 2e-3, np.empty(2)
    t_s = np.linspace(0.0, 300.0, 30_001)
    found = np.empty((len(t_s), 2))
    for k, t in enumerate(t_s):
        limit_cycle(amplitude, rate, acceleration, 0.0, t, out)
        found[k] = out
    assert found[:, 0].max() == pytest.approx(amplitude, abs=1e-7)
    assert found[:, 0].min() == pytest.approx(-amplitude, abs=1e-7)
    assert np.abs(found[:, 1]).max() == rate
    np.testing.assert_allclose(np.gradient(found[:, 0], t_s)[1:-1], found[1:-1, 1], atol=acceleration * 0.011)
    steps = np.abs(np.diff(found[:, 1])) / np.diff(t_s)
    assert steps.max() == pytest.approx(acceleration, rel=1e-6)
