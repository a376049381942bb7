"""Printed targets of others: official AprilTags, ChArUco boards of earlier OpenCV, and impossible boards."""

from __future__ import annotations

import csv
import json
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hil.cli.main import BAD_INPUT, PASSED, execute
from hil.config.load import load_geometry
from hil.errors import BadInput
from hil.vmu.estimators import FlatTarget, PoseEstimate, make_estimator
from hil.vmu.prints import AprilTagSettings, CharucoSettings
from tests.support.vmu_pixels import Array, Image
from tests.unit.vmu.test_pose_estimators import error, geometry, pair

# cells of tags 0 to 5 of the AprilTag library (tag16h5, tag25h9, tag36h11), row by row, 1 for white
CELLS = {
    "16h5": (4, (0x231B, 0x2EA5, 0x346A, 0x45B9, 0x79A6, 0x7F6B)),
    "25h9": (5, (0x155CBF1, 0x1E4D1B6, 0x17B0B68, 0x1EAC9CD, 0x12E14CE, 0x3548BB)),
    "36h11": (6, (0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC)),
}
TWO = ((0, 0.12, -0.11, 0.0), (2, 0.12, 0.11, 0.02))
TURN, AT = np.array([0.2, -0.25, 0.4]), np.array([0.1, 0.02, 0.9])


def official(family: str, number: int, cell_px: int) -> Image:
    """Return a tag as the AprilTag library prints it, with its black border."""
    n, codes = CELLS[family]
    bits = np.array([int(bit) for bit in f"{codes[number]:0{n * n}b}"], np.uint8).reshape(n, n)
    cells: Image = np.kron(np.pad(255 * bits, 1), np.ones((cell_px, cell_px), np.uint8))
    return cells


@cache
def seen(family: str, tags: tuple[tuple[int, float, float, float], ...], hidden: int | None = None) -> Any:
    """Return both images of a sheet of 0.5 m x 0.5 m with official tags; hidden: the number of one that is covered."""
    picture: Image = np.full((2000, 2000), 255, np.uint8)
    for number, side, x, y in tags:
        if number != hidden:
            tag = official(family, number, round(4000 * side / (CELLS[family][0] + 2)))
            u, v = (1000 + round(4000 * place) - len(tag) // 2 for place in (x, y))
            picture[v : v + len(tag), u : u + len(tag)] = tag
    return images(FlatTarget(picture, 0.5, 0.5))


class Seen:
    """What ``pair`` needs of an estimator: a board."""

    def __init__(self, board: FlatTarget) -> None:
        self.board = board


def images(board: FlatTarget) -> tuple[Image, Image]:
    return pair(Seen(board), TURN, AT, np.random.default_rng(4))


def is_right(estimate: Any) -> bool:
    assert isinstance(estimate, PoseEstimate)
    assert estimate.status == "ok"
    assert estimate.covariance is not None
    return bool(np.abs(error(estimate, TURN, AT) / np.sqrt(np.diag(estimate.covariance))).max() < 5.0)


@pytest.mark.parametrize("family", sorted(CELLS))
def test_official_print_of_a_single_tag_has_its_attitude(family: str) -> None:
    tags = ((1, 0.02 * (CELLS[family][0] + 2), 0.0, 0.0),)
    estimator = make_estimator("apriltag", geometry("official"), {"family": family, "tags": tags})
    assert is_right(estimator.solve(*seen(family, tags), 0.0))


@pytest.mark.parametrize("family", sorted(CELLS))
@pytest.mark.parametrize("number", range(6))
def test_tags_drawn_here_are_the_official_ones(family: str, number: int) -> None:
    cells = CELLS[family][0] + 2
    drawn = AprilTagSettings(family=family).marker(number, "official", cells)
    assert (drawn == official(family, number, 1)).all()
    assert (AprilTagSettings(family=family).marker(number, "opencv", cells) == drawn[::-1, ::-1]).all()


def test_places_of_several_tags_determine_how_they_are_printed() -> None:
    estimator = make_estimator("apriltag", geometry(None), {"tags": TWO})
    assert is_right(estimator.solve(*seen("36h11", TWO), 0.0))
    assert estimator.solve(*seen("36h11", TWO, hidden=2), 0.0).status == "rejected_print"


def test_tags_that_contradict_the_stated_print_give_no_pose() -> None:
    estimator = make_estimator("apriltag", geometry("opencv"), {"tags": TWO})
    left, right = seen("36h11", TWO)
    assert estimator.solve(left, right, 0.0).status == "rejected_print"
    _, half = seen("36h11", TWO, hidden=2)
    assert estimator.solve(left, half, 0.0).status == "rejected_print"


def test_a_tag_in_one_image_alone_is_not_dropped_if_it_contradicts() -> None:
    """The pose of the tag that both images show was ``ok``, 200 mm off."""
    displaced = (TWO[0], (2, 0.12, 0.13, 0.02))
    estimator = make_estimator("apriltag", geometry("official"), {"tags": displaced})
    left, _ = seen("36h11", TWO)
    _, half = seen("36h11", TWO, hidden=2)
    assert estimator.solve(left, half, 0.0).status == "rejected_no_match"


def test_a_single_tag_without_its_print_is_refused_with_the_key() -> None:
    with pytest.raises(BadInput, match=r"^geometry file: print: is missing: .*official.*opencv"):
        make_estimator("apriltag", geometry(None), {})
    with pytest.raises(BadInput, match=r'^geometry file: print: "legacy": allowed for this target: official, opencv'):
        make_estimator("apriltag", geometry("legacy"), {})


def test_charuco_of_before_opencv_4_6_is_measured() -> None:
    """With an even number of rows it had ``too_few`` corners for ever."""
    settings = {"columns": 5, "rows": 4, "square_m": 0.06, "marker_m": 0.045}
    board = CharucoSettings(columns=5, rows=4, square_m=0.06, marker_m=0.045).board("legacy")
    both = images(board)
    for way in (None, "legacy"):
        assert is_right(make_estimator("charuco", geometry(way), settings).solve(*both, 0.0))
    assert make_estimator("charuco", geometry("opencv"), settings).solve(*both, 0.0).status == "rejected_print"


@pytest.mark.parametrize(
    ("name", "settings", "text"),
    [
        ("apriltag", {"tags": [[700, 0.1, 0.0, 0.0]]}, "tags: 700: tags of family 36h11 are 0 to 586"),
        ("apriltag", {"tags": [[1, 0.1, 0.0, 0.0], [1, 0.1, 0.2, 0.0]]}, "tags: 1: is given twice"),
        ("apriltag", {"tags": [[1, 0.1, 0.0, 0.0], [2, 0.1, 0.09, 0.05]]}, "tags: 1 and 2 overlap"),
        ("apriltag", {"tags": [[1, 0.0, 0.0, 0.0]]}, "tags.0.1: 0.0: "),
        ("charuco", {"columns": 2000, "rows": 2000}, "columns: 2000: "),
        ("charuco", {"columns": 30, "rows": 30}, "columns, rows: 30 x 30 squares have 450 markers, 4X4_50 50"),
        ("charuco", {"dictionary": "4X5_50"}, "dictionary: 4X5_50: "),
        ("charuco", {"marker_m": 1e-6}, "marker_m: 1e-06: must be below square_m, 0.04, and at least 0.3 of it"),
    ],
)
def test_board_that_cannot_be_printed_is_one_line(name: str, settings: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput) as caught:
        make_estimator(name, geometry(), settings)
    assert f"rig: vmu.estimator_settings.{text}" in str(caught.value).splitlines()[0]


def rolled(board: FlatTarget) -> Array:
    """Return every tenth pixel of a board, for a comparison of its parts."""
    return board.image[::10, ::10]


def test_board_is_drawn_the_way_that_is_stated() -> None:
    stated = [make_estimator("apriltag", geometry(way), {}).board for way in ("official", "opencv")]  # type: ignore[attr-defined]
    assert (rolled(stated[0]) == rolled(stated[1])[::-1, ::-1]).mean() > 0.97
    assert (rolled(stated[0]) == rolled(stated[1])).mean() < 0.9


def test_command_measures_tags_by_the_estimator_of_a_rig(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, pair_ in enumerate((seen("36h11", TWO), seen("36h11", TWO, hidden=2))):
        for side, image in zip(("left", "right"), pair_, strict=True):
            (tmp_path / side).mkdir(exist_ok=True)
            cv2.imwrite(str(tmp_path / side / f"{number}.png"), image)
    rig, made, out = tmp_path / "tags.toml", tmp_path / "vmu.json", tmp_path / "poses.csv"
    rig.write_text(
        f'extends = "mock"\nvmu.estimator = "apriltag"\nvmu.estimator_settings.tags = {[list(tag) for tag in TWO]}\n'
    )
    made.write_text(geometry(None).model_dump_json())
    command = ["vmu", str(tmp_path), "--geometry", str(made), "--rig", str(rig), "--out", str(out)]
    assert execute(command) == PASSED
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["status"] for row in rows] == ["ok", "rejected_print"]
    assert float(rows[0]["z_m"]) == pytest.approx(AT[2], abs=0.01)
    said = capsys.readouterr().out
    assert f'or not the stated one: state print = "official" or "opencv" in {made}' in " ".join(said.split())
    rig.write_text('extends = "mock"\nvmu.estimator = "apriltag"\n')
    assert execute(command) == BAD_INPUT
    assert f"{made}: print: is missing: a single tag has one pose for" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"baseline_m": (200.0, 0.0, 0.0)}, "baseline_m: 200 m, allowed 10 m: millimetres?"),
        (
            {"leds_m": ((120.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))},
            "leds_m: 120 m, allowed 20 m: millimetres?",
        ),
        ({"right_rotation_rad": (0.0, 5.0, 0.0)}, "right_rotation_rad: 5 rad, allowed 3.1416 rad: degrees?"),
        ({"left": {**geometry().left.model_dump(), "fx": 8.0}}, "left.fx, fy: 8, 800 px of 640 px width: pixels, not"),
    ],
)
def test_sizes_beyond_a_bench_name_the_likely_mistake(tmp_path: Path, change: dict[str, Any], text: str) -> None:
    path = tmp_path / "vmu.json"
    path.write_text(json.dumps(geometry().model_dump() | change))
    with pytest.raises(BadInput) as caught:
        load_geometry(str(path))
    assert text in str(caught.value)
    assert "\n" not in str(caught.value)
