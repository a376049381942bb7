"""The harmonics as a step holds them: four places at once, and no further from the field than they may be."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.dynamics import central_gravity
from hil.dynamics.cached_gravity import CACHED_GRAVITY, interpolate_perturbation
from hil.params import dynamics as dynamics_params
from tests.support import moon_reference as reference


def test_each_of_four_places_has_its_own_pull(scheme_2: Scenario, rng: np.random.Generator) -> None:
    params, field = dynamics_params.dss(scheme_2).gravity, dynamics_params.field(scheme_2)
    places = rng.normal(size=(4, 3))
    places *= (rng.uniform(1.75e6, 2.5e6, 4) / np.linalg.norm(places, axis=1))[:, None]
    out = np.empty((4, 3))
    central_gravity.harmonics_of_four(params, field, places, out)
    for place, pull in zip(places, out, strict=True):
        np.testing.assert_allclose(pull, reference.harmonics(place), rtol=0.0, atol=1e-14)
        np.testing.assert_array_equal(pull, central_gravity.harmonics(params, field, *place))


@pytest.mark.parametrize("t_s", [0.0, 5000.0])
def test_held_pull_is_that_of_the_step(scheme_2: Scenario, t_s: float) -> None:
    dss, field, truth = (
        dynamics_params.dss(scheme_2),
        dynamics_params.field(scheme_2),
        dynamics_params.initial_truth(scheme_2),
    )
    r, v, dt = truth.r_T_I, truth.v_T_I, dss.dt_s
    rho, rate = np.array([7.0, -5.0, 4.0]), np.array([0.02, 0.03, -0.01])
    held, near = np.empty((4, 3)), np.empty(3)
    central_gravity.sample_perturbation(dss.gravity, field, t_s, r, v, rho, rate, dt, held)
    central_gravity.acceleration(dss.gravity, field, t_s, r, near)
    for row, share in enumerate((0.0, 0.5, 1.0)):
        t = share * dt
        there = r + t * v + 0.5 * t * t * near
        np.testing.assert_allclose(held[row], _pull(dss.gravity, t_s + t, there), rtol=0.0, atol=1e-13)
    # what the held difference leaves out at the ends of a step, 1e-6 m in 400 s would be 1e-11 m/s^2
    for t in (0.0, dt):
        there = r + t * v + 0.5 * t * t * near
        apart = _pull(dss.gravity, t_s + t, there + rho + t * rate) - _pull(dss.gravity, t_s + t, there)
        np.testing.assert_allclose(held[3], apart, rtol=0.0, atol=2e-13)
        assert np.abs(held[3]).max() > 1e-10


def _pull(params: np.record, t_s: float, r: np.ndarray) -> np.ndarray:
    """Return the harmonics' pull in inertial axes, by the reference's recursion."""
    angle = params.rotation + params.rate * t_s
    distance = float(np.linalg.norm(r))
    return reference.gravity(r, angle) + reference.GM / distance**3 * r


def test_point_mass_alone_holds_nothing(scheme_2: Scenario) -> None:
    dss, truth = dynamics_params.dss(scheme_2), dynamics_params.initial_truth(scheme_2)
    dss.gravity.degree = 0
    held = np.full((4, 3), np.nan)
    central_gravity.sample_perturbation(
        dss.gravity, np.zeros((1, 1, 6)), 0.0, truth.r_T_I, truth.v_T_I, np.ones(3), np.ones(3), 0.02, held
    )
    np.testing.assert_array_equal(held, 0.0)


@pytest.mark.parametrize("dt", [0.02, 0.07, 1.0])
def test_pull_between_two_evaluations_is_that_of_the_place(scheme_2: Scenario, dt: float) -> None:
    dss, field, truth = (
        dynamics_params.dss(scheme_2),
        dynamics_params.field(scheme_2),
        dynamics_params.initial_truth(scheme_2),
    )
    r, v, near = truth.r_T_I.copy(), truth.v_T_I.copy(), np.empty(3)
    rho, rate = np.array([7.0, -5.0, 4.0]), np.array([0.02, 0.03, -0.01])
    span, step, evaluated = new(CACHED_GRAVITY), np.empty((4, 3)), 0
    central_gravity.acceleration(dss.gravity, field, 0.0, r, near)
    for k in range(60):
        t = k * dt
        if t > 1.0:
            break
        there, then = r + t * v + 0.5 * t * t * near, v + t * near
        before = span.pull.copy()
        interpolate_perturbation(dss.gravity, dss.forces, field, t, there, then, rho + t * rate, rate, dt, span, step)
        evaluated += not np.array_equal(before, span.pull)
        for row, share in enumerate((0.0, 0.5, 1.0)):
            at = there + share * dt * then + 0.5 * (share * dt) ** 2 * near
            np.testing.assert_allclose(step[row], _pull(dss.gravity, t + share * dt, at), rtol=0.0, atol=2e-11)
        exact = _pull(dss.gravity, t, there + rho + t * rate) - _pull(dss.gravity, t, there)
        np.testing.assert_allclose(step[3], exact, rtol=0.0, atol=5e-3 * np.abs(exact).max() * max(1.0, dt / 0.4))
    assert evaluated == {0.02: 3, 0.07: 3, 1.0: 2}[dt]
