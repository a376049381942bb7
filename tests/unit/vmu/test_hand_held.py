"""Calibration by a board that is held by hand: as good as OpenCV's joint one, with sigmas that cover."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.cli.main import execute
from hil.config.load import load_geometry
from hil.config.rig import Rig
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration import hand_held, quality
from hil.vmu.calibration.files import read_back
from hil.vmu.calibration.model import Setup
from hil.vmu.kernels.chain import BASELINE, CAMERA_ROTATION, ROTATION, SCALE
from tests.support import hand_held_views
from tests.support.calibration_sets import BOARD, as_made, on_paper

SIGMA_PX = 0.1
RANGE_M = 2.0


def made(rig: Rig, rng: np.random.Generator) -> tuple[Setup, Setup]:
    """Return nominal and true cameras."""
    nominal = on_paper(rig, False)
    truth = as_made(nominal, rng, False)
    theta = truth.theta.copy()
    theta[CAMERA_ROTATION:SCALE], theta[SCALE] = 0.0, 1.0
    return nominal, replace(truth, theta=theta, camera_axes=np.eye(3), target_axes=np.eye(3))


def smaller(setup: Setup, factor: float) -> Setup:
    """Return cameras with the same field of view and ``factor`` times the pixels along each side."""
    theta, sizes = setup.theta.copy(), np.rint(factor * setup.sizes)
    for side in range(2):
        theta[9 * side : 9 * side + 4] *= factor
    return replace(setup, theta=theta, sizes=sizes)


def corners(truth: Setup, count: int, rng: np.random.Generator) -> Array:
    return np.array([pixels for _, _, pixels in hand_held_views.poses(truth, BOARD, count, rng)])


def joint_by_opencv(pixels: Array, truth: Setup) -> Array:
    """Return the numbers of both cameras by ``cv2.stereoCalibrate`` with all of them free."""
    objects = [BOARD.points().astype(np.float32)] * len(pixels)
    sides = [[view[side].astype(np.float32) for view in pixels] for side in range(2)]
    size = (int(truth.sizes[0, 0]), int(truth.sizes[0, 1]))
    start = [x for seen in sides for x in cv2.calibrateCamera(objects, seen, size, np.eye(3), np.zeros(5))[1:3]]
    until, flags = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9), cv2.CALIB_USE_INTRINSIC_GUESS
    found = cv2.stereoCalibrate(objects, *sides, *start, size, np.eye(3), np.zeros(3), flags=flags, criteria=until)
    theta = truth.theta.copy()
    for side in range(2):
        matrix, lens = found[1 + 2 * side], np.ravel(found[2 + 2 * side])
        theta[9 * side : 9 * side + 9] = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens[:5]]
    theta[ROTATION:BASELINE] = Rotation.from_matrix(found[5].T).as_rotvec()
    theta[BASELINE:CAMERA_ROTATION] = (-found[5].T @ found[6]).ravel()
    return theta


def test_cameras_are_as_good_as_by_opencv_and_their_sigmas_cover(mock_rig: Rig) -> None:
    depth_mm: dict[str, list[float]] = {"ours": [], "joint": [], "sigma": []}
    for seed in range(4):
        rng = np.random.default_rng([seed, 77])
        nominal, truth = made(mock_rig, rng)
        seen = hand_held_views.observed(corners(truth, 16, rng), SIGMA_PX, rng)
        solution, held = hand_held.solve(seen, BOARD, nominal, (), 1e-9, False)
        fit = solution.fit
        assert fit.noise * 0.1 == pytest.approx(SIGMA_PX, rel=0.1)
        change = fit.setup.theta - truth.theta
        change[SCALE] = 0.0
        depth_mm["ours"].append(quality.displacement(truth, change, RANGE_M)[1])
        change[:CAMERA_ROTATION] = (joint_by_opencv(seen.pixels, truth) - truth.theta)[:CAMERA_ROTATION]
        depth_mm["joint"].append(quality.displacement(truth, change, RANGE_M)[1])
        stated = quality.at_range(truth, fit.covariance, 0.0, RANGE_M)
        assert stated is not None
        depth_mm["sigma"].append(stated.calibration_depth_mm)
        parts = hand_held.halves(solution, held, RANGE_M)
        assert parts is not None
        assert parts.in_sigmas < 3.0
    rms = {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in depth_mm.items()}
    assert rms["ours"] <= 1.02 * rms["joint"]
    assert 0.5 < rms["ours"] / rms["sigma"] < 1.7


def test_view_whose_images_are_of_two_moments_is_left_out_by_name(mock_rig: Rig) -> None:
    rng = np.random.default_rng(3)
    nominal, truth = made(mock_rig, rng)
    pixels = corners(truth, 14, rng)
    pixels[5, 1] = corners(truth, 1, rng)[0, 1]
    pixels[9, 1] += 2.0  # the board was moving
    seen = hand_held_views.observed(pixels, SIGMA_PX, rng)
    solution, _ = hand_held.solve(seen, BOARD, nominal, (), 1e-3, False)
    assert set(solution.left_out) == {"0005.png", "0009.png"}


def test_size_of_the_board_is_an_error_of_the_baseline(mock_rig: Rig) -> None:
    rng = np.random.default_rng(4)
    nominal, truth = made(mock_rig, rng)
    seen = hand_held_views.observed(corners(truth, 12, rng), SIGMA_PX, rng)
    sigmas = [
        hand_held.solve(seen, BOARD, nominal, (), of_size, False)[0].fit.sigma[BASELINE] for of_size in (1e-9, 0.01)
    ]
    baseline_m = abs(truth.theta[BASELINE])
    assert sigmas[1] ** 2 - sigmas[0] ** 2 == pytest.approx((0.01 * baseline_m) ** 2, rel=0.05)


def test_views_that_determine_little_are_reported(mock_rig: Rig) -> None:
    rng = np.random.default_rng(5)
    nominal, truth = made(mock_rig, rng)
    pixels = corners(truth, 12, rng)
    solution, _ = hand_held.solve(hand_held_views.observed(pixels, SIGMA_PX, rng), BOARD, nominal, (), 1e-3, False)
    near = replace(solution, observations=replace(solution.observations, axes=np.tile([0.0, 0, -1, 0, 0, 0], (12, 1))))
    texts = hand_held.warnings_of(near, [0.3, 0.9])
    assert [text.split()[0:2] for text in texts] == [
        ["the", "left"],
        ["few", "views:"],
        ["little", "tilt:"],
        ["little", "change"],
    ]


def test_command_writes_a_geometry_file_from_pairs_of_images(mock_rig: Rig, tmp_path: Path) -> None:
    rng = np.random.default_rng(6)
    truth = smaller(made(mock_rig, rng)[1], 0.4)
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
    for k, (turn, place, _) in enumerate(hand_held_views.poses(truth, BOARD, 9, rng)):
        for side, image in zip(("left", "right"), hand_held_views.images(truth, BOARD, turn, place, rng), strict=True):
            cv2.imwrite(str(tmp_path / side / f"{k:04d}.png"), image)
    out, report = tmp_path / "vmu.toml", tmp_path / "found.json"
    words = ["calibrate", str(tmp_path), "--hand-held", "--board", "9x6", "--square-mm", "40"]
    execute([*words, "--out", str(out), "--json", str(report), "--max-error-mm", "50", "--max-spot-px", "3"])
    geometry = load_geometry(str(out)).value
    assert geometry.left.fx == pytest.approx(
        truth.theta[0], abs=6.0 * json.loads(report.read_text())["parameters"]["left.fx"]["sigma"]
    )
    assert geometry.calibration is not None
    assert geometry.calibration.target == "hand-held board 9x6 40 mm"
    with pytest.raises(BadInput, match="no bench positions"):
        read_back(geometry, str(out))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ((), "--hand-held: needs --board"),
        (("--board", "9x6", "--square-mm", "40", "--rig-out", "rig.toml"), "--hand-held: goes without --rig-out"),
        (("--board", "9x6", "--square-mm", "40"), "0 pairs left/NAME.png, right/NAME.png, 8 are needed"),
    ],
)
def test_what_a_hand_held_board_cannot_have_is_refused(
    words: tuple[str, ...], text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["calibrate", str(tmp_path), "--hand-held", *words]) == 2
    assert text in capsys.readouterr().err
