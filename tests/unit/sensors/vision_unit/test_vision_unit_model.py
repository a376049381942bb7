"""The virtual vision unit: its noise law, its covariance, and that both agree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.maths import quat
from hil.sensors.mounting import camera_pose
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.model import add_noise, range_factor

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def measure(params, mounting, r, q, noise, t_v, q_vt, covariance) -> None:  # type: ignore[no-untyped-def]
    """Write the noisy pose of a chaser at ``r``, ``q``."""
    camera_pose(mounting, r, q, t_v, q_vt)
    add_noise(params, r, noise, t_v, q_vt, covariance)


@pytest.mark.parametrize(("distance", "factor"), [(0.4, 1.0), (2.0, 1.0), (4.0, 2.0), (10.0, 5.0)])
def test_noise_is_table_i_up_to_the_reference_range_and_grows_in_proportion(
    scheme_1: Scenario, mock_rig: Rig, distance: float, factor: float
) -> None:
    params, mounting = vmu_params.model(scheme_1), vmu_params.mounting(mock_rig)
    r = distance * np.array([2.0, -1.0, 2.0]) / 3.0
    assert range_factor(params, r) == pytest.approx(factor)
    t_v, q_vt, covariance = np.empty(3), np.empty(4), np.full((6, 6), np.nan)
    measure(params, mounting, r, IDENTITY, np.zeros(6), t_v, q_vt, covariance)
    sigmas = np.repeat([0.005 * factor, math.radians(0.033) * factor], 3)
    np.testing.assert_allclose(covariance, np.diag(sigmas**2), atol=1e-18)


def test_without_noise_the_unit_reports_the_true_camera_pose(scheme_1: Scenario, mock_rig: Rig) -> None:
    params, mounting = vmu_params.model(scheme_1), vmu_params.mounting(mock_rig)
    r, q = np.array([4.0, 0.2, -0.3]), Rotation.from_rotvec([0.1, -0.2, 0.3]).as_quat()
    seen, true = (np.empty(3), np.empty(4)), (np.empty(3), np.empty(4))
    measure(params, mounting, r, q, np.zeros(6), *seen, np.empty((6, 6)))
    camera_pose(mounting, r, q, *true)
    np.testing.assert_array_equal(seen[0], true[0])
    np.testing.assert_allclose(seen[1], true[1], atol=1e-16)


def test_rotation_error_turns_vectors_by_exp_of_e_about_the_cameras_axes(scheme_1: Scenario, mock_rig: Rig) -> None:
    params, mounting = vmu_params.model(scheme_1), vmu_params.mounting(mock_rig)
    params.sigma_angle = 0.1
    r, q = np.array([1.0, 0.0, 0.0]), Rotation.from_rotvec([0.1, -0.2, 0.3]).as_quat()
    noise = np.array([0.0, 0.0, 0.0, 1.0, -2.0, 3.0])
    seen, true = (np.empty(3), np.empty(4)), (np.empty(3), np.empty(4))
    measure(params, mounting, r, q, noise, *seen, np.empty((6, 6)))
    camera_pose(mounting, r, q, *true)
    expected = Rotation.from_rotvec(0.1 * noise[3:]).as_matrix() @ quat.to_matrix(true[1])
    np.testing.assert_allclose(quat.to_matrix(seen[1]), expected, atol=1e-14)


def test_scatter_of_reports_agrees_with_the_reported_covariance(
    scheme_1: Scenario, mock_rig: Rig, rng: np.random.Generator
) -> None:
    params, mounting = vmu_params.model(scheme_1), vmu_params.mounting(mock_rig)
    r, q = np.array([10.0, -0.5, 0.5]), Rotation.from_rotvec([0.05, -0.05, 0.1]).as_quat()
    true_t, true_q = np.empty(3), np.empty(4)
    camera_pose(mounting, r, q, true_t, true_q)
    n, total = 2000, np.zeros(6)
    t_v, q_vt, covariance = np.empty(3), np.empty(4), np.empty((6, 6))
    for _ in range(n):
        measure(params, mounting, r, q, rng.standard_normal(6), t_v, q_vt, covariance)
        e = -quat.to_rotation_vector(quat.multiply(q_vt, quat.conjugate(true_q)))
        total += np.concatenate([t_v - true_t, e]) ** 2 / np.diag(covariance)
    assert (total > chi2.ppf(1e-4, n)).all()
    assert (total < chi2.ppf(1 - 1e-4, n)).all()
