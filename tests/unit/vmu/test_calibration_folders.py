"""Folders of views as laboratories have them: names, formats, ChArUco boards, parts of boards, one camera, signs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_geometry
from hil.config.rig import Rig
from hil.errors import BadInput
from hil.vmu.calibration import hand_held, quality
from hil.vmu.calibration.board import Board, find_corners, one_sided
from hil.vmu.calibration.job import CalibrationLimits
from hil.vmu.calibration.model import PARTS, Observations, Setup
from hil.vmu.calibration.views import read_pairs, read_views, what_was_read
from hil.vmu.kernels.chain import BASELINE, CAMERA_ROTATION, SCALE
from hil.vmu.prints import CharucoSettings
from tests.support import hand_held_views
from tests.support.board_pixels import board_image
from tests.support.calibration_sets import BOARD, as_made, on_paper

CODED = replace(BOARD, marker_m=0.03, dictionary="5X5_100")
HEAD = "view,rail_x_m,rail_y_m,rail_z_m,roll_deg,pitch_deg,yaw_deg\n"


def image_at(path: Path, levels: int = 1, depth: type = np.uint8) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.full((8, 12), levels, depth))


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("left/0001.png", "right/0001.png", "left/0002.png", "right/0002.png"), 2),
        (("left01.jpg", "right01.jpg", "left02.jpg", "right02.jpg"), 2),
        (("img_0001_L.JPG", "img_0001_R.JPG"), 1),
        (("cam0/img_0001.png", "cam1/frame_0001.png", "cam0/img_0002.png", "cam1/frame_0002.png"), 2),
        (("Left/a.tif", "Right/a.bmp"), 1),
    ],
)
def test_pairs_are_those_of_name_or_number(tmp_path: Path, names: tuple[str, ...], pairs: int) -> None:
    for name in names:
        image_at(tmp_path / name)
    views = read_pairs(tmp_path)
    assert len(views.names) == pairs
    assert not views.unused
    for left, right in views.images:
        assert "l" in str(left.relative_to(tmp_path)).lower() or "cam0" in str(left)
        assert left != right


def test_images_without_a_partner_are_named(tmp_path: Path) -> None:
    for name in ("left/a.png", "right/a.png", "left/b.png"):
        image_at(tmp_path / name)
    assert read_pairs(tmp_path).unused == {"left/b.png": "has no image of the other camera"}
    (tmp_path / "plain").mkdir()
    image_at(tmp_path / "plain" / "x.png")
    with pytest.raises(BadInput, match=r"0 pairs .*8 are needed \(x\.png neither left nor right"):
        hand_held.read_pairs(tmp_path / "plain")


def test_table_of_views_takes_any_format_and_no_millimetres(tmp_path: Path) -> None:
    for name in ("left/1.jpg", "right/1.png", "left/2.png"):
        image_at(tmp_path / name)
    (tmp_path / "views.csv").write_text(HEAD + "1,2,0,0,0,0,0\n")
    views = read_views(tmp_path)
    assert [path.name for path in views.images[0]] == ["1.jpg", "1.png"]
    assert views.unused == {"left/2": "no view of views.csv"}
    (tmp_path / "views.csv").write_text(HEAD + "1,2318.4,0,0,0,0,0\n")
    with pytest.raises(BadInput, match=r"line 2: rail_x_m 2318\.4: allowed 100 m: millimetres\?"):
        read_views(tmp_path)


def test_what_was_read_has_number_size_and_depth(tmp_path: Path) -> None:
    image_at(tmp_path / "a.png", 3000, np.uint16)
    assert what_was_read([tmp_path / "a.png"] * 3) == (
        "3 images of 12 x 8 px, images of 12 bits in 16, brightest 3000: read by the upper 8 of the 12"
    )


@pytest.mark.parametrize("way", ["opencv", "legacy"])
def test_part_of_a_charuco_board_is_measured_whichever_way_it_is_printed(way: str) -> None:
    settings = CharucoSettings(dictionary="5X5_100", columns=9, rows=6, square_m=0.04, marker_m=0.03)
    sheet = settings.board(way)
    board, rng = Board(8, 5, 0.04, 0.03, "5X5_100"), np.random.default_rng(1)
    turn, place, focal = np.array([0.2, -0.3, 0.1]), np.array([-0.09, 0.02, 0.55]), 700.0
    picture = board_image(sheet.image, (sheet.width_m, sheet.height_m), focal, (480, 640), turn, place, rng)
    corners = find_corners(picture, board)
    assert corners is not None
    at = cv2.Rodrigues(turn)[0] @ board.points().T + place[:, None]
    true = focal * at[:2].T / at[2:].T + [319.5, 239.5]
    seen = np.isfinite(corners[:, 0])
    inside = ((true > 25.0) & (true < [614.0, 454.0])).all(axis=1)
    assert 12 <= seen.sum() < len(seen)
    assert inside[seen].mean() > 0.9
    assert np.sqrt(np.mean((corners - true)[seen] ** 2)) < 0.15
    assert find_corners(np.full((480, 640), 90, np.uint8), board) is None


def made(rig: Rig, rng: np.random.Generator) -> tuple[Setup, Setup]:
    """Return nominal and true cameras without a bench."""
    nominal = on_paper(rig, False)
    truth = as_made(nominal, rng, False)
    theta = truth.theta.copy()
    theta[CAMERA_ROTATION:SCALE], theta[SCALE] = 0.0, 1.0
    return nominal, replace(truth, theta=theta, camera_axes=np.eye(3), target_axes=np.eye(3))


def seen_in_part(truth: Setup, rng: np.random.Generator) -> Observations:
    """Return views of a coded board of which three are cut in an image and two are of one camera alone."""
    pixels = np.array([view for _, _, view in hand_held_views.poses(truth, BOARD, 16, rng)])
    pixels[1, 0, ::3] = pixels[2, 1, :30] = pixels[4, :, 20:] = np.nan
    pixels[6, 0] = pixels[9, 1] = np.nan
    return hand_held_views.observed(pixels, 0.1, rng)


def test_views_that_one_camera_shows_and_parts_of_the_board_count(mock_rig: Rig) -> None:
    rng = np.random.default_rng(11)
    nominal, truth = made(mock_rig, rng)
    seen = seen_in_part(truth, rng)
    solution, held = hand_held.solve(seen, CODED, nominal, (), 1e-3, False)
    assert solution.left_out == {}
    assert one_sided(solution.observations) == {"0006.png": "right", "0009.png": "left"}
    free = held.free & (np.arange(len(held.free)) < CAMERA_ROTATION)
    off = (solution.fit.setup.theta - truth.theta)[free] / solution.fit.sigma[free]
    assert np.abs(off).max() < 4.5
    assert np.sqrt(np.mean(off**2)) < 1.6


def test_exchanged_images_are_a_warning_with_the_baseline(mock_rig: Rig) -> None:
    rng = np.random.default_rng(12)
    nominal, truth = made(mock_rig, rng)
    pixels = np.array([view for _, _, view in hand_held_views.poses(truth, BOARD, 12, rng)])
    for exchanged, warnings in ((pixels, 0), (pixels[:, ::-1], 1)):
        solution, held = hand_held.solve(hand_held_views.observed(exchanged, 0.1, rng), BOARD, nominal, (), 1e-3, False)
        texts = quality.exchange_warnings(solution.fit.setup, held)
        assert len(texts) == warnings
        assert all("images exchanged?" in text for text in texts)


def test_axes_that_the_calibration_defines_are_no_error_of_it(mock_rig: Rig) -> None:
    rng = np.random.default_rng(13)
    nominal, truth = made(mock_rig, rng)
    pixels = np.array([view for _, _, view in hand_held_views.poses(truth, BOARD, 16, rng)])
    solution, _ = hand_held.solve(hand_held_views.observed(pixels, 0.1, rng), BOARD, nominal, (), 1e-9, False)
    setup, covariance = solution.fit.setup, solution.fit.covariance
    free, own = (quality.spot_error_px(setup, covariance, 2.0, by_hand) for by_hand in (False, True))
    assert own < 0.6 * free
    turned = np.zeros(len(setup.theta))
    turned[[PARTS["left"].start + 2, PARTS["right"].start + 2]] = 5.0  # both principal points
    moves = [quality.displacement(setup, turned, 2.0, by_hand)[0] for by_hand in (False, True)]
    assert moves[1] < 0.1 * moves[0]
    assert quality.dominant(setup, covariance, 2.0, True).split(".")[0] in ("left", "right", "stereo")


def test_default_limit_is_what_the_pixels_of_the_cameras_allow(mock_rig: Rig) -> None:
    setup = on_paper(mock_rig, False)
    coarse, fine = setup.theta.copy(), setup.theta.copy()
    coarse[0] *= 0.1
    fine[0] *= 10.0
    limits = CalibrationLimits(0.15, None, 2.0, 1.0, 0.05, 0.3)
    assert limits.position_mm(replace(setup, theta=fine)) == 2.0
    assert limits.position_mm(replace(setup, theta=coarse)) == pytest.approx(
        1e3 * 0.15 * 4.0 / (coarse[0] * np.linalg.norm(coarse[BASELINE:CAMERA_ROTATION]))
    )
    assert replace(limits, error_mm=1.5).position_mm(setup) == 1.5


def test_one_camera_alone_is_written_into_the_geometry_of_the_others(tmp_path: Path) -> None:
    rng, out, focal = np.random.default_rng(14), tmp_path / "vmu.toml", 420.0
    sheet = CharucoSettings(dictionary="5X5_100", columns=7, rows=5, square_m=0.04, marker_m=0.03).board("opencv")
    for k in range(10):
        turn = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.2, 0.2)])
        z = rng.uniform(0.35, 0.6)
        place = np.array([*rng.uniform(-0.15, 0.15, 2) * z, z])
        picture = board_image(sheet.image, (sheet.width_m, sheet.height_m), focal, (320, 400), turn, place, rng)
        assert cv2.imwrite(str(tmp_path / f"img_{k:04d}.jpg"), picture)
    words = ["--board", "7x5", "--square-mm", "40", "--marker-mm", "30", "--dictionary", "5X5_100"]
    assert execute(["calibrate", str(tmp_path), *words, "--camera", "right", "--out", str(out)]) == 0
    geometry, head = load_geometry(str(out)).value, out.read_text().splitlines()[0]
    assert head == "# Vision unit: right camera as measured by hil calibrate; the rest is that given to it."
    assert (geometry.right.width, geometry.right.height) == (400, 320)
    assert geometry.right.fx == pytest.approx(focal, rel=0.02)
    assert geometry.left.fx != geometry.right.fx
    assert geometry.tolerances.focal_fraction >= 1e-3


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--board", "9x6", "--square-mm", "0.04"), "is this in metres?"),
        (("--board", "9x6", "--square-mm", "40000"), "at most 1000 mm"),
        (("--board", "9x6", "--square-mm", "40", "--marker-mm", "41"), "--board: marker_m: 0.041: must be below"),
        (("--marker-mm", "30"), "--marker-mm: goes with --board only"),
        (("--camera", "left"), "--camera: needs --board and --square-mm"),
        (
            ("--camera", "left", "--board", "9x6", "--square-mm", "40", "--keep", "right"),
            "--camera: goes without --keep",
        ),
    ],
)
def test_options_that_do_not_go_together_are_named(
    words: tuple[str, ...], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["calibrate", str(tmp_path), *words]) == 2
    assert text in capsys.readouterr().err
