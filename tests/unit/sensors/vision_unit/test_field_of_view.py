"""LEDs in view of both cameras: projections by hand."""

from __future__ import annotations

import numpy as np
import pytest

from hil.bench.field_of_view import view_margins
from hil.config.rig import Rig
from hil.maths.quat import from_rotation_vector
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.camera import edge_distance, view_margin

ALIGNED = np.array([0.0, 0.0, 0.0, 1.0])
HALF_PX, FOCAL_PX, BASELINE_M = 512.0, 1200.0, 0.20


def margin(rig: Rig, t_v: tuple[float, float, float], q_vt: np.ndarray = ALIGNED) -> float:
    camera, leds = vmu_params.camera(rig)
    return float(view_margin(camera, leds, np.array(t_v), q_vt))


def test_shipped_ring_has_six_leds_and_one_of_them_is_raised(mock_rig: Rig) -> None:
    leds = np.array(mock_rig.vmu.leds_m)
    np.testing.assert_allclose(np.hypot(leds[:, 0], leds[:, 1]), 0.12)
    np.testing.assert_allclose(leds[:, 2], [-0.06, 0, 0, 0, 0, 0])


def test_edge_distance_is_that_of_the_pinhole_projection(mock_rig: Rig) -> None:
    camera, _ = vmu_params.camera(mock_rig)
    assert edge_distance(camera, 0.1, -0.3, 1.0) == pytest.approx(HALF_PX - FOCAL_PX * 0.3)
    assert edge_distance(camera, -0.4, 0.1, 1.0) == pytest.approx(HALF_PX - FOCAL_PX * 0.4)
    assert edge_distance(camera, 0.5, 0.0, 1.0) < 0.0
    assert edge_distance(camera, 0.0, 0.0, -1.0) == -np.inf


def test_ring_before_the_left_camera_is_lost_in_the_right_one_first(mock_rig: Rig) -> None:
    # the LED at x = -0.12 m is 0.32 m left of the right camera's axis
    closest_m = (0.12 + BASELINE_M) * FOCAL_PX / HALF_PX
    assert closest_m == pytest.approx(0.75)
    assert margin(mock_rig, (0.0, 0.0, closest_m + 0.001)) > 0.0
    assert margin(mock_rig, (0.0, 0.0, closest_m - 0.001)) < 0.0
    assert margin(mock_rig, (0.0, 0.0, 1.0)) == pytest.approx(HALF_PX - FOCAL_PX * 0.32)


def test_ring_between_the_cameras_is_seen_from_about_0_6_m_on(mock_rig: Rig) -> None:
    # the raised LED, 0.22 m from the left camera's axis, is 0.06 m nearer than the ring
    closest_m = (0.12 + 0.5 * BASELINE_M) * FOCAL_PX / HALF_PX + 0.06
    assert closest_m == pytest.approx(0.6, abs=0.03)
    assert margin(mock_rig, (0.1, 0.0, closest_m + 0.001)) > 0.0
    assert margin(mock_rig, (0.1, 0.0, closest_m - 0.001)) < 0.0


def test_rotated_camera_loses_the_ring(mock_rig: Rig) -> None:
    turned = from_rotation_vector(np.radians([0.0, 10.0, 0.0]))
    assert margin(mock_rig, (0.0, 0.0, 2.0)) > 0.0
    assert margin(mock_rig, (0.0, 0.0, 2.0)) > margin(mock_rig, (0.4, 0.0, 2.0), turned)
    assert margin(mock_rig, (1.0, 0.0, 2.0)) < 0.0


def test_margins_of_a_bench_use_its_mounting(mock_rig: Rig) -> None:
    # at the ready point the camera, 0.6 m behind the reference point, is 1.0 m from the ring
    camera, leds = vmu_params.camera(mock_rig)
    bench, out = bench_params.bench(mock_rig, 0.02), np.empty(2)
    rail = np.array([[0.4, 0.0, -0.35], [0.1, 0.0, -0.35]])
    view_margins(bench, vmu_params.mounting(mock_rig), camera, leds, rail, np.zeros((2, 3)), out)
    assert out[0] == pytest.approx(HALF_PX - FOCAL_PX * 0.32)
    assert out[1] < 0.0
