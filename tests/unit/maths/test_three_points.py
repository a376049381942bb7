"""Three points in one camera: the true pose is always among the solutions."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hil.maths import cholesky
from hil.vmu.kernels.p3p import ray_lengths


def test_the_true_ray_lengths_are_among_the_solutions(rng: np.random.Generator) -> None:
    scratch = np.empty((3, 3)), np.empty((3, 2)), np.empty(2)
    out = np.empty((4, 3))
    for _ in range(500):
        points = 0.12 * rng.standard_normal((3, 3))
        turn = Rotation.from_rotvec(0.5 * rng.standard_normal(3))
        seen = turn.apply(points) + np.array(
            [0.2 * rng.standard_normal(), 0.2 * rng.standard_normal(), rng.uniform(0.6, 12.0)]
        )
        lengths = np.linalg.norm(seen, axis=1)
        rays = seen / lengths[:, None]
        squares = [float(((points[i] - points[j]) ** 2).sum()) for i, j in ((0, 1), (0, 2), (1, 2))]
        found = ray_lengths(rays[0], rays[1], rays[2], *squares, *scratch, out)
        assert min(np.abs(out[k] - lengths).max() for k in range(found)) < 1e-5


def test_a_triangle_seen_head_on_is_not_lost_to_noise(rng: np.random.Generator) -> None:
    angles = np.radians([0.0, 120.0, 240.0])
    points = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.full(3, 8.0)])
    scratch, out = (np.empty((3, 3)), np.empty((3, 2)), np.empty(2)), np.empty((4, 3))
    side = 3.0 * 0.12**2
    for _ in range(200):
        rays = points / points[:, 2:] + np.column_stack([4e-5 * rng.standard_normal((3, 2)), np.zeros(3)])
        rays /= np.linalg.norm(rays, axis=1)[:, None]
        found = ray_lengths(rays[0], rays[1], rays[2], side, side, side, *scratch, out)
        assert min((np.abs(out[k] - 8.0).max() for k in range(found)), default=9.0) < 0.15


def test_cholesky_solves_and_inverts(rng: np.random.Generator) -> None:
    root = rng.standard_normal((6, 6))
    a, b = root @ root.T + np.eye(6), rng.standard_normal(6)
    low, x, inverse = np.zeros((6, 6)), np.empty(6), np.empty((6, 6))
    assert cholesky.factor(a, 6, low)
    cholesky.solve(low, 6, b, x)
    cholesky.invert(low, inverse)
    np.testing.assert_allclose(a @ x, b, atol=1e-10)
    np.testing.assert_allclose(a @ inverse, np.eye(6), atol=1e-10)
    assert not cholesky.factor(-a, 6, low)
