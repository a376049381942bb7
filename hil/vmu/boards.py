"""Pose estimators of printed targets, AprilTags and ChArUco boards: corners by OpenCV, pose within the error budget."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Final, TypeVar

import cv2
import numpy as np
from pydantic import Field, ValidationError

from hil.config.tables.model import ConfigModel, Positive
from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput, Problem
from hil.maths import quat
from hil.vmu.estimators import FlatTarget, PoseEstimate
from hil.vmu.kernels.records import MAX_LEDS, SPOT
from hil.vmu.pose import Solver, SolverSettings, fits_within_budget

Corners = dict[int, tuple[float, float]]
_Settings = TypeVar("_Settings", bound=ConfigModel)

_SHIFTED: Final = 4.5  # sigmas between the two images
_DECISIVE: Final = 8.0  # of the score, by which one of the two tilts of a flat target is better
_PICTURE_PX: Final = 2000
_MARKER_PX: Final = 480
_REACH_PX, _ACROSS = 2.0, 17  # on both sides of an edge, and samples across it
_LEAST_CELL_PX: Final = 3.0
_ROUNDS: Final = 4
_CURVED_PX: Final = 80.0
_MOST_SOLVERS: Final = 64


class AprilTagSettings(ConfigModel):
    """``[vmu.estimator_settings]`` of ``apriltag``."""

    family: Annotated[str, Field(pattern="^(16h5|25h9|36h10|36h11)$")] = "36h11"
    """Family of the tags."""
    tags: Annotated[tuple[tuple[int, float, float, float], ...], Field(min_length=1)] = ((0, 0.2, 0.0, 0.0),)
    """Each tag: number, side of the black square, m, x and y of its centre in t, m."""
    corner_px: Positive = 0.1
    """Error of a corner in the image, 1 sigma."""


class CharucoSettings(ConfigModel):
    """``[vmu.estimator_settings]`` of ``charuco``."""

    dictionary: Annotated[str, Field(pattern="^[4-7]X[4-7]_(50|100|250|1000)$")] = "4X4_50"
    """Dictionary of the markers, in OpenCV's notation."""
    columns: Annotated[int, Field(ge=3)] = 7
    """Squares along x_t."""
    rows: Annotated[int, Field(ge=3)] = 5
    """Squares along y_t."""
    square_m: Positive = 0.04
    """Side of a square."""
    marker_m: Positive = 0.03
    """Side of a marker."""
    corner_px: Positive = 0.1
    """Error of a corner in the image, 1 sigma."""


class BoardEstimator:
    """Pose of a target with known corners, from both images. Up to MAX_LEDS of them are used, those far apart.

    points_t: (n, 3), m, corners in t. find: corners of an image by number, px. corner_px: their error, 1 sigma.
    """

    def __init__(
        self,
        geometry: VmuGeometry,
        points_t: Array,
        find: Callable[[np.ndarray], Corners],
        corner_px: float,
        board: FlatTarget,
    ) -> None:
        self.board = board
        self._geometry, self._points, self._find, self._variance = geometry, points_t, find, corner_px**2
        self._solvers: dict[tuple[int, ...], Solver] = {}

    def warm_up(self) -> None:
        """Compile the kernels and load OpenCV's detector by one pair that shows the target."""
        cameras = (self._geometry.left, self._geometry.right)
        left, right = (cv2.resize(self.board.image, (camera.width, camera.height)) for camera in cameras)
        self.solve(left, right, 0.0)

    def solve(self, left: np.ndarray | None, right: np.ndarray | None, t_s: float) -> PoseEstimate:
        """Return the pose by the images (h, w), uint8, exposed at ``t_s``; None for a missing image."""
        corners = [{} if image is None else self._find(image) for image in (left, right)]
        ids = self._chosen(corners)
        if len(ids) < 4:
            return PoseEstimate(t_s, "too_few")
        solver = self._solver(ids)
        spots, view_spots = np.full((2, MAX_LEDS), -1, np.int64), []
        for c in range(2):
            rows = np.zeros(0 if not corners[c] else sum(k in corners[c] for k in ids), SPOT)
            seen = [n for n, k in enumerate(ids) if k in corners[c]]
            for row, n in zip(rows, seen, strict=True):
                row["u"], row["v"] = corners[c][ids[n]]
                row["var_u"] = row["var_v"] = self._variance
            spots[c, seen] = np.arange(len(seen))
            view_spots.append(rows)
        view = solver.view(*view_spots)
        fits = [
            fit
            for r, t in self._starts(corners, ids)
            for fit in solver.from_start(view, r, t, spots)
            if (fit["spot"] == spots).all() and fit["t"][2] > 0.0 and fit["r"][2, 2] > 0.0
        ]
        if not fits:
            return PoseEstimate(t_s, "rejected_no_match")
        fits.sort(key=lambda fit: -float(fit["score"]))
        best = fits[0]
        if np.abs(best["shift"]).max() > _SHIFTED:
            return PoseEstimate(t_s, "rejected_sync")
        if not fits_within_budget(best):
            return PoseEstimate(t_s, "rejected_geometry_file")
        others = [fit for fit in fits[1:] if fit["score"] > best["score"] - _DECISIVE]
        if any(not np.allclose(fit["r"], best["r"], atol=1e-3) for fit in others) or not solver.is_linear(view, best):
            return PoseEstimate(t_s, "ambiguous")
        q_vt = quat.from_matrix(best["r"])
        return PoseEstimate(t_s, "ok", best["t"].copy(), q_vt, best["covariance"].copy(), best["noise"].copy())

    def _chosen(self, corners: list[Corners]) -> tuple[int, ...]:
        """Return corners that both images show, else of the better one: each the farthest from those before."""
        both = sorted(set(corners[0]) & set(corners[1]))
        ids = both if len(both) >= 4 else sorted(corners[0] if len(corners[0]) >= len(corners[1]) else corners[1])
        if len(ids) <= MAX_LEDS:
            return tuple(ids)
        places = self._points[ids]
        chosen = [int(np.argmax(np.linalg.norm(places - places.mean(axis=0), axis=1)))]
        while len(chosen) < MAX_LEDS:
            chosen.append(int(np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1).argmax()))
        return tuple(sorted(ids[k] for k in chosen))

    def _solver(self, ids: tuple[int, ...]) -> Solver:
        """Return the solver for the corners ``ids``; a few of them are kept."""
        if ids not in self._solvers:
            if len(self._solvers) >= _MOST_SOLVERS:
                self._solvers.clear()
            leds = tuple(map(tuple, self._points[list(ids)].tolist()))
            geometry = self._geometry.model_copy(update={"leds_m": leds, "calibration": None})
            self._solvers[ids] = Solver(geometry, SolverSettings())
        return self._solvers[ids]

    def _starts(self, corners: list[Corners], ids: tuple[int, ...]) -> list[tuple[Array, Array]]:
        """Return the two poses (r, t) of a flat target by the image that shows more corners."""
        side = 0 if len(corners[0]) >= len(corners[1]) else 1
        camera = (self._geometry.left, self._geometry.right)[side]
        seen = [k for k in ids if k in corners[side]]
        matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        pixels = np.array([corners[side][k] for k in seen])
        _, turns, shifts, _ = cv2.solvePnPGeneric(
            self._points[seen], pixels, matrix, np.array(camera.distortion), flags=cv2.SOLVEPNP_IPPE
        )
        starts = []
        for turn, shift in zip(turns, shifts, strict=True):
            r, t = np.asarray(cv2.Rodrigues(turn)[0], float), np.asarray(shift, float).ravel()
            if side == 1:
                back = np.asarray(cv2.Rodrigues(np.array(self._geometry.right_rotation_rad))[0], float)
                r, t = back @ r, back @ t + np.array(self._geometry.baseline_m)
            starts.append((np.ascontiguousarray(r), t))
        return starts


def apriltag(geometry: VmuGeometry, settings: Mapping[str, Any]) -> BoardEstimator:
    """Return the estimator of AprilTags. Raises BadInput."""
    chosen = _checked(AprilTagSettings, settings)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_APRILTAG_{chosen.family.upper()}"))
    square = 0.5 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    places = [np.array([x, y]) + side * square for _, side, x, y in chosen.tags]
    points = np.column_stack([np.concatenate(places), np.zeros(4 * len(places))])
    number = {tag[0]: 4 * k for k, tag in enumerate(chosen.tags)}
    cells = dictionary.markerSize + 2
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def find(image: np.ndarray) -> Corners:
        quads, ids, _ = detector.detectMarkers(image)
        named = zip(quads, [] if ids is None else map(int, ids.ravel()), strict=False)
        out: Corners = {}
        for quad, k in named:
            corners = refined(image, np.reshape(quad, (4, 2)).astype(float), cells) if k in number else None
            if corners is not None:
                out |= {number[k] + n: (float(u), float(v)) for n, (u, v) in enumerate(corners)}
        return out

    return BoardEstimator(geometry, points, find, chosen.corner_px, _tag_board(chosen, dictionary, points))


def refined(image: np.ndarray, corners: Array, cells: int) -> Array | None:
    """Return the corners (4, 2), px, of a dark square as the intersections of its edges.

    cells: of the tag along its side, the outer ones dark. At each of many places along an edge its position is the
    centre of the rise across it, whatever the levels and the blur, which draws a corner inwards by 0.2 px. None for a
    tag whose cells are too small.
    """
    levels = image.astype(np.float32)
    for _ in range(_ROUNDS):
        lines = []
        for a in range(4):
            start, along = corners[a], corners[(a + 1) % 4] - corners[a]
            length = float(np.linalg.norm(along))
            if length < _LEAST_CELL_PX * cells:
                return None
            normal = np.array([along[1], -along[0]]) / length
            if normal @ (start - corners.mean(axis=0)) < 0.0:
                normal = -normal
            at = np.linspace(0.12, 0.88, max(8, round(length)))
            across = np.linspace(-_REACH_PX, _REACH_PX, _ACROSS)
            places = (start + at[:, None] * along)[:, None] + across[None, :, None] * normal
            u, v = (places[..., i].astype(np.float32) for i in range(2))
            seen = cv2.remap(levels, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            rise = np.diff(seen, axis=1)
            step = rise.sum(axis=1)
            good = step > 0.5 * float(np.median(step))
            if good.sum() < 4 or not float(np.median(step)) > 0.0:
                return None
            offset = rise[good] @ (0.5 * (across[1:] + across[:-1])) / step[good]
            degree = 2 if length > _CURVED_PX else 1  # a lens with distortion bends long edges
            curve = np.polynomial.Polynomial.fit(at[good], offset, degree, domain=(0.0, 1.0), window=(0.0, 1.0))
            slope = curve.deriv()
            lines.append([(start + x * along + curve(x) * normal, along + slope(x) * normal) for x in (0.0, 1.0)])
        crossings = []
        for a in range(4):
            (p, d), (q, e) = lines[a - 1][1], lines[a][0]
            crossings.append(p + np.linalg.solve(np.column_stack([d, -e]), q - p)[0] * d)
        corners = np.array(crossings)
    return corners


def charuco(geometry: VmuGeometry, settings: Mapping[str, Any]) -> BoardEstimator:
    """Return the estimator of a ChArUco board. Raises BadInput."""
    chosen = _checked(CharucoSettings, settings)
    if chosen.marker_m >= chosen.square_m:
        text = f"{chosen.marker_m:g}: must be below square_m, {chosen.square_m:g}"
        raise BadInput.single("rig", "vmu.estimator_settings.marker_m", text)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{chosen.dictionary}"))
    board = cv2.aruco.CharucoBoard((chosen.columns, chosen.rows), chosen.square_m, chosen.marker_m, dictionary)
    width, height = chosen.columns * chosen.square_m, chosen.rows * chosen.square_m
    points = np.array(board.getChessboardCorners(), float) - [0.5 * width, 0.5 * height, 0.0]
    detector = cv2.aruco.CharucoDetector(board)

    def find(image: np.ndarray) -> Corners:
        corners, ids, _, _ = detector.detectBoard(image)
        named = zip([] if ids is None else map(int, ids.ravel()), [] if corners is None else corners, strict=False)
        return {k: (float(np.ravel(corner)[0]), float(np.ravel(corner)[1])) for k, corner in named}

    side, margin = _PICTURE_PX // max(chosen.columns, chosen.rows), _PICTURE_PX // 20
    picture = np.asarray(board.generateImage((chosen.columns * side, chosen.rows * side), marginSize=0))
    framed = cv2.copyMakeBorder(picture, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
    frame_m = 2.0 * margin * chosen.square_m / side
    target = FlatTarget(framed, width + frame_m, height + frame_m)
    return BoardEstimator(geometry, points, find, chosen.corner_px, target)


def _tag_board(settings: AprilTagSettings, dictionary: Any, points: Array) -> FlatTarget:
    """Return the printed target of the tags, each with a white margin."""
    sides = np.array([tag[1] for tag in settings.tags])
    half = np.abs(points[:, :2]).max(axis=0) + 0.25 * float(sides.max())
    per_m = _PICTURE_PX / (2.0 * float(half.max()))
    size = [math.ceil(2.0 * float(x) * per_m) for x in half]
    picture: np.ndarray = np.full((size[1], size[0]), 255, np.uint8)
    middle = 0.5 * np.array(size)
    for number, side, x, y in settings.tags:
        marker = dictionary.generateImageMarker(number, _MARKER_PX)
        scale = side * per_m / _MARKER_PX
        first = (
            middle + per_m * (np.array([x, y]) - 0.5 * side) - 0.5 + 0.5 * scale
        )  # centre of the marker's first pixel
        to_picture = np.array([[scale, 0.0, first[0]], [0.0, scale, first[1]]])
        cv2.warpAffine(marker, to_picture, tuple(size), dst=picture, borderMode=cv2.BORDER_TRANSPARENT)
    return FlatTarget(picture, size[0] / per_m, size[1] / per_m)


def _checked(model: type[_Settings], settings: Mapping[str, Any]) -> _Settings:
    try:
        return model.model_validate(dict(settings), strict=False)
    except ValidationError as error:
        keys = [".".join(["vmu.estimator_settings", *map(str, each["loc"])]) for each in error.errors()]
        texts = [f"{each['input']}: {each['msg']}" for each in error.errors()]
        raise BadInput([Problem("rig", key, text) for key, text in zip(keys, texts, strict=True)]) from error
