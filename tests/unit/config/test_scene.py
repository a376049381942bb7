"""Scene files of the docking monitor: what may be left out, and what no target can be."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.config.load import load_scene, shipped
from hil.errors import BadInput

Change = Callable[[dict[str, Any]], object]

SCENE: dict[str, Any] = {
    "camera": {"f": 1100.0, "cx": 383.5, "cy": 287.5, "width": 768, "height": 576, "sky": 12},
    "fps": 12.5,
    "target": {
        "disc": {"radius_m": 0.3, "level": 205},
        "plate": {"width_m": 0.8, "height_m": 0.8, "level": 70},
        "cross": {"offset_m": 0.3, "arm_length_m": 0.16, "arm_width_m": 0.03, "level": 25},
        "labels": {"radius_m": 0.022, "level": 40, "centers_m": [[0.24, 0.0], [-0.24, 0.0]]},
        "boxes": [{"x_m": -1.1, "y_m": 0.0, "width_m": 0.5, "height_m": 0.7, "offset_m": 0.0, "level": 225}],
        "outline": {"radius_m": 2.24, "center_m": [0.0, 0.0], "offset_m": -0.4, "level": 120},
    },
}


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Change], str]:
    """Return a function that changes a good scene, writes it as JSON and returns its path."""

    def put(change: Change) -> str:
        table = copy.deepcopy(SCENE)
        change(table)
        path = tmp_path / "scene.json"
        path.write_text(json.dumps(table), encoding="utf-8")
        return str(path)

    return put


def test_shipped_scenes_load_and_have_a_reserve_and_an_inverse_one() -> None:
    assert {"atv", "bright-cross"} <= set(shipped("targets"))
    scenes = {name: load_scene(name).value for name in shipped("targets")}
    assert all(scene.name == name for name, scene in scenes.items())
    atv = scenes["atv"]
    assert atv.chosen("backup") is atv.backup is not None
    assert atv.chosen("basic") is atv.target
    other = scenes["bright-cross"].target
    assert other.disc is not None
    assert other.cross is not None
    assert other.cross.level > other.disc.level


def test_json_and_toml_of_one_scene_are_equal(write: Callable[[Change], str]) -> None:
    def to_atv(table: dict[str, Any]) -> None:
        target = table["target"]
        target["labels"]["centers_m"] += [[0.0, 0.24], [0.0, -0.24]]
        target["boxes"].append({**target["boxes"][0], "x_m": 1.1})

    assert load_scene(write(to_atv)).value.target == load_scene("atv").value.target


def test_near_parts_alone_and_far_parts_alone_are_scenes(write: Callable[[Change], str]) -> None:
    def near_only(table: dict[str, Any]) -> None:
        table["target"] = {key: table["target"][key] for key in ("disc", "cross")}

    def far_only(table: dict[str, Any]) -> None:
        table["target"] = {"outline": {"radius_m": 2.24}}

    near, far = load_scene(write(near_only)).value.target, load_scene(write(far_only)).value.target
    assert (near.near, near.far) == (True, False)
    assert (far.near, far.far) == (False, True)


def test_scene_without_reserve_is_reported(write: Callable[[Change], str]) -> None:
    scene = load_scene(write(lambda table: None)).value
    with pytest.raises(ValueError, match="no backup target"):
        scene.chosen("backup")


@pytest.mark.parametrize("key", ["camera", "fps", "target", "camera.f", "camera.width", "target.disc.radius_m"])
def test_a_missing_key_is_one_line_with_its_name(write: Callable[[Change], str], key: str) -> None:
    def drop(table: dict[str, Any]) -> None:
        *parents, last = key.split(".")
        for parent in parents:
            table = table[parent]
        del table[last]

    path = write(drop)
    with pytest.raises(BadInput) as caught:
        load_scene(path)
    (problem,) = caught.value.problems
    assert (problem.source, problem.key) == (path, key)
    assert problem.message.startswith("is missing")


IMPOSSIBLE = [
    ("target.disc.radius_m", 0.0, "target.disc.radius_m: 0.0: must be greater than 0"),
    ("target.disc.radius_m", -0.3, "target.disc.radius_m: -0.3: must be greater than 0"),
    ("target.disc.radius_m", 0.5, "plate.width_m = 0.8: must be 1 or more, for disc.radius_m = 0.5"),
    ("target.disc.radius_m", 300.0, "must be less than or equal to 100"),
    ("target.cross.arm_width_m", 0.2, "arm_width_m = 0.2: must be less than arm_length_m = 0.16"),
    ("target.cross.arm_length_m", 0.31, "arm_length_m = 0.31: the arms must end inside disc.radius_m = 0.3"),
    ("target.cross.offset_m", -0.3, "target.cross.offset_m: -0.3: must be greater than 0"),
    ("target.cross.offset_m", 0.0, "target.cross.offset_m: 0.0: must be greater than 0"),
    ("target.labels.centers_m", [[0.29, 0.0]], "labels.centers_m[0] = [0.29, 0.0]: with labels.radius_m = 0.022"),
    ("target.labels.centers_m", [[0.1, 0.0], [0.1, 0.03]], "must be more than 0.044 from centers_m[0]"),
    ("target.plate.height_m", 0.5, "plate.height_m = 0.5: must be 0.6 or more"),
    ("target.outline.radius_m", 0.2, "outline.radius_m = 0.2: must be more than 0.3, around disc.radius_m = 0.3"),
    ("target.outline", {}, "target.outline: radius_m and corners_m: give one of them, of a circle or of a polygon"),
    ("target.outline.corners_m", [[2, 0], [0, 2], [-2, -2]], "radius_m and corners_m: give one of them"),
    ("target.outline", {"corners_m": [[2, 0], [0, 2]]}, "corners_m with 2 corners: must be 3 or more"),
    (
        "target.outline",
        {"corners_m": [[2, 0], [0, 2], [0, 2], [-2, 0]]},
        "corners_m[1] = [0.0, 2.0]: must not be equal",
    ),
    (
        "target.outline",
        {"corners_m": [[2, 2], [-2, -2], [2, -2], [-2, 2]]},
        "the edges from corners_m[0] and corners_m[2] must not cross",
    ),
    ("target.outline", {"corners_m": [[1, 1], [2, 2], [3, 3]]}, "the corners must not lie on one line"),
    (
        "target.outline",
        {"corners_m": [[2, 2], [-2, 2], [2, -2]], "center_m": [1, 0]},
        "center_m = [1.0, 0.0]: is the centre of a circle, not for corners_m",
    ),
    (
        "target.outline",
        {"corners_m": [[5, 5], [1, 5], [1, 1], [5, 1]]},
        "outline.corners_m: must lie around disc.radius_m = 0.3",
    ),
    (
        "target.outline",
        {"corners_m": [[2, 2], [-0.2, 2], [-0.2, -2], [2, -2]]},
        "outline.corners_m: must lie around disc.radius_m = 0.3",
    ),
    ("target.outline.offset_m", 0.4, "target.outline.offset_m: 0.4: must be less than or equal to 0"),
    ("target.boxes", [{"x_m": 0.1, "y_m": 0, "width_m": 1, "height_m": 1}], "must not lie over disc.radius_m = 0.3"),
    ("target.cross", None, "target: cross is missing: disc needs it"),
    ("target.disc", None, "target: disc is missing: cross needs it"),
    ("target", {}, "disc with cross, and outline, are missing: give one or both"),
    ("target.disk", {"radius_m": 0.3}, "target.disk: unknown key: did you mean disc?"),
    ("camera.width", 0, "camera.width: 0: must be greater than or equal to 32"),
    ("camera.height", 576.5, "camera.height: 576.5: must be a valid integer"),
    ("camera.f", 0.0, "camera.f: 0.0: must be greater than 0"),
    ("camera.f", 11.0, "f = 11: must be 153.6 to 153600 px for an image of 768 x 576"),
    ("camera.cx", 4000.0, "cx = 4000: the principal point must be in the image, -0.5 to 767.5"),
    ("camera.sky", 300, "camera.sky: 300: must be less than or equal to 255"),
    ("fps", 0, "fps: 0: must be greater than 0"),
    ("fields", "odd", 'fields: "odd": must be'),
]


@pytest.mark.parametrize(("key", "value", "said"), IMPOSSIBLE)
def test_an_impossible_scene_is_one_line_with_key_value_and_what_is_allowed(
    write: Callable[[Change], str], key: str, value: object, said: str
) -> None:
    def spoil(table: dict[str, Any]) -> None:
        *parents, last = key.split(".")
        for parent in parents:
            table = table[parent]
        table[last] = value
        if value is None:
            del table[last]

    path = write(spoil)
    with pytest.raises(BadInput) as caught:
        load_scene(path)
    lines = str(caught.value).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"{path}: ")
    assert said in lines[0]


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("scene.json", '{"camera": ', "not JSON"),
        ("scene.json", "[1, 2]", "must be a table"),
        ("scene.json", '{"fps": NaN}', "fps"),
        ("scene.toml", "camera = ", "not TOML"),
    ],
)
def test_file_that_is_no_scene_is_reported(tmp_path: Path, name: str, text: str, said: str) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=said):
        load_scene(str(path))


def test_an_unknown_scene_lists_the_shipped_ones() -> None:
    with pytest.raises(BadInput, match=r"unknown scene: give atv, bright-cross or the path of a scene file"):
        load_scene("nothing-like-it")
