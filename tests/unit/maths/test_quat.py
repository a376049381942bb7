"""Quaternions against scipy, whose matrix of the same four numbers is the transpose of A."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from hil.maths import quat


def cross_matrix(v: np.ndarray) -> np.ndarray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def unit_quaternions(count: int, seed: int) -> np.ndarray:
    q = np.random.default_rng(seed).standard_normal((count, 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


def test_matrix_is_the_transpose_of_scipys() -> None:
    for q in unit_quaternions(50, 1):
        np.testing.assert_allclose(quat.to_matrix(q), Rotation.from_quat(q).as_matrix().T, atol=1e-15)


def test_product_of_quaternions_is_the_product_of_matrices_in_the_same_order() -> None:
    for p, q in zip(unit_quaternions(50, 2), unit_quaternions(50, 3), strict=True):
        product = quat.multiply(p, q)
        np.testing.assert_allclose(quat.to_matrix(product), quat.to_matrix(p) @ quat.to_matrix(q), atol=1e-14)
        assert np.linalg.norm(product) == pytest.approx(1.0, abs=1e-14)


def test_conjugate_undoes_the_transformation() -> None:
    for q in unit_quaternions(20, 4):
        np.testing.assert_allclose(quat.multiply(quat.conjugate(q), q), [0.0, 0.0, 0.0, 1.0], atol=1e-15)


def test_transform_takes_a_vector_to_the_turned_frame_and_transform_back_returns_it() -> None:
    vectors = np.random.default_rng(5).standard_normal((50, 3))
    for q, v in zip(unit_quaternions(50, 6), vectors, strict=True):
        np.testing.assert_allclose(quat.transform(q, v), Rotation.from_quat(q).inv().apply(v), atol=1e-14)
        np.testing.assert_allclose(quat.transform_back(q, v), Rotation.from_quat(q).apply(v), atol=1e-14)


def test_a_frame_turned_by_yaw_sees_the_old_x_axis_at_minus_y() -> None:
    q = quat.from_rotation_vector(np.array([0.0, 0.0, math.pi / 2]))
    np.testing.assert_allclose(quat.transform(q, np.array([1.0, 0.0, 0.0])), [0.0, -1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("scale", [0.0, 1e-12, 1e-8, 1e-6, 1e-3, 0.05, 0.0577, 0.0578, 1.0, 3.0])
def test_rotation_vector_gives_the_matrix_exponential_of_minus_its_cross_product(scale: float) -> None:
    phi = scale * np.array([2.0, -1.0, 2.0]) / 3.0
    a = quat.to_matrix(quat.from_rotation_vector(phi))
    np.testing.assert_allclose(a, expm(-cross_matrix(phi)), atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-9, 1e-6, 1e-3, 0.0999, 0.1001, 0.5, 3.0, math.pi - 1e-9])
def test_rotation_vector_survives_the_round_trip(angle: float) -> None:
    phi = angle * np.array([1.0, 2.0, -2.0]) / 3.0
    np.testing.assert_allclose(quat.to_rotation_vector(quat.from_rotation_vector(phi)), phi, rtol=1e-9, atol=1e-15)


def test_rotation_vector_is_the_shortest_turn_for_both_signs_of_a_quaternion() -> None:
    for q in unit_quaternions(50, 7):
        phi = quat.to_rotation_vector(q)
        assert np.linalg.norm(phi) <= math.pi + 1e-12
        np.testing.assert_allclose(quat.to_rotation_vector(-q), phi, atol=1e-14)
        np.testing.assert_allclose(phi, Rotation.from_quat(q).as_rotvec(), atol=1e-13)


def test_quaternion_of_a_matrix_is_found_at_every_angle() -> None:
    half_turns = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0.6, 0.8, 0, 0], [0, 0.6, -0.8, 0]])
    near_half_turns = np.hstack([half_turns[:, :3], np.full((5, 1), 1e-9)])
    for q in np.vstack([unit_quaternions(200, 8), half_turns, near_half_turns]):
        a = quat.to_matrix(q)
        found = quat.from_matrix(a)
        np.testing.assert_allclose(quat.to_matrix(found), a, atol=1e-14)
        assert found[3] >= 0.0
        assert np.linalg.norm(found) == pytest.approx(1.0, abs=1e-15)


def test_normalise_restores_unit_length_and_keeps_the_direction() -> None:
    q = 1.7 * unit_quaternions(1, 9)[0]
    kept = q / np.linalg.norm(q)
    quat.normalise(q)
    np.testing.assert_allclose(q, kept, atol=1e-15)


@pytest.mark.parametrize("excess", [4e-6, 2e-6, 1e-9, -2e-6, -4e-6])
def test_normalise_is_exact_on_both_sides_of_its_series(excess: float) -> None:
    for q in unit_quaternions(20, 13) * (1.0 + excess):
        quat.normalise(q)
        assert np.linalg.norm(q) == pytest.approx(1.0, abs=3e-16)


def test_rate_of_change_is_that_of_a_frame_turning_at_the_body_rate() -> None:
    rates = np.random.default_rng(10).standard_normal((30, 3))
    step = 1e-5
    for q, w in zip(unit_quaternions(30, 11), rates, strict=True):
        change = np.empty(4)
        quat.rate_of_change(q, w, change)
        # scipy: q(t) = q0 * exp(w t), w in body axes
        after = (Rotation.from_quat(q) * Rotation.from_rotvec(step * w)).as_quat()
        before = (Rotation.from_quat(q) * Rotation.from_rotvec(-step * w)).as_quat()
        after, before = after * np.sign(after @ q), before * np.sign(before @ q)
        np.testing.assert_allclose(change, (after - before) / (2.0 * step), atol=1e-9)


def test_rate_of_change_keeps_the_norm() -> None:
    change = np.empty(4)
    for q in unit_quaternions(20, 12):
        quat.rate_of_change(q, np.array([0.3, -0.7, 0.2]), change)
        assert change @ q == pytest.approx(0.0, abs=1e-15)
