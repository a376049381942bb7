"""Geometry of the docking camera: the paper's matrix, and the image axes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hil.maths import quat
from hil.models import docking_view


def test_attitude_is_the_papers_matrix_to_first_order() -> None:
    p1, p2, p3 = phi = np.array([2e-5, -3e-5, 1e-5])
    printed = np.array([[1.0, -p3, p2], [-p3, -1.0, p1], [p2, -p1, -1.0]])
    np.testing.assert_allclose(docking_view.attitude(phi), printed, atol=2e-9)


def test_attitude_is_exact_for_large_angles() -> None:
    phi = np.array([0.7, -1.1, 0.4])
    expected = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(phi).as_matrix()
    np.testing.assert_allclose(docking_view.attitude(phi), expected, atol=1e-14)


def test_to_camera_undoes_y_is_d_plus_a_x(rng: np.random.Generator) -> None:
    for _ in range(20):
        d, phi, x = rng.standard_normal((3, 3))
        a = docking_view.attitude(phi)
        np.testing.assert_allclose(docking_view.to_camera(a, d, d + a @ x), x, atol=1e-13)


def test_ahead_is_in_the_middle_right_is_right_and_up_is_up() -> None:
    def seen(d: list[float], phi: list[float]) -> tuple[float, float]:
        x = docking_view.to_camera(docking_view.attitude(np.array(phi)), np.array(d), np.zeros(3))
        u, v = docking_view.project_point(1000.0, 400.0, 300.0, x)
        return float(u), float(v)

    assert seen([0.0, 0.0, 10.0], [0.0, 0.0, 0.0]) == (400.0, 300.0)
    # the camera stands to the side of +y1 and of +y2: the target is to its left, and (x2 = -y2) above it
    assert seen([0.1, 0.0, 10.0], [0.0, 0.0, 0.0]) == (390.0, 300.0)
    np.testing.assert_allclose(seen([0.0, 0.1, 10.0], [0.0, 0.0, 0.0]), (400.0, 290.0))
    # the paper's X_O = -f d1/d3 - f phi2, Y_O = f d2/d3 + f phi1, with v = cy - Y
    np.testing.assert_allclose(seen([0.0, 0.0, 10.0], [1e-3, 2e-3, 0.0]), (398.0, 299.0), atol=1e-5)


def test_the_pose_of_a_camera_before_the_ring_is_d_and_phi(rng: np.random.Generator) -> None:
    half_turn = np.diag([1.0, -1.0, -1.0])
    d, phi = np.empty(3), np.empty(3)
    for _ in range(20):
        t_v, turn, p_t = rng.standard_normal((3, 3))
        q_vt = quat.from_rotation_vector(turn)
        docking_view.of_camera_pose(t_v, q_vt, d, phi)
        seen = docking_view.to_camera(docking_view.attitude(phi), d, half_turn @ p_t)
        np.testing.assert_allclose(seen, quat.to_matrix(q_vt) @ p_t + t_v, atol=1e-12)
