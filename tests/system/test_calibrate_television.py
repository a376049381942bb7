"""``hil calibrate --scene``: the docking monitor's camera from images of a chessboard."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.cli.main import BAD_INPUT, execute
from hil.config.load import load_scene
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.single_camera import fit_camera
from tests.support.calibration_images import board_image

BOARD = Board(7, 5, 0.05)
SIZE = (768, 576)
TRUE = np.array([1104.0, 1101.0, 380.0, 291.0, -0.05, 0.02, 0.0, 0.0, 0.0])  # fx fy cx cy k1 k2 p1 p2 k3
OPTIONS = ("--scene", "atv", "--board", "7x5", "--square-mm", "50")


def places(count: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return rotations and positions, m, of a board in the camera's axes."""
    rng, found = np.random.default_rng(seed), []
    for _ in range(count):
        turn = Rotation.from_rotvec(np.append(rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.2, 0.2))).as_matrix()
        z = rng.uniform(0.7, 1.1)
        found.append((turn, np.array([rng.uniform(-0.12, 0.12) * z, rng.uniform(-0.08, 0.08) * z, z])))
    return found


def test_camera_is_found_within_its_sigmas() -> None:
    rng, corners = np.random.default_rng(1), {}
    matrix = np.array([[TRUE[0], 0.0, TRUE[2]], [0.0, TRUE[1], TRUE[3]], [0.0, 0.0, 1.0]])
    for k, (turn, place) in enumerate(places(20, 2)):
        pixels, _ = cv2.projectPoints(BOARD.points(), cv2.Rodrigues(turn)[0], place, matrix, TRUE[4:])
        corners[f"{k}"] = pixels[:, 0] + 0.05 * rng.standard_normal(pixels[:, 0].shape)
    corners["3"][::2] += 2.0  # not the board's
    fit = fit_camera(corners, SIZE, BOARD)
    assert set(fit.left_out) == {"3"}
    assert fit.rms_px == pytest.approx(0.05 * np.sqrt(2.0), rel=0.1)
    errors = np.concatenate([fit.focal_px, fit.centre_px]) - TRUE[:4]
    assert np.abs(errors / fit.sigma_px).max() < 4.0
    assert fit.sigma_px.max() < 1.0


@pytest.mark.slow
def test_scene_file_has_the_camera_and_what_a_pinhole_does_not_have_as_tolerances(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rng, folder, out = np.random.default_rng(3), tmp_path / "board", tmp_path / "mine.toml"
    folder.mkdir()
    for k, (turn, place) in enumerate(places(12, 4)):
        image = board_image(TRUE, np.array(SIZE), turn, place, BOARD)
        image = cv2.GaussianBlur(image, (0, 0), 0.7) + rng.standard_normal(image.shape)
        assert cv2.imwrite(str(folder / f"{k}.png"), np.clip(np.rint(image), 0, 255).astype(np.uint8))
    files = ("--scene-out", str(out), "--json", str(tmp_path / "found.json"))
    assert execute(["calibrate", str(folder), *OPTIONS, *files]) == 0
    camera, found = load_scene(str(out)).value.camera, json.loads((tmp_path / "found.json").read_text())
    assert camera.f == pytest.approx(np.sqrt(TRUE[0] * TRUE[1]), rel=2e-3)
    assert (camera.cx, camera.cy) == pytest.approx(TRUE[2:4], abs=2.0)
    assert (camera.width, camera.height) == SIZE
    assert camera.tolerances.distortion_px == pytest.approx(found["distortion_corner_px"])
    assert camera.tolerances.aspect_fraction >= abs(found["aspect"] - 1.0)
    capsys.readouterr()
    small = cv2.imread(str(folder / "0.png"), cv2.IMREAD_GRAYSCALE)
    assert small is not None
    cv2.imwrite(str(folder / "0.png"), small[:100, :200])
    assert execute(["calibrate", str(folder), *OPTIONS]) == BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("0.png: is 200 x 100 px, the camera of the scene is 768 x 576 px")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--scene", "atv"), "--scene: needs --board and --square-mm"),
        ((*OPTIONS, "--out", "vmu.toml"), "--scene: goes without --out"),
        (("--scene-out", "mine.toml"), "--scene-out: goes with --scene only"),
        (OPTIONS, "0 of 0 images show a board of 7x5 inner corners, 8 are needed"),
    ],
)
def test_bad_input_is_one_line(
    words: tuple[str, ...], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["calibrate", str(tmp_path), *words]) == BAD_INPUT
    (found,) = capsys.readouterr().err.splitlines()
    assert found.endswith(line)
