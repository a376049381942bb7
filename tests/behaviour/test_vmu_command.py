"""``hil vmu`` on rendered images: columns, statuses, and messages for invalid input."""

from __future__ import annotations

import csv
import json
import math
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import BAD_INPUT, FAILED, PASSED, execute
from hil.config.vmu_geometry import VmuGeometry
from hil.parts.vision.cli.vmu import COLUMNS
from hil.vmu.geometry import camera_pair, led_positions
from hil.vmu.render import Extras, Reflection, RingAppearance, RingRenderer
from tests.support.vmu_scene import Truth, ring

pytestmark = pytest.mark.xdist_group("vision unit")

FRAMES = 6


def truth(k: int) -> Truth:
    return Truth(np.array([0.1, 0.02, 4.0 - 0.3 * k]), np.array([0.06, -0.03, 0.1 + 0.01 * k]))


@pytest.fixture(scope="module")
def shots() -> list[tuple[np.ndarray, np.ndarray]]:
    rng, geometry = np.random.default_rng(3), ring()
    renderer = RingRenderer(camera_pair(geometry), led_positions(geometry), RingAppearance())
    strays = Extras(reflections=[Reflection(0, 200.0, 300.0), Reflection(1, 700.0, 800.0)])
    return [renderer.pair(truth(k).t, truth(k).q, None, rng, strays) for k in range(FRAMES)]


@pytest.fixture
def folder(tmp_path: Path, shots: list[tuple[np.ndarray, np.ndarray]]) -> Path:
    (tmp_path / "left").mkdir()
    (tmp_path / "right").mkdir()
    for k, pair in enumerate(shots):
        for side, image in zip(("left", "right"), pair, strict=True):
            cv2.imwrite(str(tmp_path / side / f"{k:04d}.png"), image)
    write_geometry(tmp_path, ring())
    return tmp_path


def write_geometry(folder: Path, geometry: VmuGeometry) -> None:
    (folder / "vmu.json").write_text(json.dumps(geometry.model_dump(exclude_none=True)))


def solve(folder: Path, *options: str) -> tuple[int, list[dict[str, str]]]:
    out = folder / "poses.csv"
    code = execute(["vmu", str(folder), "--geometry", str(folder / "vmu.json"), "--out", str(out), *options])
    if not out.exists():
        return code, []
    with out.open() as file:
        rows = list(csv.DictReader(file))
    return code, rows


def check_pose(row: dict[str, str], expected: Truth, sigmas: float = 5.0) -> None:
    values = np.array([float(row[name]) for name in COLUMNS[4:10]])
    spread = np.array([float(row[name]) for name in COLUMNS[10:16]])
    assert (np.abs(values[:3] - expected.t) < sigmas * spread[:3]).all()
    assert (np.abs(values[3:] - expected.turn) < sigmas * spread[3:] + 1e-3).all()


def test_every_frame_gets_a_row_with_its_pose(folder: Path) -> None:
    summary = folder / "summary.json"
    code, rows = solve(folder, "--overlay", str(folder / "pictures"), "--json", str(summary))
    assert code == PASSED
    assert tuple(rows[0]) == COLUMNS
    assert [row["status"] for row in rows] == ["ok"] * FRAMES
    assert [float(row["t_s"]) for row in rows] == pytest.approx([0.16 * k for k in range(FRAMES)])
    for k, row in enumerate(rows):
        check_pose(row, truth(k))
        assert row["n_leds"] == "6"
        assert 0.0 < float(row["epipolar_px"]) < 0.2
        assert 0.0 < float(row["scale"]) < 3.0
    assert json.loads(summary.read_text())["status"] == {"ok": FRAMES}
    picture = cv2.imread(str(folder / "pictures" / "0003.png"))
    assert picture is not None
    assert picture.shape == (1024, 2048, 3)


def test_rate_and_first_frame_are_options(folder: Path) -> None:
    _, rows = solve(folder, "--rate-hz", "10", "--start-frame", "4")
    assert [(row["frame"], float(row["t_s"])) for row in rows] == [("4", 0.4), ("5", 0.5)]


def test_one_camera_that_is_lost_or_black_still_gives_poses(folder: Path) -> None:
    for k in range(FRAMES):
        path = folder / "right" / f"{k:04d}.png"
        if k % 2:
            path.unlink()
        else:
            cv2.imwrite(str(path), np.zeros((1024, 1024), np.uint8))
    code, rows = solve(folder)
    assert code == PASSED
    for k, row in enumerate(rows):
        assert row["status"] == "ok"
        check_pose(row, truth(k))


def test_repeated_images_are_no_new_measurement(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A repeated pair is refused, a repeated image of one camera is left out; black images are named."""
    for number, sides in ((1, ("left", "right")), (2, ("left", "right")), (4, ("right",))):
        for side in sides:
            shutil.copy(folder / side / f"{number - 1:04d}.png", folder / side / f"{number:04d}.png")
    cv2.imwrite(str(folder / "left" / "0005.png"), np.zeros((1024, 1024), np.uint8))
    _, rows = solve(folder)
    assert [row["status"] for row in rows] == ["ok", "rejected_frozen", "rejected_frozen", "ok", "ok", "ok"]
    assert [row["reason"] for row in rows[1:]] == [
        *["left image equal to the one before, right image equal to the one before"] * 2, "",
        "right image equal to the one before", "left image black",
    ]  # fmt: skip
    for k in (0, 3, 4, 5):
        check_pose(rows[k], truth(k))
    for text in ("left images that are equal to the one before: 2", "right images that are equal to the one before: 3",
                 "left images that are black: 1"):  # fmt: skip
        assert text in caplog.text


def test_frames_without_images_are_predicted_along_a_track(folder: Path) -> None:
    for side in ("left", "right"):
        (folder / side / "0003.png").unlink()
    _, rows = solve(folder)
    assert [row["status"] for row in rows] == ["ok", "ok", "ok", "predicted", "ok", "ok"]
    check_pose(rows[3], truth(3))
    assert (rows[3]["epipolar_px"], rows[3]["scale"]) == ("nan", "nan")


def test_bad_images_never_make_a_pose(folder: Path) -> None:
    for side in ("left", "right"):
        whole = (folder / side / "0001.png").read_bytes()
        (folder / side / "0001.png").write_bytes(whole[: len(whole) // 2])
        cv2.imwrite(str(folder / side / "0002.png"), np.zeros((1024, 1024), np.uint8))
        (folder / side / "0003.png").write_bytes(b"")
    cv2.imwrite(str(folder / "right" / "0004.png"), np.zeros((512, 640), np.uint8))
    _, rows = solve(folder)
    said = [row["status"] for row in rows]
    assert said == ["ok", "rejected_image", "rejected_dark", "rejected_image", "rejected_size", "ok"]
    for row in rows[1:5]:
        assert all(math.isnan(float(row[name])) for name in COLUMNS[4:-2])
    assert rows[4]["reason"] == "right image is 512 x 640 uint8, expected 1024 x 1024 uint8 (rows, columns)"


def test_a_folder_without_a_single_pose_has_the_verdict_fail(folder: Path) -> None:
    for k in range(FRAMES):
        for side in ("left", "right"):
            cv2.imwrite(str(folder / side / f"{k:04d}.png"), np.full((1024, 1024), 7, np.uint8))
    code, rows = solve(folder)
    assert code == FAILED
    assert {row["status"] for row in rows} == {"rejected_dark"}


def test_a_flat_ring_needs_a_start(folder: Path) -> None:
    write_geometry(folder, ring(raised_m=0.0))
    code, rows = solve(folder)
    assert code == FAILED
    assert all(row["status"] != "ok" for row in rows)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: (f / "vmu.json").write_text("{}"), "leds_m: is missing"),
        (lambda f: (f / "vmu.json").unlink(), "cannot be read"),
        (lambda f: [p.unlink() for p in f.glob("*/*.png")], "contains no images"),
        (lambda f: [cv2.imwrite(str(p), np.zeros((9, 99), np.uint8)) for p in f.glob("*/*.png")], "frame 0 is 99 x 9"),
        (lambda f: [p.write_bytes(b"no image") for p in f.glob("*/*.png")], "no image can be read in the folder"),
        (lambda f: (f / "left" / "00000.png").write_bytes(b"x"), "keep one"),
    ],
)
def test_bad_input_is_reported_in_one_line(
    folder: Path, capsys: pytest.CaptureFixture[str], change: object, said: str
) -> None:
    assert callable(change)
    change(folder)
    code, rows = solve(folder)
    assert code == BAD_INPUT
    assert not rows
    error = capsys.readouterr().err
    assert said in error


def test_a_folder_that_is_not_there_and_wrong_options_are_bad_input(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    geometry, out = str(folder / "vmu.json"), str(folder / "o.csv")
    assert execute(["vmu", str(folder / "none"), "--geometry", geometry, "--out", out]) == BAD_INPUT
    assert "no such folder" in capsys.readouterr().err
    assert solve(folder, "--rate-hz", "0")[0] == BAD_INPUT
    assert "--rate-hz" in capsys.readouterr().err
    assert solve(folder, "--start-frame", "99")[0] == BAD_INPUT
    assert "the last frame" in capsys.readouterr().err
