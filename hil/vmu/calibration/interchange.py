"""Calibrations of other programs: files of OpenCV, Kalibr's camchain, and camera_info of ROS, read and written.

All have pixel centres at whole numbers, as geometry files. OpenCV's R, T and Kalibr's T_cn_cnm1 take a point of the
left camera to the right one, ``p_right = R p_left + T``; a geometry file has the right camera in the left one's frame,
``p_left = R^T p_right - R^T T``. ROS states the pair by the rectification of both cameras, and its P of the right one
has ``-fx B`` for a right camera at B. Lengths are metres; OpenCV's are those of the squares of its board.
"""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal, get_args
from xml.etree import ElementTree

import numpy as np
import yaml
from pydantic import ValidationError

from hil.config.vmu_geometry import VmuCamera, VmuGeometry
from hil.core.files import CONFIG_BYTES, read_text
from hil.core.messages import Array
from hil.errors import BadInput

log = logging.getLogger("hil")

Kind = Literal["opencv", "kalibr", "ros"]
KINDS: Final[tuple[str, ...]] = get_args(Kind)

_BROWN: Final = ("plumb_bob", "radtan", "rational_polynomial")
_MATRICES: Final = (("M1", "cameraMatrix1", "K1"), ("M2", "cameraMatrix2", "K2"))
_DISTORTIONS: Final = (("D1", "distCoeffs1"), ("D2", "distCoeffs2"))
_TAKEN: Final = 1e-3  # by which a rotation matrix may differ from one
_CENTRAL: Final = 0.1  # of an image, from its border to the principal point


class _Loader(yaml.SafeLoader):  # type: ignore[misc]
    """YAML with OpenCV's matrices as tables."""


_Loader.add_constructor(
    "tag:yaml.org,2002:opencv-matrix", lambda loader, node: loader.construct_mapping(node, deep=True)
)


def read_pair(kind: Kind, paths: Sequence[Path], nominal: VmuGeometry) -> VmuGeometry:
    """Return ``nominal`` with the cameras of a calibration of another program. Raises BadInput.

    paths: one file, or of OpenCV intrinsic and extrinsic parameters, of ROS the left and the right camera. OpenCV's
    files may lack the size of the images: it is that of ``nominal``.
    """
    tables = [_table(path) for path in paths]
    if kind == "ros":
        if len(tables) != 2:
            raise BadInput.single("VIEWS", "", "give the camera_info of both cameras: left.yaml,right.yaml")
        cameras = _of_ros(paths, tables)
    else:
        source, merged = ",".join(map(str, paths)), {key: value for table in tables for key, value in table.items()}
        cameras = _of_opencv(source, merged, nominal) if kind == "opencv" else _of_kalibr(source, merged)
    try:
        return VmuGeometry.model_validate(nominal.model_dump(exclude={"calibration"}) | cameras)
    except ValidationError as error:
        first = error.errors()[0]
        key, text = ".".join(map(str, first["loc"])), str(first["msg"]).removeprefix("Value error, ")
        raise BadInput.single(str(paths[0]), key, text) from error


def written(kind: Kind, geometry: VmuGeometry) -> dict[str, str]:
    """Return the cameras of ``geometry`` as files of another program: text by the ending of the name."""
    cameras = geometry.left, geometry.right
    rotation, shift = _left_to_right(geometry)
    if kind == "kalibr":
        chain = {f"cam{i}": _kalibr_camera(camera) for i, camera in enumerate(cameras)}
        chain["cam1"]["T_cn_cnm1"] = [[*map(float, row), float(t)] for row, t in zip(rotation, shift, strict=True)]
        chain["cam1"]["T_cn_cnm1"].append([0.0, 0.0, 0.0, 1.0])
        return {"camchain.yaml": yaml.safe_dump(chain, default_flow_style=None, sort_keys=False)}
    if kind == "opencv":
        matrices = {"M1": _matrix(cameras[0]), "D1": [cameras[0].distortion], "M2": _matrix(cameras[1])}
        matrices |= {"D2": [cameras[1].distortion], "R": rotation, "T": [[t] for t in shift]}
        size = f"image_width: {cameras[0].width}\nimage_height: {cameras[0].height}\n"
        blocks = (_opencv_matrix(name, np.array(value, float)) for name, value in matrices.items())
        return {"stereo.yml": f"%YAML:1.0\n---\n{size}{''.join(blocks)}"}
    return _ros_files(geometry)


def _ros_files(geometry: VmuGeometry) -> dict[str, str]:
    """Return the camera_info of both cameras, rectified about the line between them."""
    baseline = np.array(geometry.baseline_m)
    length = float(np.linalg.norm(baseline))
    if not length > 0.0:
        raise BadInput.single("--to", "ros", "baseline_m is 0: camera_info states a pair by its baseline")
    x = baseline / length
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    to_rectified = np.array([x, y, np.cross(x, y)])
    right_to_left = _left_to_right(geometry)[0].T
    focal = 0.25 * sum(camera.fx + camera.fy for camera in (geometry.left, geometry.right))
    texts = {}
    for name, turn, offset in (("left", np.eye(3), 0.0), ("right", right_to_left, -focal * length)):
        camera: VmuCamera = getattr(geometry, name)
        middle = geometry.left.cx, geometry.left.cy
        projection = [focal, 0.0, middle[0], offset, 0.0, focal, middle[1], 0.0, 0.0, 0.0, 1.0, 0.0]
        table: dict[str, Any] = {
            "image_width": camera.width,
            "image_height": camera.height,
            "camera_name": name,
            "camera_matrix": {"rows": 3, "cols": 3, "data": [float(x) for row in _matrix(camera) for x in row]},
            "distortion_model": "plumb_bob",
            "distortion_coefficients": {"rows": 1, "cols": 5, "data": list(camera.distortion)},
            "rectification_matrix": {"rows": 3, "cols": 3, "data": [float(x) for x in (to_rectified @ turn).ravel()]},
            "projection_matrix": {"rows": 3, "cols": 4, "data": [float(number) for number in projection]},
        }
        texts[f"{name}.yaml"] = yaml.safe_dump(table, default_flow_style=None, sort_keys=False)
    return texts


def _of_opencv(source: str, table: Mapping[str, Any], nominal: VmuGeometry) -> dict[str, Any]:
    """Return the keys of a geometry file from the matrices of stereoCalibrate."""
    is_sized = any(key in table for key in ("image_width", "image_size", "imageSize"))
    cameras = {}
    for side, matrix, distortion in zip(("left", "right"), _MATRICES, _DISTORTIONS, strict=True):
        size = _size(source, table) if is_sized else (getattr(nominal, side).width, getattr(nominal, side).height)
        coefficients = _list(source, table, distortion)
        if table.get("fisheye_model") or len(coefficients) == 4:
            text = "4 coefficients, as of cv2.fisheye, which is not supported: of k1 k2 p1 p2 add k3, 0"
            raise BadInput.single(source, distortion[0], text)
        cameras[side] = _camera(source, _array(source, table, matrix, (3, 3)), coefficients, size)
    rotation = _array(source, table, ("R",), (3, 3))
    return cameras | _pair(source, rotation, _array(source, table, ("T",), (3, 1)).ravel())


def _of_kalibr(source: str, table: Mapping[str, Any]) -> dict[str, Any]:
    if others := sorted(name for name in table if name not in ("cam0", "cam1")):
        log.warning("%s: the pair is cam0, left, and cam1, right: %s not used", source, ", ".join(others))
    cameras = {}
    for side, name in (("left", "cam0"), ("right", "cam1")):
        camera = _inner(source, table, name)
        for key, allowed in (("camera_model", "pinhole"), ("distortion_model", "radtan")):
            if camera.get(key) != allowed:
                raise BadInput.single(source, f"{name}.{key}", f"{camera.get(key)!r}: allowed {allowed!r}")
        fx, fy, cx, cy = _numbers(source, f"{name}.intrinsics", camera.get("intrinsics"), 4)
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        size = [int(n) for n in _numbers(source, f"{name}.resolution", camera.get("resolution"), 2)]
        distortion = _numbers(source, f"{name}.distortion_coeffs", camera.get("distortion_coeffs"), 4)
        cameras[side] = _camera(source, matrix, distortion, (size[0], size[1]))
    rows = _inner(source, table, "cam1").get("T_cn_cnm1")
    pose = np.array(_numbers(source, "cam1.T_cn_cnm1", np.ravel(rows).tolist() if rows is not None else None, 16))
    pose = pose.reshape(4, 4)
    return cameras | _pair(source, pose[:3, :3], pose[:3, 3])


def _of_ros(paths: Sequence[Path], tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    cameras, turns, baselines = {}, [], []
    for side, path, table in zip(("left", "right"), paths, tables, strict=True):
        source = str(path)
        if (model := table.get("distortion_model", "plumb_bob")) not in _BROWN:
            raise BadInput.single(source, "distortion_model", f"{model!r}: allowed {', '.join(_BROWN)}")
        _check_whole_image(source, table)
        matrix = _array(source, table, ("camera_matrix", "K", "k"), (3, 3))
        distortion = _list(source, table, ("distortion_coefficients", "D", "d"))
        cameras[side] = _camera(source, matrix, distortion, _size(source, table))
        turns.append(_array(source, table, ("rectification_matrix", "R", "r"), (3, 3)))
        projection = _array(source, table, ("projection_matrix", "P", "p"), (3, 4))
        if not projection[0, 0] > 0.0:
            raise BadInput.single(source, "projection_matrix", "its focal length is 0: the camera is not calibrated")
        baselines.append(-projection[0, 3] / projection[0, 0])
    if not abs(baselines[1] - baselines[0]) > 0.0:
        text = "0 for the right camera: calibrate the cameras as a pair, or give left and right in this order"
        raise BadInput.single(str(paths[1]), "projection_matrix", text)
    left, right = turns
    shift = -right.T @ np.array([baselines[1] - baselines[0], 0.0, 0.0])
    return cameras | _pair(str(paths[1]), right.T @ left, shift)


def _check_whole_image(source: str, table: Mapping[str, Any]) -> None:
    """Raise BadInput for a message of ROS whose images are a part, or binned, of those that were calibrated."""
    region = table.get("roi")
    parts = [table.get(key, 0) for key in ("binning_x", "binning_y")]
    offsets = [region.get(key, 0) for key in ("x_offset", "y_offset")] if isinstance(region, dict) else []
    if any(part not in (0, 1) for part in parts) or any(offsets):
        raise BadInput.single(source, "binning, roi", "must be none: calibrate the images as they are evaluated")


def _pair(source: str, rotation: Array, shift: Array) -> dict[str, Any]:
    """Return the keys of the right camera for ``p_right = rotation p_left + shift``. Raises BadInput."""
    from scipy.spatial.transform import Rotation

    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_TAKEN) or np.linalg.det(rotation) < 0.0:
        raise BadInput.single(source, "R", "is no rotation matrix")
    baseline = -rotation.T @ shift
    return {
        "baseline_m": tuple(map(float, baseline)),
        "right_rotation_rad": tuple(map(float, Rotation.from_matrix(rotation.T).as_rotvec())),
    }


def _left_to_right(geometry: VmuGeometry) -> tuple[Array, Array]:
    """Return R, T with ``p_right = R p_left + T``."""
    from scipy.spatial.transform import Rotation

    rotation = np.asarray(Rotation.from_rotvec(geometry.right_rotation_rad).as_matrix().T)
    return rotation, -rotation @ np.array(geometry.baseline_m)


def _camera(source: str, matrix: Array, distortion: Sequence[float], size: tuple[int, int]) -> dict[str, Any]:
    """Return a camera with k1 k2 p1 p2 k3; further coefficients must be 0. Raises BadInput."""
    if abs(matrix[0, 1]) > 0.0 or any(distortion[5:]) or len(distortion) < 4:
        what = "skew" if abs(matrix[0, 1]) > 0.0 else "distortion"
        raise BadInput.single(source, what, "only k1 k2 p1 p2 k3 are supported: calibrate with these")
    numbers = [*distortion[:5], 0.0][:5]
    names = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2]}
    if np.abs(matrix[:2, 2] / size - 0.5).max() > 0.5 - _CENTRAL:
        at = f"{names['cx']:g}, {names['cy']:g} px"
        text = f"{at}: not near the middle of {size[0]} x {size[1]} px: of another camera mode?"
        raise BadInput.single(source, "principal point", text)
    size_of = {"width": size[0], "height": size[1]}
    return {name: float(value) for name, value in names.items()} | size_of | {"distortion": tuple(map(float, numbers))}


def _matrix(camera: VmuCamera) -> list[list[float]]:
    return [[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]]


def _kalibr_camera(camera: VmuCamera) -> dict[str, Any]:
    if camera.distortion[4]:
        raise BadInput.single("--to", "kalibr", f"has no k3, which is {camera.distortion[4]:g} here")
    return {
        "camera_model": "pinhole",
        "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
        "distortion_model": "radtan",
        "distortion_coeffs": list(camera.distortion[:4]),
        "resolution": [camera.width, camera.height],
    }


def _opencv_matrix(name: str, matrix: Array) -> str:
    numbers = ", ".join(repr(float(number)) for number in matrix.ravel())
    rows, columns = matrix.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"


def _table(path: Path) -> dict[str, Any]:
    text = read_text(path, CONFIG_BYTES).lstrip("\ufeff")
    if text.lstrip().startswith("<?xml"):
        return _of_xml(path, text)
    try:
        documents = list(yaml.load_all(re.sub(r"\A%YAML[:\d. ]*\r?\n(---)?", "", text), _Loader))
        table = documents[0] if documents[1:] in ([], [None]) else None  # messages that ROS prints end with ---
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise BadInput.single(str(path), "", f"not YAML: {' '.join(str(error).split())[:120]}") from error
    if not isinstance(table, dict):
        raise BadInput.single(str(path), "", "must be a table of keys and values")
    return table


def _of_xml(path: Path, text: str) -> dict[str, Any]:
    """Return the table of an XML file of OpenCV."""
    try:
        if re.search(r"<!(?!--)", text):
            raise ValueError("it declares a type of document")
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise BadInput.single(str(path), "", f"not XML: {error}") from error
    table: dict[str, Any] = {}
    for node in root:
        words = (node.findtext("data", "") if len(node) else node.text or "").split()
        is_number = len(words) == 1 and words[0].isdecimal() and not len(node)
        table[node.tag] = int(words[0]) if is_number else words
    return table


def _inner(source: str, table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    inner = table.get(name)
    if not isinstance(inner, dict):
        raise BadInput.single(source, name, "is missing, or is no table")
    return inner


def _size(source: str, table: Mapping[str, Any]) -> tuple[int, int]:
    size = [table.get(f"image_{key}", table.get(key)) for key in ("width", "height")]
    if not all(isinstance(number, int) for number in size):
        size = _numbers(source, "image_width, image_height", table.get("image_size", table.get("imageSize")), 2)
    return int(size[0]), int(size[1])


def _numbers(source: str, key: str, value: Any, count: int | None = None) -> list[float]:
    """Return ``value`` as numbers. Raises BadInput."""
    try:
        numbers = [float(number) for number in value]
    except (TypeError, ValueError) as error:
        raise BadInput.single(source, key, "is missing, or is no list of numbers") from error
    if not all(map(math.isfinite, numbers)) or count not in (None, len(numbers)):
        raise BadInput.single(source, key, f"must be {count or 'finite'} numbers, is {str(numbers)[:60]}")
    return numbers


def _list(source: str, table: Mapping[str, Any], names: Sequence[str]) -> list[float]:
    name = next((name for name in names if name in table), names[0])
    value = table.get(name)
    return _numbers(source, name, value.get("data") if isinstance(value, dict) else value)


def _array(source: str, table: Mapping[str, Any], names: Sequence[str], shape: tuple[int, int]) -> Array:
    numbers = _list(source, table, names)
    if len(numbers) != shape[0] * shape[1]:
        raise BadInput.single(source, names[0], f"must be {shape[0]} x {shape[1]}, has {len(numbers)} numbers")
    return np.array(numbers).reshape(shape)
