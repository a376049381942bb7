"""What disturbs the chaser: gravity gradient, sunlight, a bending array, imperfect thrusters and mass properties."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.scenario import Scenario
from hil.core.messages import MAX_THRUSTERS, new
from hil.dynamics import truth as kernels
from hil.dynamics.mass_properties import MODES, add_bending, bending
from hil.dynamics.orbit import state_of_elements
from hil.dynamics.rigid_body import add_gravity_gradient, angular_acceleration
from hil.dynamics.sunlight import PLATE_PARAMS, SOLAR_PRESSURE_PA, pressure_force
from hil.dynamics.thrusters import as_built
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.params import dynamics as dynamics_params

J = np.array([[900.0, 12.0, -8.0], [12.0, 1100.0, 15.0], [-8.0, 15.0, 1050.0]])
NO_FIELD = np.zeros((1, 1, 6))  # the linear model reads no gravity field
QUIET = np.zeros(MAX_THRUSTERS, dtype=np.int64)


def with_truth(scenario: Scenario, **changes: Any) -> Scenario:
    return scenario.model_copy(update={"truth": scenario.truth.model_copy(update=changes)})


def firing(*numbers: int) -> np.ndarray:
    on = np.zeros(MAX_THRUSTERS, dtype=np.int64)
    on[list(numbers)] = 1
    return on


# gravity gradient


def test_sphere_feels_no_gravity_gradient(rng: np.random.Generator) -> None:
    torque, nadir = np.zeros(3), rng.standard_normal(3)
    add_gravity_gradient(700.0 * np.eye(3), nadir / np.linalg.norm(nadir), 7e-7, torque)
    np.testing.assert_allclose(torque, 0.0, atol=1e-18)


def test_small_roll_gives_the_textbook_torque() -> None:
    w0, roll = 8.2e-4, 1e-4
    torque = np.zeros(3)
    inertia = np.diag([900.0, 1100.0, 1050.0])
    add_gravity_gradient(inertia, np.array([0.0, roll, 1.0]), w0**2, torque)
    np.testing.assert_allclose(torque, [3.0 * w0**2 * (1050.0 - 1100.0) * roll, 0.0, 0.0], rtol=1e-6, atol=1e-18)


def test_gravity_gradient_turns_the_vehicle_alike_in_both_models(plain_1: Scenario) -> None:
    found = []
    for model in ("hill", "nonlinear"):
        scenario = with_truth(plain_1, gravity_gradient=True, relative_motion=model, gravity_degree=0)
        params, field, truth = (
            dynamics_params.dss(scenario),
            dynamics_params.field(scenario),
            dynamics_params.initial_truth(scenario),
        )
        memory = new(TRUTH_MEMORY)
        w = truth.w_CI_C.copy()
        kernels.step(params, field, memory, truth, QUIET)
        nadir, w0 = quat.to_matrix(truth.q_CH)[:, 2], params.orbit_rate
        torque = 3.0 * w0**2 * np.cross(nadir, J @ nadir) - np.cross(w, J @ w)
        np.testing.assert_allclose(truth.w_CI_C - w, params.dt_s * np.linalg.solve(J, torque), atol=3e-14)
        found.append(truth.w_CI_C.copy())
    np.testing.assert_allclose(found[0], found[1], atol=1e-14)


# sunlight


@pytest.fixture
def plate() -> np.record:
    plate = new(PLATE_PARAMS)
    plate.area, plate.normal = 10.0, [0.0, 0.0, 1.0]
    return plate


def pressure(plate: np.record, sun: Any) -> np.ndarray:
    out = np.empty(3)
    pressure_force(plate, SOLAR_PRESSURE_PA, np.array(sun, dtype=float), out)
    return out


def test_black_plate_is_pushed_away_from_the_sun_by_what_it_intercepts(plate: np.record) -> None:
    sun = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(pressure(plate, sun), -SOLAR_PRESSURE_PA * 10.0 * 0.8 * sun, rtol=1e-14)


def test_mirror_is_pushed_along_its_normal_twice_as_hard(plate: np.record) -> None:
    plate.specular = 1.0
    expected = [0.0, 0.0, -2.0 * SOLAR_PRESSURE_PA * 10.0 * 0.8**2]
    np.testing.assert_allclose(pressure(plate, [0.6, 0.0, 0.8]), expected, atol=1e-20)


def test_white_plate_adds_two_thirds_along_its_normal(plate: np.record) -> None:
    plate.diffuse = 1.0
    np.testing.assert_allclose(pressure(plate, [0, 0, 1])[2], -SOLAR_PRESSURE_PA * 10.0 * (1.0 + 2.0 / 3.0))


def test_both_sides_are_alike_and_the_edge_is_not_pushed(plate: np.record) -> None:
    plate.specular, plate.diffuse = 0.3, 0.2
    np.testing.assert_allclose(pressure(plate, [0.6, 0, -0.8]), pressure(plate, [0.6, 0, 0.8]) * [1, 1, -1])
    np.testing.assert_array_equal(pressure(plate, [1, 0, 0]), 0.0)


def test_sunlight_accelerates_turns_and_is_felt_by_the_accelerometer(plain_1: Scenario) -> None:
    scenario = with_truth(plain_1, solar_pressure=True)
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    dark_params, dark = dynamics_params.dss(plain_1), dynamics_params.initial_truth(plain_1)
    sun_C = quat.transform(truth.q_CH, quat.transform(truth.q_HI, params.sun_I))
    force = pressure(params.plate, sun_C)
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    kernels.step(dark_params, NO_FIELD, new(TRUTH_MEMORY), dark, QUIET)
    array = scenario.chaser.solar_array
    assert array is not None
    torque = np.cross(array.centre_m, force)
    np.testing.assert_allclose(truth.mean_force_C, force / 1000.0, rtol=1e-4)
    np.testing.assert_allclose(truth.w_CI_C - dark.w_CI_C, 0.02 * np.linalg.solve(J, torque), rtol=1e-4, atol=1e-15)
    gained = quat.to_matrix(truth.q_CH) @ (truth.v_CT_H - dark.v_CT_H)
    np.testing.assert_allclose(gained, 0.02 * force / 1000.0, rtol=1e-4, atol=1e-15)


# bending array


@pytest.fixture
def mode() -> np.record:
    mode = new(MODES)
    mode.n, mode.frequency[0], mode.coupling[0] = 1, 1.5, [7.0, -3.0, 2.0]
    mode.inertia_inverse = np.linalg.inv(J - np.outer(mode.coupling[0], mode.coupling[0]))
    return mode


def test_hub_and_mode_satisfy_their_coupled_equations(mode: np.record, rng: np.random.Generator) -> None:
    mode.damping = 0.02
    dw = np.empty(3)
    for _ in range(20):
        w, torque, eta, rate = rng.standard_normal(3), 10.0 * rng.standard_normal(3), *rng.standard_normal(2)
        load = torque.copy()
        spring = add_bending(mode, 0, w, eta, rate, load)
        angular_acceleration(J, mode.inertia_inverse, w, load, dw)
        bend = bending(mode, 0, spring, dw)
        d = mode.coupling[0]
        hub = J @ dw + np.cross(w, J @ w + d * rate) + d * bend - torque
        np.testing.assert_allclose(hub, 0.0, atol=1e-9)
        assert bend + 2 * 0.02 * 1.5 * rate + 1.5**2 * eta + d @ dw == pytest.approx(0.0, abs=1e-12)


def bent(plain_1: Scenario, damping: float) -> tuple[np.record, np.record]:
    scenario = with_truth(plain_1, flexible_array=True)
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    params.modes.damping = damping
    truth.w_CI_C, truth.eta, truth.eta_rate = [0.03, -0.04, 0.05], 0.4, -0.2
    return params, truth


def momentum(params: np.record, truth: np.record) -> np.ndarray:
    """Return the angular momentum of hub and array, (3,), N m s, inertial."""
    inner = params.inertia @ truth.w_CI_C + params.modes.coupling[0] * truth.eta_rate
    return np.asarray(quat.to_matrix(truth.q_HI).T @ quat.to_matrix(truth.q_CH).T @ inner)


def energy(params: np.record, truth: np.record) -> float:
    hub = 0.5 * truth.w_CI_C @ params.inertia @ truth.w_CI_C + truth.eta_rate * params.modes.coupling[0] @ truth.w_CI_C
    return float(hub + 0.5 * truth.eta_rate**2 + 0.5 * (params.modes.frequency[0] * truth.eta) ** 2)


def test_undamped_bending_keeps_momentum_and_energy(plain_1: Scenario) -> None:
    params, truth = bent(plain_1, 0.0)
    momentum_0, energy_0, w_0 = momentum(params, truth), energy(params, truth), truth.w_CI_C.copy()
    for _ in range(2000):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    assert np.abs(truth.w_CI_C - w_0).max() > 1e-3
    np.testing.assert_allclose(momentum(params, truth), momentum_0, atol=1e-7)
    assert energy(params, truth) == pytest.approx(energy_0, rel=1e-8)


def test_damping_takes_energy_and_no_momentum(plain_1: Scenario) -> None:
    params, truth = bent(plain_1, 0.05)
    momentum_0, energy_0 = momentum(params, truth), energy(params, truth)
    for _ in range(2000):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    np.testing.assert_allclose(momentum(params, truth), momentum_0, atol=1e-7)
    assert energy(params, truth) < energy_0 - 0.1


def test_torque_pulse_makes_the_array_swing_at_the_coupled_frequency(plain_1: Scenario) -> None:
    scenario = with_truth(plain_1, flexible_array=True)
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    params.modes.damping = 0.0
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(2, 7))
    assert truth.eta != 0.0
    swing = []
    for _ in range(3000):
        swing.append(float(truth.eta))
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    spectrum = np.abs(np.fft.rfft(swing))
    d = params.modes.coupling[0]
    coupled = params.modes.frequency[0] / math.sqrt(1.0 - d @ params.inertia_inverse @ d)
    assert np.fft.rfftfreq(3000, 0.02)[spectrum.argmax()] == pytest.approx(coupled / (2 * math.pi), abs=1.0 / 60.0)


# thrusters and mass


def test_thrusters_are_as_drawn_up_without_errors(rng: np.random.Generator) -> None:
    direction, force = np.eye(3), np.array([5.0, 6.0, 7.0])
    built, pushed = as_built(direction, force, 0.0, 0.0, rng.standard_normal((3, 3)))
    np.testing.assert_array_equal(built, direction)
    np.testing.assert_array_equal(pushed, force)


def test_tilt_and_scatter_have_the_sizes_asked_for(rng: np.random.Generator) -> None:
    n = 20000
    nominal = np.tile([0.0, 0.6, 0.8], (n, 1))
    built, pushed = as_built(nominal, np.full(n, 5.0), 0.01, 0.02, rng.standard_normal((n, 3)))
    np.testing.assert_allclose(np.linalg.norm(built, axis=1), 1.0, rtol=1e-14)
    assert np.std(built[:, 0]) == pytest.approx(0.01, rel=0.03)
    assert np.std(built @ [0.0, 0.8, -0.6]) == pytest.approx(0.01, rel=0.03)
    assert abs(np.mean(built[:, 0])) < 4e-4
    assert np.std(pushed) == pytest.approx(0.1, rel=0.03)


def test_errors_of_the_thrusters_reach_the_truth_only_with_draws(scheme_1: Scenario) -> None:
    draws = np.ones(dynamics_params.thruster_draws_shape(scheme_1))
    nominal, built = dynamics_params.dss(scheme_1), dynamics_params.dss(scheme_1, draws)
    n = nominal.n_thrusters
    np.testing.assert_allclose(built.thruster_force[:n], nominal.thruster_force[:n] * 1.01)
    cosine = np.sum(built.thruster_direction[:n] * nominal.thruster_direction[:n], axis=1)
    np.testing.assert_allclose(np.degrees(np.arccos(cosine)), 0.3 * math.sqrt(2.0), rtol=1e-6)


def test_offset_of_the_mass_centre_shortens_the_thrusters_arms(plain_1: Scenario) -> None:
    offset = np.array([0.01, -0.02, 0.03])
    moved = dynamics_params.dss(with_truth(plain_1, centre_of_mass_offset_m=tuple(offset)))
    nominal = dynamics_params.dss(plain_1)
    np.testing.assert_allclose(moved.thruster_position[:16], nominal.thruster_position[:16] - offset)


def test_reference_point_circles_the_mass_centre_of_a_free_spin(plain_1: Scenario) -> None:
    offset = np.array([0.05, 0.0, 0.0])
    scenario = with_truth(plain_1, centre_of_mass_offset_m=tuple(offset))
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    params.orbit_rate = 0.0  # H is inertial
    params.inertia, params.inertia_inverse = 1000.0 * np.eye(3), np.eye(3) / 1000.0
    truth.w_HI_H, truth.w_CI_C = 0.0, [0.0, 0.0, 0.3]
    start = Rotation.from_quat(truth.q_CH)
    centre = truth.r_CT_H + start.apply(offset)
    truth.v_CT_H = -start.apply(np.cross([0.0, 0.0, 0.3], offset))  # the mass centre stands still
    for _ in range(250):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, QUIET)
    now = Rotation.from_quat(truth.q_CH)
    np.testing.assert_allclose(truth.r_CT_H, centre - now.apply(offset), atol=1e-9)
    np.testing.assert_allclose(truth.v_CT_H, -now.apply(np.cross([0.0, 0.0, 0.3], offset)), atol=1e-9)
    # the IMU on the rim feels the pull towards the centre
    np.testing.assert_allclose(truth.mean_force_C, [0.3**2 * 0.05, 0.0, 0.0], atol=1e-12)


def test_accelerometer_off_the_mass_centre_agrees_with_the_velocity_it_gains(plain_1: Scenario) -> None:
    scenario = with_truth(plain_1, centre_of_mass_offset_m=(0.05, -0.04, 0.03))
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    params.orbit_rate = 0.0
    truth.w_HI_H = 0.0
    before = truth.v_CT_H.copy()
    kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(2, 7, 10))
    gained = quat.to_matrix(truth.q_CH) @ (truth.v_CT_H - before) / params.dt_s
    assert np.linalg.norm(np.cross(truth.w_CI_C, [0.05, -0.04, 0.03])) > 1e-6
    np.testing.assert_allclose(truth.mean_force_C, gained, atol=2e-6)


def test_mass_stays_where_loss_is_switched_off(plain_1: Scenario) -> None:
    scenario = with_truth(plain_1, mass_loss=False)
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    for _ in range(10):
        kernels.step(params, NO_FIELD, new(TRUTH_MEMORY), truth, firing(0))
    assert truth.mass_kg == scenario.chaser.mass_kg


# orbit


def test_elements_give_an_orbit_of_their_energy_momentum_and_periapsis() -> None:
    gm, a, e, inclination, node = 4.9e12, 1.938e6, 0.05, 1.1, 0.7
    r, v = state_of_elements(gm, a, e, inclination, node, 0.4, 0.0)
    h = np.cross(r, v)
    assert np.linalg.norm(r) == pytest.approx(a * (1.0 - e))
    assert r @ v == pytest.approx(0.0, abs=1e-3)
    assert 0.5 * v @ v - gm / np.linalg.norm(r) == pytest.approx(-0.5 * gm / a)
    np.testing.assert_allclose(
        h / np.linalg.norm(h),
        [math.sin(inclination) * math.sin(node), -math.sin(inclination) * math.cos(node), math.cos(inclination)],
    )
    assert r[2] / np.linalg.norm(r) == pytest.approx(math.sin(inclination) * math.sin(0.4))
    later, _ = state_of_elements(gm, a, e, inclination, node, 0.4, 1.2)
    assert np.linalg.norm(later) == pytest.approx(a * (1 - e**2) / (1 + e * math.cos(1.2)))
