"""Identity of cameras: another camera, region or orientation is refused with key and values."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.camera_identity import (
    CAMERAS_FILE,
    CameraIdentity,
    check_same,
    file_doubt,
    identity_doubt,
    identity_problem,
    write_identities,
)
from hil.config.load import load_rig, load_scene
from hil.drivers.cameras.node_map import NodeMap
from hil.drivers.cameras.processes import CameraProcesses
from hil.errors import BadInput, DeviceError
from hil.vmu.calibration.files import as_toml
from hil.vmu.geometry import geometry_of_rig

STATED = CameraIdentity(
    model="ACME C1", serial="17", firmware="1.2", lens="12 mm, 1.5 m", sensor_px=(2048, 2048), offset_px=(512, 512),
    binning=(1, 1), reversed=(False, False), date="2026-03-01",
)  # fmt: skip
OTHERS = {
    "model": "ACME C2", "serial": "18", "firmware": "1.3", "lens": "16 mm", "sensor_px": (2448, 2048),
    "offset_px": (528, 512), "binning": (2, 2), "reversed": (True, False),
}  # fmt: skip
SMALL = ("rig.vmu.camera.focal_px=500.0", "rig.vmu.camera.width_px=400", "rig.vmu.camera.height_px=400")


@pytest.mark.parametrize(("key", "value"), OTHERS.items())
def test_each_key_of_another_camera_is_named_with_both_values(key: str, value: object) -> None:
    other = STATED.model_copy(update={key: value})
    problem = identity_problem({"left": STATED}, {"left": other})
    assert problem == ("left", key, json.dumps(getattr(STATED, key)), json.dumps(value))
    with pytest.raises(BadInput, match=rf"^other\.toml: left\.identity\.{key}: "):
        check_same({"left": STATED}, {"left": other}, "other.toml", "the recording has")
    assert identity_problem({"left": STATED.model_copy(update={key: None})}, {"left": other}) is None


def test_same_camera_on_another_day_is_proven_and_a_bare_one_is_not() -> None:
    today = STATED.model_copy(update={"date": "2026-05-05", "lens": None})
    assert identity_problem({"left": STATED}, {"left": today}) is None
    assert identity_doubt({"left": STATED}, {"left": today}) == ""
    assert identity_doubt({"left": STATED, "right": None}, {"left": today}) == (
        "identity not proven: no serial and offset_px in file (right), images (right)"
    )
    assert identity_doubt({"left": STATED}, {}) == "identity not proven: no serial and offset_px in images"


def test_features_of_a_camera_are_its_identity() -> None:
    nodes: dict[str, object] = {
        "DeviceVendorName": "ACME", "DeviceModelName": "C1", "DeviceSerialNumber": "17", "DeviceVersion": "1.2",
        "SensorWidth": 2048, "SensorHeight": 2048, "OffsetX": 512, "OffsetY": 512, "BinningHorizontal": 1,
        "BinningVertical": 1, "ReverseX": False, "ReverseY": False,
    }  # fmt: skip

    def find(feature: str) -> object:
        return SimpleNamespace(value=nodes[feature]) if feature in nodes else None

    assert NodeMap("vmu.left", find, RuntimeError).identity == STATED.model_copy(update={"lens": None, "date": None})
    nodes["ReverseX"] = True
    del nodes["ReverseY"]  # most cameras mirror along u alone
    assert NodeMap("vmu.left", find, RuntimeError).identity.reversed == (True, False)
    nodes.clear()
    nothing = NodeMap("vmu.left", find, RuntimeError).identity
    assert nothing == CameraIdentity(binning=(1, 1), reversed=(False, False))


def test_an_open_camera_that_is_another_one_is_refused_by_its_name() -> None:
    cameras = CameraProcesses.__new__(CameraProcesses)
    cameras.identities = {"vmu.left": STATED, "vmu.right": STATED}
    assert cameras.check_identities({"vmu.left": STATED, "vmu.right": STATED}) == ""
    with pytest.raises(DeviceError, match=r'vmu\.right: serial "17": its geometry or scene file has .*serial "18"'):
        cameras.check_identities({"vmu.left": STATED, "vmu.right": STATED.model_copy(update={"serial": "18"})})


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Return a folder with a dark pair of images, and the geometry file of its cameras."""
    geometry = geometry_of_rig(load_rig("mock", SMALL).value)
    sides = {side: getattr(geometry, side).model_copy(update={"identity": STATED}) for side in ("left", "right")}
    path = tmp_path / "vmu.toml"
    path.write_text(as_toml(geometry.model_copy(update=sides).model_dump(exclude_none=True), "Cameras."))
    for side in sides:
        (tmp_path / "images" / side).mkdir(parents=True)
        assert cv2.imwrite(str(tmp_path / "images" / side / "0001.png"), np.zeros((400, 400), np.uint8))
    return tmp_path / "images", path


def test_images_of_another_camera_are_refused_in_one_line(
    pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, geometry = pair
    shifted = STATED.model_copy(update={"offset_px": (528, 512)})
    write_identities({"left": STATED, "right": shifted}, folder)
    assert execute(["vmu", str(folder), "--geometry", str(geometry), "--out", str(folder / "poses.csv")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{geometry}: right.identity.offset_px: [512, 512]: the images of {folder} have [528, 512]" in line
    assert not (folder / "poses.csv").exists()
    (folder / CAMERAS_FILE).write_text("[1]")
    assert execute(["vmu", str(folder), "--geometry", str(geometry), "--out", str(folder / "poses.csv")]) == 2
    assert "cameras.json: not identities of cameras" in capsys.readouterr().err


def identities_in(path: Path) -> set[str]:
    with path.open(newline="") as file:
        return {row["identity"] for row in csv.DictReader(file)}


def test_verdict_and_each_row_state_whether_the_identity_is_proven(pair: tuple[Path, Path]) -> None:
    folder, geometry = pair
    report = folder / "report.json"
    words = ["vmu", str(folder), "--geometry", str(geometry), "--out", str(folder / "poses.csv"), "--json", str(report)]
    execute(words)
    bare = json.loads(report.read_text())
    assert bare["identity"].startswith("identity not proven: ")
    assert identities_in(folder / "poses.csv") == {"identity not proven"}
    write_identities({"left": STATED, "right": STATED}, folder)
    execute(words)
    proven = json.loads(report.read_text())
    assert proven["identity"] == "proven"
    assert proven["status"] == bare["status"]
    assert identities_in(folder / "poses.csv") == {"proven"}


def test_file_that_states_no_camera_is_named_when_it_is_written() -> None:
    assert file_doubt({"left": STATED, "right": STATED}, "vmu.toml") == ""
    assert file_doubt({"left": STATED, "right": None}, "vmu.toml").startswith("vmu.toml: identity not proven, ")


@pytest.mark.parametrize("is_video", [False, True])
def test_images_of_another_television_camera_are_refused(
    is_video: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = load_scene("atv").value.camera
    image = np.zeros((camera.height, camera.width), np.uint8)
    assert cv2.imwrite(str(tmp_path / "0001.png"), image)
    video = tmp_path / "video.mkv"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter_fourcc(*"FFV1"), 12.5, image.shape[::-1], isColor=False)
    for _ in range(3):
        writer.write(image)
    writer.release()
    source, out = str(video if is_video else tmp_path), tmp_path / "out.csv"
    scene = tmp_path / "mine.toml"
    scene.write_text(as_toml({"extends": "atv", "camera": {"identity": STATED.model_dump(exclude_none=True)}}, "Mine."))
    write_identities({"monitor": STATED.model_copy(update={"reversed": (True, False)})}, tmp_path)
    assert execute(["monitor", source, "--scene", str(scene), "--out", str(out)]) == 2
    assert "monitor.identity.reversed: [false, false]: the images of" in capsys.readouterr().err
    write_identities({"monitor": STATED}, tmp_path)
    assert execute(["monitor", source, "--scene", str(scene), "--out", str(out)]) == 0
    assert identities_in(out) == {"proven"}
