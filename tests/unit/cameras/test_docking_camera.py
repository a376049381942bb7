"""Simulated television camera: its pose is that of the encoders at the time of their samples."""

from __future__ import annotations

import numpy as np
import pytest

from hil.checks.compatibility import check_monitor
from hil.config.load import load_rig, load_scenario, load_scene
from hil.config.rig import Rig
from hil.config.scenario import Initial, Scenario
from hil.config.tables.docking_monitor import DockingMonitorConfig
from hil.core.messages import CYCLE
from hil.maths import euler
from hil.params import bench as bench_params
from hil.parts.monitor.camera import EncoderTrack, RenderedCamera, view
from hil.parts.monitor.params import mounting
from hil.session.assembly import start_axes

STEP_S = 0.02
PLACED = DockingMonitorConfig(camera_position_m=(0.8, 0.1, -0.5), target_position_m=(-0.3, 0.05, -0.45))
STRAIGHT = np.array([0.0, 0.0, 0.0, 1.0])


def track_of(rig: Rig) -> EncoderTrack:
    return EncoderTrack(bench_params.bench(rig, STEP_S), mounting(PLACED))


def rows_at(t_s: np.ndarray, rail_m: np.ndarray, delays_s: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """Return rows (n,) of CYCLE whose encoders had ``rail_m`` (n, 3) some delays before."""
    rows = np.zeros(len(t_s), CYCLE)
    rows["t_s"] = t_s
    rows["sampled_s"] = t_s[:, None] - np.array(delays_s)
    rows["feedback"]["rail_m"] = rail_m
    return rows


def test_head_on_view_matches_the_mounting() -> None:
    d, phi = view(mounting(PLACED), np.array([5.0, 0.0, 0.0]), STRAIGHT)
    # camera from target in H: (5.8 + 0.3, 0.1 - 0.05, -0.5 + 0.45); y1 = -y_H, y2 = -z_H, y3 = x_H
    np.testing.assert_allclose(d, [-0.05, 0.05, 6.1], atol=1e-12)
    np.testing.assert_allclose(phi, 0.0, atol=1e-12)


def test_rotations_of_the_chaser_are_rotations_of_the_camera_about_its_axes() -> None:
    # S: x1 = -y_c, x2 = z_c, x3 = -x_c
    for angles, expected in (([0.0, 0.0, 0.01], [0.0, 0.01, 0.0]), ([0.0, 0.02, 0.0], [-0.02, 0.0, 0.0])):
        q = euler.to_quaternion(np.array(angles), euler.YAW_PITCH_ROLL)
        _, phi = view(mounting(DockingMonitorConfig()), np.array([5.0, 0.0, 0.0]), q)
        np.testing.assert_allclose(phi, expected, atol=1e-12)
    q = euler.to_quaternion(np.array([0.03, 0.0, 0.0]), euler.YAW_PITCH_ROLL)
    _, phi = view(mounting(DockingMonitorConfig()), np.array([5.0, 0.0, 0.0]), q)
    np.testing.assert_allclose(phi, [0.0, 0.0, -0.03], atol=1e-12)


def test_encoders_are_converted_to_the_pose_of_the_chaser(mock_rig: Rig, scheme_1: Scenario) -> None:
    at = Initial(position_m=(5.0, -0.3, 0.3), attitude_deg=(3.0, 3.0, -3.0))
    axes = start_axes(scheme_1.model_copy(update={"initial": at}), mock_rig)
    rows = rows_at(np.array([0.0, 1.0]), np.tile(axes.rail_m, (2, 1)))
    rows["feedback"]["gimbal_rad"] = axes.gimbal_rad
    track = track_of(mock_rig)
    track.add(rows)
    q = euler.to_quaternion(np.radians([3.0, 3.0, -3.0]), euler.YAW_PITCH_ROLL)
    expected = view(mounting(PLACED), np.array([5.0, -0.3, 0.3]), q)
    for found, wanted in zip(track(0.5), expected, strict=True):
        np.testing.assert_allclose(found, wanted, atol=1e-12)


@pytest.mark.parametrize("delays_s", [(0.0, 0.0), (0.013, 0.004)])
def test_the_position_belongs_to_the_time_of_the_sample(mock_rig: Rig, delays_s: tuple[float, float]) -> None:
    t = np.arange(0.0, 2.0, STEP_S)
    rail = np.column_stack((5.0 - 0.1 * (t - delays_s[0]), np.zeros_like(t), np.zeros_like(t)))
    whole, pieces = track_of(mock_rig), track_of(mock_rig)
    rows = rows_at(t, rail, delays_s)
    whole.add(rows)
    for start in range(0, len(rows), 7):
        pieces.add(rows[start : start + 7])
    for when in (0.011, 0.73, 1.9):
        np.testing.assert_allclose(whole(when)[0][2] - whole(1.0)[0][2], -0.1 * (when - 1.0), atol=1e-9)
        np.testing.assert_array_equal(pieces(when)[0], whole(when)[0])
    assert whole.covers(t[-1] - max(delays_s))
    assert not whole.covers(t[-1] + 1e-3)


def test_a_sample_that_is_read_twice_or_overtaken_counts_once(mock_rig: Rig) -> None:
    track = track_of(mock_rig)
    rail = np.array([[5.0, 0, 0], [4.0, 0, 0], [4.0, 0, 0], [9.0, 0, 0], [3.0, 0, 0]])
    rows = rows_at(np.arange(5) * 0.02, rail)
    rows["sampled_s"][:] = np.array([0.0, 0.02, 0.02, 0.01, 0.04])[:, None]
    track.add(rows)
    first, second, third = (track(t_s)[0][2] for t_s in (0.0, 0.02, 0.04))
    assert (second - first, third - second) == (pytest.approx(-1.0), pytest.approx(-1.0))
    assert track(0.01)[0][2] == pytest.approx(0.5 * (first + second))
    assert track(0.03)[0][2] == pytest.approx(0.5 * (second + third))


def test_frames_come_as_soon_as_the_encoders_cover_their_time_and_once(mock_rig: Rig) -> None:
    scene = load_scene("bright-cross").value
    camera = RenderedCamera(scene, DockingMonitorConfig(scene="bright-cross"), mock_rig, STEP_S, seed=3)
    t = np.arange(0.0, 0.2, STEP_S)
    rows = rows_at(t, np.tile([5.0, 0.0, 0.0], (len(t), 1)))
    got = []
    for row in rows[:, None]:
        camera.track.add(row)
        got += [(frame.number, frame.t_s, float(row["t_s"][0])) for frame in camera.frames()]
    numbers, times, known_at = np.array(got).T
    np.testing.assert_array_equal(numbers, np.arange(10))  # 50 fields per second
    np.testing.assert_allclose(times, numbers * 0.02)
    assert (known_at >= times - 1e-12).all()
    assert (known_at < times + STEP_S + 1e-9).all()


def test_a_run_rejects_a_missing_scene() -> None:
    def said(*settings: str) -> list[str]:
        return [str(problem) for problem in check_monitor(load_scenario("scheme-1", settings), load_rig("mock"))]

    assert said() == []
    assert said("monitor.scene=missing") == []  # no reader
    rendered = "monitor.source=rendered"
    assert said(rendered) == []
    assert said(rendered, "monitor.target=backup") == []
    assert "unknown scene: give atv, bright-cross" in said(rendered, "monitor.scene=missing")[0]
    text = 'monitor.target: "backup": scene bright-cross has the basic target alone'
    assert said(rendered, "monitor.scene=bright-cross", "monitor.target=backup")[0].endswith(text)
