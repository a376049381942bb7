"""Pose estimators of printed targets, AprilTags and ChArUco boards: corners by OpenCV, pose within the error budget."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import cv2
import numpy as np

from hil.config.vmu_geometry import LEGACY, OFFICIAL, OPENCV, VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import quat
from hil.vmu.estimators import GEOMETRY, PRINT, FlatTarget, PoseEstimate
from hil.vmu.geometry import camera_pair
from hil.vmu.kernels.records import MAX_LEDS, SPOT
from hil.vmu.pose import Solver, SolverSettings, fits_within_budget
from hil.vmu.prints import AprilTagSettings, CharucoSettings, checked, ways_of

Corners = dict[int, tuple[float, float]]
Reader = Callable[[Any], Corners]

TOO_FEW: Final = "too_few"
NO_MATCH: Final = "rejected_no_match"
_OK: Final = "ok"
_AMBIGUOUS: Final = "ambiguous"
_SHIFTED: Final = 4.5  # sigmas between the two images
_DECISIVE: Final = 8.0  # of the score, by which one of the two tilts of a flat target is better
_AWAY, _AWAY_PX = 5.5, 1.0  # sigmas and pixels by which a corner contradicts a pose
_REACH_PX, _REACH_CELLS, _ACROSS = 2.0, 0.5, 17  # on both sides of an edge, at most, and samples across it
_LEAST_CELL_PX: Final = 3.0
_ROUNDS: Final = 4
_CURVED_PX: Final = 80.0
_MOST_SOLVERS: Final = 64
_TAG: Final = 4  # corners


class BoardEstimator:
    """Pose of a target with known corners, from both images. Up to MAX_LEDS of them are used, those far apart.

    points_t: (n, 3), m, corners in t. detect: what a reader needs of an image. readers: corners by number, px, for each
    way in which the target may be printed; others: for the ways that the geometry file excludes. corner_px: error of a
    corner, 1 sigma.
    """

    def __init__(
        self,
        geometry: VmuGeometry,
        points_t: Array,
        detect: Callable[[np.ndarray], Any],
        readers: Sequence[Reader],
        others: Sequence[Reader],
        corner_px: float,
        board: FlatTarget,
    ) -> None:
        self.board = board
        self._geometry, self._points, self._variance = geometry, points_t, corner_px**2
        self._detect, self._readers, self._others = detect, readers, others
        self._pair = camera_pair(geometry)
        self._solvers: dict[tuple[int, ...], Solver] = {}

    def warm_up(self) -> None:
        """Compile the kernels and load OpenCV's detector by one pair that shows the target."""
        cameras = (self._geometry.left, self._geometry.right)
        left, right = (cv2.resize(self.board.image, (camera.width, camera.height)) for camera in cameras)
        self.solve(left, right, 0.0)

    def solve(self, left: np.ndarray | None, right: np.ndarray | None, t_s: float) -> PoseEstimate:
        """Return the pose by the images (h, w), uint8, exposed at ``t_s``; None for a missing image.

        ``rejected_print``: the tags in view fit several ways to print them, or not the stated one but another.
        """
        detected = [None if image is None else self._detect(image) for image in (left, right)]
        results = self._results(detected, self._readers, t_s)
        if len(results) == 1:
            is_doubtful = results[0].status in (NO_MATCH, TOO_FEW)
            others = self._results(detected, self._others, t_s) if is_doubtful else []
            return PoseEstimate(t_s, PRINT) if any(other.status == _OK for other in others) else results[0]
        possible = [result for result in results if result.status in (_OK, _AMBIGUOUS)]
        if len(possible) == 1 and not _is_single_tag(detected):
            return possible[0]
        rest = [result for result in results if result.status not in (NO_MATCH, TOO_FEW)]
        return PoseEstimate(t_s, PRINT) if possible else (rest or results)[0]

    def _results(self, detected: Sequence[Any], readers: Sequence[Reader], t_s: float) -> list[PoseEstimate]:
        return [self._solve([{} if image is None else read(image) for image in detected], t_s) for read in readers]

    def _solve(self, corners: list[Corners], t_s: float) -> PoseEstimate:
        """Return the pose by the corners of both images, with all of which it agrees."""
        ids = self._chosen(corners)
        if len(ids) < _TAG:
            return PoseEstimate(t_s, TOO_FEW)
        if not all(np.isfinite(list(each.values())).all() for each in corners):
            return PoseEstimate(t_s, NO_MATCH)
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
            return PoseEstimate(t_s, NO_MATCH)
        fits.sort(key=lambda fit: -float(fit["score"]))
        best = fits[0]
        if np.abs(best["shift"]).max() > _SHIFTED:
            return PoseEstimate(t_s, "rejected_sync")
        if not fits_within_budget(best):
            return PoseEstimate(t_s, "rejected_geometry_file")
        others = [fit for fit in fits[1:] if fit["score"] > best["score"] - _DECISIVE]
        if any(not np.allclose(fit["r"], best["r"], atol=1e-3) for fit in others) or not solver.is_linear(view, best):
            return PoseEstimate(t_s, _AMBIGUOUS)
        if any(self._contradicts(c, corners[c], best) for c in range(2)):
            return PoseEstimate(t_s, NO_MATCH)
        q_vt = quat.from_matrix(best["r"])
        return PoseEstimate(t_s, _OK, best["t"].copy(), q_vt, best["covariance"].copy(), best["noise"].copy())

    def _contradicts(self, camera: int, corners: Corners, fit: np.void) -> bool:
        """Return whether a corner in the image of ``camera``, used or not, is not where the pose ``fit`` has it."""
        if not corners:
            return False
        lens, to_camera = self._pair.lens[camera], self._pair.rotation[camera]
        arms = self._points[list(corners)] @ fit["r"].T
        at = (arms + fit["t"]) @ to_camera.T + self._pair.translation[camera]
        if not (at[:, 2] > 0.0).all():
            return True
        matrix = np.array([[lens["fx"], 0.0, lens["cx"]], [0.0, lens["fy"], lens["cy"]], [0.0, 0.0, 1.0]])
        bent = np.array([lens[name] for name in ("k1", "k2", "p1", "p2", "k3")])
        expected = cv2.projectPoints(at, np.zeros(3), np.zeros(3), matrix, bent)[0].reshape(-1, 2)
        slopes = np.zeros((len(at), 2, 3))
        slopes[:, 0, 0], slopes[:, 1, 1] = lens["fx"] / at[:, 2], lens["fy"] / at[:, 2]
        slopes[:, :, 2] = -np.array([lens["fx"], lens["fy"]]) * at[:, :2] / at[:, 2:] ** 2
        by_turn = -np.cross(np.eye(3), arms[:, None])  # of e x arm, by e
        motion = np.concatenate([np.broadcast_to(np.eye(3), by_turn.shape), by_turn.transpose(0, 2, 1)], axis=2)
        jacobian = slopes @ to_camera @ motion
        spread = jacobian @ fit["covariance"] @ jacobian.transpose(0, 2, 1) + self._variance * np.eye(2)
        away = np.array(list(corners.values())) - expected
        squares = (away * np.linalg.solve(spread, away[..., None])[..., 0]).sum(axis=1)
        return bool(((squares > _AWAY**2) & (np.abs(away).max(axis=1) > _AWAY_PX)).any())

    def _chosen(self, corners: list[Corners]) -> tuple[int, ...]:
        """Return the corners, of too many those that both images show: each the farthest from those before."""
        either, both = (sorted(ids) for ids in (set(corners[0]) | set(corners[1]), set(corners[0]) & set(corners[1])))
        if len(either) <= MAX_LEDS:
            return tuple(either)
        ids = both if len(both) >= MAX_LEDS else either
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
        seen_by = [[k for k in ids if k in image] for image in corners]
        side = 0 if len(seen_by[0]) >= len(seen_by[1]) else 1
        camera, seen = (self._geometry.left, self._geometry.right)[side], seen_by[side]
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
    chosen = checked(AprilTagSettings, settings)
    ways = ways_of(geometry, (OFFICIAL, OPENCV), (OFFICIAL, OPENCV))
    if len(ways) > 1 and len(chosen.tags) == 1:
        text = 'is missing: a single tag has one pose for print = "official", as by the AprilTag library and '
        raise BadInput.single(GEOMETRY, "print", f'{text}hil targets print, and another one for "opencv"')
    number = {tag[0]: _TAG * k for k, tag in enumerate(chosen.tags)}
    dictionary = chosen.dictionary()
    cells = dictionary.markerSize + 2
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_CONTOUR
    detector = cv2.aruco.ArucoDetector(dictionary, parameters)

    def detect(image: np.ndarray) -> dict[int, Array]:
        """Return the corners (4, 2) of each tag, in OpenCV's order; nan for a tag that is in the image twice."""
        quads, ids, _ = detector.detectMarkers(image)
        detected: dict[int, Array] = {}
        for quad, k in zip(quads, [] if ids is None else map(int, ids.ravel()), strict=False):
            corners = refined(image, np.reshape(quad, (4, 2)).astype(float), cells) if k in number else None
            if corners is not None:
                detected[number[k]] = np.full((4, 2), np.nan) if number[k] in detected else corners
        return detected

    def reader(shift: int) -> Callable[[dict[int, Array]], Corners]:
        return lambda detected: {
            first + (n + shift) % _TAG: (float(u), float(v))
            for first, corners in detected.items()
            for n, (u, v) in enumerate(corners)
        }

    readers = [reader(chosen.shift(way)) for way in ways]
    others = [reader(chosen.shift(way)) for way in (OFFICIAL, OPENCV) if way not in ways]
    return BoardEstimator(geometry, chosen.corners(), detect, readers, others, chosen.corner_px, chosen.board(ways[0]))


def _is_single_tag(detected: Sequence[Any]) -> bool:
    """Return whether both images together show one tag only, which leaves open how it is printed."""
    tags = [set(image) for image in detected if isinstance(image, dict)]
    return len(set().union(*tags)) == 1


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
            start, along, beside = corners[a], corners[(a + 1) % 4] - corners[a], corners[a - 1] - corners[a]
            length = max(float(np.linalg.norm(along)), 1e-9)
            normal = np.array([along[1], -along[0]]) / length
            cell = abs(float(normal @ beside)) / cells
            if not cell >= _LEAST_CELL_PX:
                return None
            if normal @ (start - corners.mean(axis=0)) < 0.0:
                normal = -normal
            at = np.linspace(0.12, 0.88, max(8, round(length)))
            reach = min(_REACH_PX, _REACH_CELLS * cell)  # not into the cells behind
            across = np.linspace(-reach, reach, _ACROSS)
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
    chosen = checked(CharucoSettings, settings)
    ways = ways_of(geometry, chosen.ways, (OPENCV, LEGACY))

    def reader(way: str) -> Callable[[np.ndarray], Corners]:
        detector = cv2.aruco.CharucoDetector(chosen.layout(way))

        def read(image: np.ndarray) -> Corners:
            corners, ids, _, _ = detector.detectBoard(image)
            named = zip([] if ids is None else map(int, ids.ravel()), [] if corners is None else corners, strict=False)
            return {k: (float(np.ravel(corner)[0]), float(np.ravel(corner)[1])) for k, corner in named}

        return read

    readers = [reader(way) for way in ways]
    others = [reader(way) for way in chosen.ways if len(chosen.ways) > 1 and way not in ways]
    return BoardEstimator(
        geometry, chosen.corners(), lambda image: image, readers, others, chosen.corner_px, chosen.board(ways[0])
    )
