"""``hil calibrate`` as it is called: rendered views in, geometry file, report and exit code out."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_geometry, load_rig
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.model import Setup, TurntableModel
from hil.vmu.geometry import geometry_of_rig
from hil.vmu.render import NO_EXTRAS
from tests.support.calibration_images import board_pair, led_pair, led_renderer, write_views
from tests.support.calibration_views import plan, shifted
from tests.support.emulated_cameras import require_libaravis
from tests.support.run_settings import UNHURRIED, typed

pytestmark = pytest.mark.xdist_group("vision unit")

BOARD = Board(7, 5, 0.05)
SMALL = (
    "rig.vmu.camera.focal_px=500.0",
    "rig.vmu.camera.width_px=400",
    "rig.vmu.camera.height_px=400",
)
SET = typed(*SMALL)
AXIS_SIGMA = np.array([5e-5] * 3 + [np.radians(0.005)] * 3)
LOOSE = ["--max-error-mm", "300", "--max-mounting-mm", "5", "--max-mounting-deg", "0.3", "--max-spot-px", "3"]


def truth_of(leds: bool) -> tuple[Setup, TurntableModel]:
    rig = load_rig("mock", SMALL).value
    paper = Setup.of(geometry_of_rig(rig), rig.bench, None if leds else BOARD.points())
    made = shifted(
        paper, LEFT=[4.0, -3.0, 5.0, -4.0, -0.06], RIGHT=[-4.0, 3.0, -5.0, 2.0, -0.05], BASELINE=[1e-3, 0, 0]
    )
    return shifted(made, CAMERA_ROTATION=[0.006, -0.008, 0.01], TARGET_POSITION=[0.0, 4e-3, -3e-3]), TurntableModel.of(
        rig.bench
    )


def made_views(folder: Path, truth: Setup, turntable: TurntableModel, leds: bool, views: int, seed: int) -> Path:
    rng = np.random.default_rng(seed)
    axes = plan(truth, turntable, views, (0.6, 2.0) if leds else (0.9, 1.3), 20.0, rng, 0.22 if leds else 0.06)
    renderer = led_renderer(truth) if leds else None
    pairs = [
        led_pair(renderer, truth, turntable, row, NO_EXTRAS, rng)
        if renderer
        else board_pair(truth, turntable, row, BOARD, 1.5, rng)
        for row in axes
    ]
    write_views(folder, axes + rng.standard_normal(axes.shape) * AXIS_SIGMA, pairs)
    return folder


@pytest.fixture(scope="module")
def led_views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of rendered LED views."""
    return made_views(tmp_path_factory.mktemp("leds"), *truth_of(True), True, 20, 1)


@pytest.fixture(scope="module")
def board_views(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of rendered views of a chessboard."""
    return made_views(tmp_path_factory.mktemp("board"), *truth_of(False), False, 12, 2)


def board_options(square_mm: str = "50") -> list[str]:
    return ["--board", "7x5", "--square-mm", square_mm, *SET, *LOOSE]


def test_led_views_give_a_geometry_file_that_a_later_check_agrees_with(led_views: Path, tmp_path: Path) -> None:
    out, rig_out, report = tmp_path / "geometry.toml", tmp_path / "rig.toml", tmp_path / "report.json"
    files = ["--out", str(out), "--rig-out", str(rig_out), "--json", str(report), "--figure", str(tmp_path / "f.png")]
    assert execute(["calibrate", str(led_views), *SET, *LOOSE, "--date", "2026-03-01", "--id", "first", *files]) == 0
    truth, turntable = truth_of(True)
    found = load_geometry(str(out)).value
    assert found.calibration is not None
    assert (found.calibration.id, found.calibration.date) == ("first", "2026-03-01")
    for name, value in (("fx", found.left.fx), ("fy", found.left.fy), ("cx", found.left.cx), ("cy", found.left.cy)):
        sigma = found.calibration.sigma[f"left.{name}_px"]
        assert abs(value - truth.theta[("fx", "fy", "cx", "cy").index(name)]) < 4.0 * sigma
    rig = load_rig(str(rig_out)).value
    assert np.degrees(np.arccos((np.trace(np.array(rig.bench.camera_axes) @ truth.camera_axes.T) - 1) / 2)) < 0.1
    assert json.loads(report.read_text())["passed"] is True
    assert (tmp_path / "f.png").stat().st_size > 10_000

    same = made_views(tmp_path / "same", truth, turntable, True, 6, 3)
    assert execute(["calibrate", str(same), "--check", str(out)]) == 0
    moved = shifted(truth, CAMERA_ROTATION=[0.0, np.radians(0.1), 0.0])
    drifted = made_views(tmp_path / "drifted", moved, turntable, True, 6, 4)
    assert execute(["calibrate", str(drifted), "--check", str(out), "--json", str(report)]) == 1
    assert "mounting" in json.loads(report.read_text())["moved"]


def test_chessboard_views_are_calibrated_and_one_with_wrong_axes_is_named(
    board_views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "views"
    shutil.copytree(board_views, folder)
    rows = list(csv.reader((folder / "views.csv").read_text().splitlines()))
    rows[5][2] = f"{float(rows[5][2]) + 0.02:.7f}"
    with (folder / "views.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    report = tmp_path / "report.json"
    assert execute(["calibrate", str(folder), *board_options(), "--json", str(report)]) == 0
    found = json.loads(report.read_text())
    assert found["left_out"].pop("0004") == "its pose is inconsistent with the other views"
    # a view in which the board is blurred or far to the side may go too, but for its residuals
    assert sum("completely" not in why for why in found["left_out"].values()) <= 1
    assert "rejected  0004" in capsys.readouterr().out
    truth, _ = truth_of(False)
    for k, name in enumerate(("fx", "fy", "cx", "cy")):
        number = found["parameters"][f"left.{name}"]
        assert abs(number["value"] - truth.theta[k]) < 4.0 * number["sigma"]


def test_squares_of_another_size_fail(board_views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["calibrate", str(board_views), *board_options("48")]) == 1
    assert "FAIL      board's size against the rails" in capsys.readouterr().out


def test_a_calibration_that_the_unit_cannot_use_is_refused_in_one_line(
    led_views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, report = tmp_path / "geometry.toml", tmp_path / "report.json"
    files = ["--out", str(out), "--json", str(report)]
    assert execute(["calibrate", str(led_views), *SET, *LOOSE, "--max-rms-px", "0.001", *files]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "reprojection, RMS" in line
    assert "allowed 0.001 px: the vision unit cannot use this calibration" in line
    assert not out.exists()
    assert json.loads(report.read_text())["passed"] is False


@pytest.mark.wires
@pytest.mark.slow
def test_bench_takes_the_views_of_its_own_calibration(tmp_path: Path) -> None:
    """Errors over sigmas of ``hil calibrate VIEWS --drive --count 12 --rig emulated --json -``."""
    require_libaravis()
    views, report = tmp_path / "views", tmp_path / "report.json"
    options = ("--drive", "--count", "12", "--rig", "emulated", "--json", str(report), *typed(*UNHURRIED))
    assert execute(["calibrate", str(views), *options]) == 0
    found = json.loads(report.read_text())["parameters"].values()  # of cameras that are as the rig file has them
    ratios = np.array([(number["value"] - number["on_paper"]) / number["sigma"] for number in found])
    assert np.abs(ratios).max() < 4.5
    assert np.mean(np.abs(ratios) < 2.0) > 0.8
    assert execute(["calibrate", str(views), "--drive", "--rig", "emulated"]) == 2


def test_a_board_with_a_wrong_square_size_is_rejected(board_views: Path, capsys: pytest.CaptureFixture[str]) -> None:
    few = board_views / "few.csv"
    few.write_text("\n".join((board_views / "views.csv").read_text().splitlines()[:3]))
    assert execute(["calibrate", str(few), "--board", "9x6", "--square-mm", "50", *SET]) == 2
    assert "0 of 2 views show a board of 9x6 inner corners" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (["--board", "7by5", "--square-mm", "50"], "--board: 7by5: must be COLUMNSxROWS of inner corners, as 11x8"),
        (["--board", "6x6", "--square-mm", "50"], "--board: 6x6: columns and rows must be at least 3 and differ"),
        (["--board", "7x5"], "--square-mm: is missing"),
        (["--keep", "lens"], "--keep: lens: unknown, give left, right, stereo, mounting, leds"),
        (["--rail-sigma-mm", "0"], "--rail-sigma-mm: 0: must be above 0"),
        (["--date", "1.3.2026"], "--date: 1.3.2026: must be a date like 2026-03-01"),
        (["--moved"], "--moved: goes with --check only"),
    ],
)
def test_invalid_options_are_reported_in_one_line(
    led_views: Path, words: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["calibrate", str(led_views), *SET, *words]) == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1


def test_unreadable_views_are_reported_in_one_line(
    led_views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def said(folder: Path) -> str:
        assert execute(["calibrate", str(folder), *SET]) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        return error

    assert "cannot be read" in said(tmp_path / "none")
    folder = tmp_path / "views"
    shutil.copytree(led_views, folder)
    (folder / "left" / "0003.png").write_bytes(b"not an image")
    assert "0003.png: not a readable image" in said(folder)
    cv2.imwrite(str(folder / "left" / "0003.png"), np.zeros((300, 400), np.uint8))
    assert "is 400 x 300 px, the others are 400 x 400 px" in said(folder)
    (folder / "left" / "0003.png").unlink()
    assert "0003.png: no such image" in said(folder)
    shutil.copy(led_views / "left" / "0003.png", folder / "left" / "0003.png")
    text = (led_views / "views.csv").read_text()
    (folder / "views.csv").write_text(text.replace("pitch_deg", "pitch_rad"))
    assert "column pitch_deg is missing" in said(folder)
    (folder / "views.csv").write_text(text.replace("0001,", "0000,"))
    assert "line 3: view '0000': must be given, and unique" in said(folder)


def test_a_check_against_a_file_without_calibration_is_rejected(
    led_views: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = tmp_path / "plain.json"
    rig = load_rig("mock", SMALL).value
    plain.write_text(geometry_of_rig(rig).model_dump_json(exclude_none=True))
    assert execute(["calibrate", str(led_views), "--check", str(plain)]) == 2
    assert "calibration: is missing: a file written by hil calibrate is required" in capsys.readouterr().err
