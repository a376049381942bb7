"""Calibrations of OpenCV, Kalibr and ROS: the conventions of each, by OpenCV's own projection and rectification."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from hil.cli.main import PASSED, execute
from hil.config.load import load_geometry
from hil.config.vmu_geometry import VmuGeometry
from hil.errors import BadInput
from hil.vmu.calibration.interchange import read_pair, written
from hil.vmu.geometry import camera_pair
from hil.vmu.kernels.lens import project
from tests.unit.vmu.test_pose_estimators import geometry

SIZE = (640, 480)
CAMERAS = ((700.0, 318.2, 241.0), (705.0, 322.0, 238.5))
MATRICES = [np.array([[f, 0.0, cx], [0.0, f + 1.0, cy], [0.0, 0.0, 1.0]]) for f, cx, cy in CAMERAS]
BENT = [np.array([-0.1, 0.02, 1e-3, -5e-4, 0.003]), np.array([-0.12, 0.03, -1e-3, 2e-4, -0.001])]
R = Rotation.from_rotvec([0.02, -0.15, 0.01]).as_matrix()
T = np.array([-0.21, 0.004, 0.02])
POINTS = np.array([[0.1, -0.05, 1.2], [-0.2, 0.1, 1.8], [0.0, 0.0, 2.5]])


def opencv_file(path: Path, shift: Any = T, names: tuple[str, ...] = ("M1", "D1", "M2", "D2", "R", "T")) -> Path:
    """Write the result of stereoCalibrate by OpenCV itself; names: of its matrices, some alone without the size."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    if len(names) == 6:
        storage.write("image_width", SIZE[0])
        storage.write("image_height", SIZE[1])
    matrices = {"M1": MATRICES[0], "D1": BENT[0], "M2": MATRICES[1], "D2": BENT[1], "R": R, "T": shift}
    for name in names:
        storage.write(name, np.atleast_2d(matrices[name]))
    storage.release()
    return path


def kalibr_file(path: Path) -> Path:
    chain: dict[str, dict[str, Any]] = {}
    for i, (matrix, bent) in enumerate(zip(MATRICES, BENT, strict=True)):
        numbers = [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]]
        chain[f"cam{i}"] = {
            "camera_model": "pinhole", "intrinsics": list(map(float, numbers)), "distortion_model": "radtan",
            "distortion_coeffs": list(map(float, bent[:4])), "resolution": list(SIZE), "rostopic": f"/cam{i}/image_raw",
        }  # fmt: skip
    pose = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]])
    chain["cam1"]["T_cn_cnm1"] = pose.tolist()
    path.write_text(yaml.safe_dump(chain))
    return path


def ros_files(folder: Path) -> list[Path]:
    """Write camera_info as camera_calibration of ROS does, by OpenCV's stereoRectify."""
    rectified = cv2.stereoRectify(MATRICES[0], BENT[0], MATRICES[1], BENT[1], SIZE, R, T[:, None])
    paths = []
    for i, name in enumerate(("left", "right")):
        table = {
            "image_width": SIZE[0], "image_height": SIZE[1], "camera_name": name, "distortion_model": "plumb_bob",
            "camera_matrix": {"rows": 3, "cols": 3, "data": MATRICES[i].ravel().tolist()},
            "distortion_coefficients": {"rows": 1, "cols": 5, "data": BENT[i].tolist()},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": rectified[i].ravel().tolist()},
            "projection_matrix": {"rows": 3, "cols": 4, "data": rectified[2 + i].ravel().tolist()},
        }  # fmt: skip
        paths.append(folder / f"{name}.yaml")
        paths[-1].write_text(yaml.safe_dump(table))
    return paths


def ros_messages(folder: Path) -> list[Path]:
    """Write camera_info as ``ros2 topic echo --once`` prints it."""
    names = {
        "camera_matrix": "k",
        "distortion_coefficients": "d",
        "rectification_matrix": "r",
        "projection_matrix": "p",
    }
    paths = []
    for path in ros_files(folder):
        table = yaml.safe_load(path.read_text())
        message: dict[str, Any] = {"height": SIZE[1], "width": SIZE[0], "distortion_model": "rational_polynomial"}
        message |= {short: table[name]["data"] for name, short in names.items()}
        message |= {"d": [*message["d"], 0.0, 0.0, 0.0], "binning_x": 0, "binning_y": 0, "roi": {"x_offset": 0}}
        paths.append(path.with_name(f"echo-{path.name}"))
        paths[-1].write_text(f"{yaml.safe_dump(message)}---\n")
    return paths


def pixels(found: VmuGeometry) -> list[np.ndarray]:
    """Return where both cameras of a geometry file see POINTS of the left camera."""
    pair = camera_pair(found)
    return [
        np.array([project(lens, *(rotation @ point + shift)) for point in POINTS])
        for lens, rotation, shift in zip(pair.lens.view(np.recarray), pair.rotation, pair.translation, strict=True)
    ]


def expected(bent: list[np.ndarray]) -> list[np.ndarray]:
    turn, _ = cv2.Rodrigues(R)
    places = ((np.zeros(3), np.zeros(3)), (turn, T))
    return [
        cv2.projectPoints(POINTS, *place, matrix, coefficients)[0].reshape(-1, 2)
        for place, matrix, coefficients in zip(places, MATRICES, bent, strict=True)
    ]


def test_cameras_of_each_program_see_what_opencv_projects(tmp_path: Path) -> None:
    without_k3 = [bent * [1, 1, 1, 1, 0] for bent in BENT]
    for kind, paths, bent in (
        ("opencv", [opencv_file(tmp_path / "stereo.yml")], BENT),
        ("opencv", [opencv_file(tmp_path / "stereo.xml")], BENT),
        (
            "opencv",
            [
                opencv_file(tmp_path / "s.yml", names=("M1", "D1", "M2", "D2")),
                opencv_file(tmp_path / "extrinsics.yml", names=("R", "T")),
            ],
            BENT,
        ),
        ("kalibr", [kalibr_file(tmp_path / "camchain.yaml")], without_k3),
        ("ros", ros_messages(tmp_path), BENT),
        ("ros", ros_files(tmp_path), BENT),
    ):
        found = read_pair(kind, paths, geometry(None))  # type: ignore[arg-type]
        for seen, right in zip(pixels(found), expected(bent), strict=True):
            np.testing.assert_allclose(seen, right, atol=1e-6)


@pytest.mark.parametrize("kind", ["opencv", "kalibr", "ros"])
def test_what_is_written_is_read_back(tmp_path: Path, kind: Any) -> None:
    chain = read_pair("kalibr", [kalibr_file(tmp_path / "c.yaml")], geometry(None))
    paths = []
    for name, text in written(kind, chain).items():
        (tmp_path / name).write_text(text)
        paths.append(tmp_path / name)
    for seen, right in zip(pixels(read_pair(kind, paths, geometry(None))), pixels(chain), strict=True):
        np.testing.assert_allclose(seen, right, atol=1e-6)
    if kind == "opencv":
        storage = cv2.FileStorage(str(paths[0]), cv2.FILE_STORAGE_READ)
        np.testing.assert_allclose(storage.getNode("T").mat().ravel(), T, atol=1e-12)
        storage.release()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("radtan", "equidistant", "cam0.distortion_model: 'equidistant': allowed 'radtan'"),
        ("pinhole", "omni", "cam0.camera_model: 'omni': allowed 'pinhole'"),
        ("T_cn_cnm1", "T_cam_imu", "cam1.T_cn_cnm1: is missing"),
        ("cam1:", "cam7:", "cam1: is missing"),
        ("cam0:", "{{", "not YAML"),
    ],
)
def test_calibration_that_cannot_be_used_is_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = kalibr_file(tmp_path / "c.yaml")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(BadInput) as caught:
        read_pair("kalibr", [path], geometry(None))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("rational_polynomial", "equidistant", "distortion_model: 'equidistant': allowed plumb_bob"),
        ("binning_x: 0", "binning_x: 2", "binning, roi: must be none"),
        ("x_offset: 0", "x_offset: 64", "binning, roi: must be none"),
        ("width: 640", "width: 320", "principal point: 318.2, 241 px"),
        ("width: 640", "breadth: 640", "image_width, image_height: is missing"),
    ],
)
def test_message_of_ros_that_cannot_be_used_is_one_line(tmp_path: Path, old: str, new: str, words: str) -> None:
    paths = ros_messages(tmp_path)
    assert old in paths[0].read_text()
    paths[0].write_text(paths[0].read_text().replace(old, new, 1))
    with pytest.raises(BadInput) as caught:
        read_pair("ros", paths, geometry(None))
    assert words in str(caught.value)


def test_fisheye_cameras_of_opencv_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "stereo.yml"
    for coefficients in ("[ -0.02, 0.01, 0.003, -0.001 ]", "[ -0.02, 0.01, 0.003, -0.001, 0. ]\nfisheye_model: 1"):
        text = opencv_file(path).read_text()
        begin = text.index("D2:")
        end = text.index("R:")
        values = f"D2: !!opencv-matrix\n   rows: 1\n   cols: 5\n   dt: d\n   data: {coefficients}\n"
        path.write_text(text[:begin] + values + text[end:])
        with pytest.raises(BadInput, match=r"stereo\.yml: D[12]: 4 coefficients, as of cv2\.fisheye"):
            read_pair("opencv", [path], geometry(None))


def test_further_cameras_of_a_chain_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = kalibr_file(tmp_path / "c.yaml")
    chain = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(chain | {"cam2": chain["cam1"]}))
    read_pair("kalibr", [path], geometry(None))
    assert "the pair is cam0, left, and cam1, right: cam2 not used" in caplog.text


def test_baseline_in_millimetres_is_refused_and_the_command_writes_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "vmu.toml")
    millimetres = str(opencv_file(tmp_path / "mm.yml", 1e3 * T))
    assert execute(["calibrate", millimetres, "--from", "opencv", "--out", out]) == 2
    assert "allowed 10 m: millimetres?" in capsys.readouterr().err
    assert execute(["calibrate", str(opencv_file(tmp_path / "m.yml")), "--from", "opencv", "--out", out]) == PASSED
    assert load_geometry(out).value.baseline_m == pytest.approx(tuple(-R.T @ T))
    assert execute(["calibrate", out, "--to", "ros"]) == PASSED
    assert sorted(path.name for path in tmp_path.glob("vmu-*.yaml")) == ["vmu-left.yaml", "vmu-right.yaml"]
