"""Pose estimators: printed targets on images of another renderer, the plug, and invalid estimates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.errors import BadInput, DeviceError
from hil.vmu.board_render import BoardRenderer
from hil.vmu.boards import BoardEstimator, refined
from hil.vmu.estimators import FlatTarget, PoseEstimate, make_estimator, solve_pair
from hil.vmu.geometry import EXACT, camera_pair
from hil.vmu.render import RingAppearance
from hil.vmu.unit import VisionUnit
from tests.support.board_pixels import board_image
from tests.support.vmu_pixels import Array, Image

EXAMPLE = Path(__file__).parents[3] / "examples" / "pose_estimator_python"
FOCAL_PX, SHAPE, BASELINE_M, RIGHT_TURN = 800.0, (480, 640), np.array([0.2, 0.0, 0.0]), np.array([0.0, -0.05, 0.01])
TAGS = {"tags": [[3, 0.16, 0.0, 0.0]]}
LENS = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}


def geometry(way: str | None = "opencv") -> VmuGeometry:
    return VmuGeometry(
        print=way,
        leds_m=((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (-0.1, 0.0, 0.0)),
        left=LENS, right=LENS, baseline_m=tuple(BASELINE_M), right_rotation_rad=tuple(RIGHT_TURN), tolerances=EXACT,
    )  # fmt: skip


def pair(estimator: Any, turn: Array, t_v: Array, rng: np.random.Generator) -> tuple[Image, Image]:
    """Return both images of the estimator's target."""
    board, back = estimator.board, Rotation.from_rotvec(RIGHT_TURN).inv()
    size = (board.width_m, board.height_m)
    right = (back * Rotation.from_rotvec(turn)).as_rotvec(), back.apply(t_v - BASELINE_M)
    images = [board_image(board.image, size, FOCAL_PX, SHAPE, *at, rng) for at in ((turn, t_v), right)]
    return images[0], images[1]


def corners_in(estimator: BoardEstimator, image: Image) -> dict[int, tuple[float, float]]:
    """Return the corners that the estimator finds in an image."""
    return estimator._readers[0](estimator._detect(image))


def error(estimate: PoseEstimate, turn: Array, t_v: Array) -> Array:
    """Return the error (6,) of an estimate, m and rad."""
    away = Rotation.from_quat(estimate.q_vt).inv() * Rotation.from_rotvec(turn).inv()
    return np.concatenate([estimate.t_v - t_v, away.as_rotvec()])


@pytest.mark.parametrize(
    ("name", "settings", "distances"), [("apriltag", TAGS, (0.7, 1.5, 2.5)), ("charuco", {}, (0.6, 0.9))]
)
def test_pose_of_a_printed_target_is_within_its_sigmas(
    name: str, settings: dict[str, Any], distances: tuple[float, ...]
) -> None:
    estimator, rng, ratios = make_estimator(name, geometry(), settings), np.random.default_rng(3), []
    for z_m in distances:
        turn, t_v = np.array([0.25, -0.2, 0.5]), np.array([0.08, 0.03, z_m])
        estimate = estimator.solve(*pair(estimator, turn, t_v, rng), 1.0)
        assert isinstance(estimate, PoseEstimate)
        assert estimate.status == "ok"
        ratios.append(error(estimate, turn, t_v) / np.sqrt(np.diag(estimate.covariance)))
        assert np.linalg.norm(error(estimate, turn, t_v)[:3]) < 0.003 * z_m
    assert np.abs(ratios).max() < 4.0


def test_rendered_edges_are_in_place_wherever_they_lie_in_a_pixel() -> None:
    """A print that was blurred after the sampling had a ripple of 0.05 px, the same in image after image."""
    picture: Image = np.full((300, 300), 255, np.uint8)
    picture[75:225, 75:225] = 0
    square = 0.05 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    quiet = RingAppearance(electrons_per_level=1e6, read_noise_levels=0.0)
    renderer = BoardRenderer(camera_pair(geometry()), FlatTarget(picture, 0.2, 0.2), quiet)
    turn, off = Rotation.from_rotvec([0.0, 0.0, 0.02]), []
    for shift_px in np.linspace(0.0, 0.9, 7):
        t_v = np.array([shift_px / FOCAL_PX, 0.7 * shift_px / FOCAL_PX, 1.0])
        image = renderer.image(0, t_v, turn.inv().as_quat(), np.random.default_rng(1))
        at = turn.apply(square) + t_v
        corners = FOCAL_PX * at[:, :2] / at[:, 2:] + [319.5, 239.5]
        found = refined(image, corners.round(), 8)
        assert found is not None
        off.append(found - corners)
    assert np.std(off, axis=0).max() < 0.03


def test_single_image_or_no_tag_gives_no_wrong_pose() -> None:
    estimator, rng = make_estimator("apriltag", geometry(), TAGS), np.random.default_rng(1)
    turn, t_v = np.array([0.3, 0.2, -0.4]), np.array([0.1, 0.0, 0.9])
    left, _ = pair(estimator, turn, t_v, rng)
    alone = estimator.solve(left, None, 0.0)
    assert isinstance(alone, PoseEstimate)
    assert alone.status in ("ok", "ambiguous")
    if alone.status == "ok":
        assert np.abs(error(alone, turn, t_v) / np.sqrt(np.diag(alone.covariance))).max() < 4.0
    assert estimator.solve(np.full(SHAPE, 60, np.uint8), None, 0.0).status == "too_few"


def test_images_of_two_moments_are_refused() -> None:
    estimator, rng = make_estimator("apriltag", geometry(), TAGS), np.random.default_rng(1)
    turn = np.array([0.3, 0.2, -0.4])
    left, _ = pair(estimator, turn, np.array([0.1, 0.0, 1.2]), rng)
    _, right = pair(estimator, turn, np.array([0.1, 0.02, 1.2]), rng)
    assert estimator.solve(left, right, 0.0).status.startswith("rejected_")


def test_emulated_cameras_draw_the_target_where_rays_have_it() -> None:
    estimator, rng = make_estimator("apriltag", geometry(), TAGS), np.random.default_rng(1)
    assert isinstance(estimator, BoardEstimator)
    turn, t_v = np.array([0.3, 0.2, -0.4]), np.array([0.1, 0.0, 0.9])
    renderer = BoardRenderer(camera_pair(geometry()), estimator.board, RingAppearance())
    q_vt = Rotation.from_rotvec(turn).inv().as_quat()
    drawn = [corners_in(estimator, renderer.image(c, t_v, q_vt, rng)) for c in range(2)]
    rays = [corners_in(estimator, image) for image in pair(estimator, turn, t_v, rng)]
    for mine, theirs in zip(drawn, rays, strict=True):
        assert sorted(mine) == sorted(theirs) == [0, 1, 2, 3]
        assert np.abs(np.array([np.subtract(mine[k], theirs[k]) for k in mine])).max() < 0.15


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("lidar", {}, 'vmu.estimator: "lidar": unknown estimator, known: led_ring, apriltag, charuco'),
        ("apriltag", {"family": "99h9"}, "vmu.estimator_settings.family: 99h9"),
        ("apriltag", {"corner": 1.0}, "vmu.estimator_settings.corner"),
        ("charuco", {"marker_m": 0.05}, "vmu.estimator_settings.marker_m: 0.05: must be below square_m, 0.04"),
        ("led_ring", {"tags": []}, "vmu.estimator_settings: tags: led_ring has no settings"),
    ],
)
def test_invalid_estimator_is_one_line_with_the_key(name: str, settings: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput) as caught:
        make_estimator(name, geometry(), settings)
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)


def test_led_ring_is_the_vision_unit() -> None:
    assert isinstance(make_estimator("led_ring", geometry(), {}), VisionUnit)


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("t_v", np.array([0.0, np.nan, 1.0]), "t_v"),
        ("q_vt", np.array([0.0, 0.0, 0.0, 2.0]), "unit quaternion"),
        ("covariance", -np.eye(6), "positive definite"),
        ("covariance", np.eye(3), "covariance"),
        ("noise", np.eye(3), "noise"),
    ],
)
def test_estimate_that_is_no_pose_stops_the_unit_with_a_device_error(field: str, value: Array, text: str) -> None:
    parts: dict[str, Any] = {"t_v": np.ones(3), "q_vt": np.array([0.0, 0.0, 0.0, 1.0]), "covariance": np.eye(6)}

    class Wrong:
        def warm_up(self) -> None: ...

        def solve(self, left: Image | None, right: Image | None, t_s: float) -> PoseEstimate:
            return PoseEstimate(t_s, "ok", **(parts | {field: value}))

    with pytest.raises(DeviceError, match=rf"vmu: .*Wrong\.solve raised ValueError: .*{text}"):
        solve_pair(Wrong(), None, None, 0.0)


def test_example_of_80_lines_is_found_by_its_entry_point_and_measures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "tag_estimator-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tag-estimator\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[hil.pose_estimators]\nexample_board = tag_estimator:BoardEstimator\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(EXAMPLE)
    assert 'example_board = "tag_estimator:BoardEstimator"' in (EXAMPLE / "pyproject.toml").read_text()
    assert len((EXAMPLE / "tag_estimator.py").read_text().splitlines()) <= 80
    estimator, rng = make_estimator("example_board", geometry(), {}), np.random.default_rng(2)
    turn, t_v = np.array([0.2, -0.1, 0.3]), np.array([0.1, 0.0, 1.6])
    estimate = estimator.solve(*pair(estimator, turn, t_v, rng), 0.0)
    assert isinstance(estimate, PoseEstimate)
    assert estimate.status == "ok"
    assert np.abs(error(estimate, turn, t_v) / np.sqrt(np.diag(estimate.covariance))).max() < 4.0
