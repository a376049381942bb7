"""The Moon's gravity: harmonics, their turning with the Moon, and the difference over a few metres."""

from __future__ import annotations

from decimal import Decimal, getcontext

import numpy as np
import pytest

from hil.core.messages import new
from hil.dynamics import central_gravity
from tests.support import moon_reference as reference


@pytest.fixture
def field() -> np.ndarray:
    return np.asarray(central_gravity.field_table(*reference.coefficients()))


@pytest.fixture
def params() -> np.record:
    params = new(central_gravity.GRAVITY_PARAMS)
    params.gm, params.radius, params.degree = reference.GM, reference.RADIUS_M, reference.DEGREE
    return params


def places(rng: np.random.Generator, n: int) -> np.ndarray:
    r = rng.standard_normal((n, 3))
    return np.asarray(r * rng.uniform(1.75e6, 2.5e6, (n, 1)) / np.linalg.norm(r, axis=1)[:, None])


def test_harmonics_agree_with_another_recursion_to_1e_12_of_gravity(
    params: np.record, field: np.ndarray, rng: np.random.Generator
) -> None:
    for r in places(rng, 100):
        found = central_gravity.harmonics(params, field, *r)
        np.testing.assert_allclose(found, reference.harmonics(r), atol=1e-12 * params.gm / (r @ r) * 1e-3)


def test_harmonics_are_the_gradient_of_the_potential(
    params: np.record, field: np.ndarray, rng: np.random.Generator
) -> None:
    h = 200.0
    for r in places(rng, 20):
        slope = [
            (8 * (reference.potential(r + h * e) - reference.potential(r - h * e)))
            - (reference.potential(r + 2 * h * e) - reference.potential(r - 2 * h * e))
            for e in np.eye(3)
        ]
        found = central_gravity.harmonics(params, field, *r)
        np.testing.assert_allclose(found, np.array(slope) / (12 * h), atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_poles_are_places_like_any_other(params: np.record, field: np.ndarray, sign: float) -> None:
    at_pole = np.array(central_gravity.harmonics(params, field, 0.0, 0.0, sign * 1.938e6))
    beside = np.array(central_gravity.harmonics(params, field, 1e-3, -2e-3, sign * 1.938e6))
    assert np.isfinite(at_pole).all()
    np.testing.assert_allclose(at_pole, beside, atol=1e-12)
    np.testing.assert_allclose(at_pole, reference.harmonics(np.array([0.0, 0.0, sign * 1.938e6])), atol=1e-16)


def test_oblateness_alone_has_its_closed_form_over_the_pole(params: np.record) -> None:
    c, s = reference.coefficients()
    params.degree = 2
    c[2, 1:] = s[2, 1:] = 0.0
    table, r = central_gravity.field_table(c, s), 1.938e6
    j2 = -np.sqrt(5.0) * c[2, 0]
    expected = 3.0 * params.gm * j2 * params.radius**2 / r**4
    np.testing.assert_allclose(central_gravity.harmonics(params, table, 0.0, 0.0, r), [0.0, 0.0, expected], atol=1e-18)


def test_field_turns_with_the_moon(params: np.record, field: np.ndarray) -> None:
    params.rotation, params.rate = 0.4, 2e-3
    r, out = np.array([1.2e6, -0.9e6, 1.1e6]), np.empty(3)
    central_gravity.acceleration(params, field, 300.0, r, out)
    np.testing.assert_allclose(out, reference.gravity(r, 0.4 + 300.0 * 2e-3), rtol=1e-13)


def test_point_mass_is_flown_below_degree_two(params: np.record, field: np.ndarray) -> None:
    params.degree = 1
    r, out = np.array([1.2e6, -0.9e6, 1.1e6]), np.empty(3)
    central_gravity.acceleration(params, field, 0.0, r, out)
    np.testing.assert_allclose(out, -params.gm * r / np.linalg.norm(r) ** 3, rtol=1e-15)


@pytest.mark.parametrize("size_m", [1e-3, 1.0, 1e3, 1e6])
def test_difference_of_a_point_mass_is_free_of_cancellation(
    params: np.record, field: np.ndarray, size_m: float
) -> None:
    getcontext().prec = 50
    params.degree = 0
    r, rho = np.array([1.3e6, -1.1e6, 0.9e6]), size_m * np.array([0.6, -0.5, 0.4])
    target, difference = np.empty(3), np.empty(3)
    central_gravity.differential(params, field, 0.0, r, rho, target, difference)

    def pull(place: list[Decimal]) -> list[Decimal]:
        squared = sum((value * value for value in place), Decimal(0))
        return [-Decimal(float(params.gm)) * value / (squared * squared.sqrt()) for value in place]

    near = pull([Decimal(float(x)) for x in r])
    far = pull([Decimal(float(x)) + Decimal(float(d)) for x, d in zip(r, rho, strict=True)])
    exact = [float(b - a) for a, b in zip(near, far, strict=True)]
    np.testing.assert_allclose(difference, exact, rtol=1e-13)
    np.testing.assert_allclose(target, [float(a) for a in near], rtol=1e-15)


def test_difference_of_the_whole_field_is_that_of_two_places(params: np.record, field: np.ndarray) -> None:
    r, rho = np.array([1.3e6, -1.1e6, 0.9e6]), np.array([6e4, -5e4, 4e4])
    target, difference = np.empty(3), np.empty(3)
    central_gravity.differential(params, field, 0.0, r, rho, target, difference)
    np.testing.assert_allclose(target, reference.gravity(r, 0.0), rtol=1e-14)
    np.testing.assert_allclose(difference, reference.gravity(r + rho, 0.0) - reference.gravity(r, 0.0), rtol=1e-12)
