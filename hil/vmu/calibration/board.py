"""Chessboards and ChArUco boards: detection of their corners, and initial values of a calibration (OpenCV)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import euler, quat
from hil.vmu.calibration.hand_eye import hand_eye
from hil.vmu.calibration.model import PARTS, SIDES, Observations, Setup, TurntableModel
from hil.vmu.calibration.views import Views, read_pair
from hil.vmu.kernels.chain import (
    BASELINE,
    CAMERA_POSITION,
    CAMERA_ROTATION,
    ROTATION,
    SCALE,
    TARGET_POSITION,
    TARGET_ROTATION,
)
from hil.vmu.prints import CharucoSettings

CORNER_SIGMA_PX = 0.1
"""initial value; the fit estimates the noise of the corners"""
LEAST_VIEWS = 4
LEAST_CORNERS: Final = 8
"""of a board in an image, to be used"""
_WINDOW = 0.35  # half the side of the window around a corner, relative to the distance to the next one
_FARTHEST_PX = 0.5
_UNTIL = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-4)


@dataclass(frozen=True)
class Board:
    """columns, rows: inner corners along the longer and the other side. square_m: side of a square.

    marker_m, dictionary: of the markers of a ChArUco board, which may be in part outside of an image.
    """

    columns: int
    rows: int
    square_m: float
    marker_m: float = 0.0
    dictionary: str = ""

    @cached_property
    def _detectors(self) -> tuple[Any, ...]:
        """OpenCV's detectors of the ways in which a ChArUco board may be printed; none of a chessboard."""
        if not self.dictionary:
            return ()
        chosen = CharucoSettings(
            dictionary=self.dictionary, columns=self.columns + 1, rows=self.rows + 1, square_m=self.square_m,
            marker_m=self.marker_m,
        )  # fmt: skip
        return tuple(cv2.aruco.CharucoDetector(chosen.layout(way)) for way in chosen.ways)

    @property
    def is_coded(self) -> bool:
        """Whether each corner is known by itself."""
        return bool(self.dictionary)

    def points(self) -> Array:
        """Return the corners in the board's axes, (columns rows, 3), m: origin at the middle, x along a row."""
        x, y = np.meshgrid(np.arange(self.columns), np.arange(self.rows))
        flat = np.stack([x.ravel() - (self.columns - 1) / 2, y.ravel() - (self.rows - 1) / 2, 0.0 * x.ravel()], axis=1)
        return np.ascontiguousarray(flat * self.square_m)


def find_corners(image: np.ndarray, board: Board) -> Array | None:
    """Return the corners, (columns rows, 2), px, or None. The end of a chessboard at which they start is arbitrary.

    Corners of a ChArUco board that are not in the image are NaN.
    """
    if board.is_coded:
        return _charuco_corners(image, board)
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY
    complete, corners = cv2.findChessboardCornersSB(image, (board.columns, board.rows), flags=flags)
    if not complete:
        return None
    # these corners have a common error of up to 0.1 px per view, unlike the saddle points themselves
    return _refined(image, np.asarray(corners, dtype=float).reshape(-1, 2), board)


def _charuco_corners(image: np.ndarray, board: Board) -> Array | None:
    """Return the corners of a ChArUco board, printed whichever way shows more of them; None if they are too few."""
    best: Array | None = None
    for detector in board._detectors:
        corners, ids, _, _ = detector.detectBoard(image)
        if ids is not None and len(ids) > (LEAST_CORNERS - 1 if best is None else np.isfinite(best[:, 0]).sum()):
            best = np.full((board.columns * board.rows, 2), np.nan)
            best[np.asarray(ids).ravel()] = np.asarray(corners, dtype=float).reshape(-1, 2)
    if best is None:
        return None
    grid = np.argwhere(np.isfinite(best[:, 0]).reshape(board.rows, board.columns))
    if np.ptp(grid, axis=0).min() < 1:  # of one row
        return None
    return _refined(image, best, board)


def _refined(image: np.ndarray, corners: Array, board: Board) -> Array:
    """Return the saddle points next to ``corners`` (columns rows, 2), px."""
    grid = corners.reshape(board.rows, board.columns, 2)
    apart = float(np.nanmin([np.nanmin(np.linalg.norm(np.diff(grid, axis=k), axis=2)) for k in range(2)]))
    window = min(_WINDOW, 0.45 * (1.0 - board.marker_m / board.square_m)) if board.is_coded else _WINDOW  # no marker
    half = int(np.clip(window * apart, 2, 11))
    seen = np.isfinite(corners[:, 0])
    start = corners[seen].astype(np.float32).reshape(-1, 1, 2)
    saddles = np.asarray(cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), _UNTIL), float).reshape(-1, 2)
    # a corner that moves far has met the board's edge or a speck
    near = np.linalg.norm(saddles - corners[seen], axis=1, keepdims=True) < _FARTHEST_PX
    refined = corners.copy()
    refined[seen] = np.where(near, saddles, corners[seen])
    return refined


def observations(views: Views, board: Board, progress: Callable[[str, float], None]) -> tuple[Observations, Array]:
    """Return the corners of all views that show the board to a camera, and the images' sizes (2, 2).

    Raises BadInput if too few show it to both.
    """
    sizes: Array | None = None
    m = board.columns * board.rows
    pixels = np.full((len(views.names), 2, m, 2), np.nan)
    for k, name in enumerate(views.names):
        progress(f"corners of view {name}", k / len(views.names))
        pair = read_pair(views, k, sizes)
        if sizes is None:
            sizes = np.array([image.shape[::-1] for image in pair], dtype=float)
        for side, image in enumerate(pair):
            corners = find_corners(image, board)
            if corners is not None:
                pixels[k, side] = corners
        if not board.is_coded:
            _same_end_first(pixels[k])
    covariance = np.broadcast_to(CORNER_SIGMA_PX**2 * np.eye(2), (*pixels.shape, 2)).copy()
    observed = Observations(views.names, views.axes, pixels, covariance)
    both = int((_in_both(observed) >= LEAST_CORNERS).sum())
    if sizes is None or both < LEAST_VIEWS:
        text = f"{both} of {len(views.names)} views show a board of {board.columns}x{board.rows} inner corners"
        raise BadInput.single("--board", "", f"{text} to both cameras, {LEAST_VIEWS} are needed")
    return observed.only(np.flatnonzero(observed.visible.any(axis=(1, 2)))), sizes


def _in_both(observed: Observations) -> np.ndarray:
    """Return how many corners both cameras show in each view, (n,)."""
    return np.asarray(observed.visible.all(axis=1).sum(axis=1))


def one_sided(observed: Observations) -> dict[str, str]:
    """Return the views of which one camera alone shows the board, by its name."""
    shown = np.asarray(observed.visible.any(axis=2))
    return {name: SIDES[int(sides[1])] for name, sides in zip(observed.names, shown, strict=True) if not sides.all()}


def _same_end_first(pixels: Array) -> None:
    """Reverse the right image's corners, in place, if they start at the other end of the board."""
    along = pixels[:, -1] - pixels[:, 0]
    if float(along[0] @ along[1]) < 0.0:
        pixels[1] = pixels[1, ::-1]


def _matrix(numbers: Array) -> Array:
    return np.array([[numbers[0], 0.0, numbers[2]], [0.0, numbers[1], numbers[3]], [0.0, 0.0, 1.0]])


def _intrinsics(observed: Observations, points: Array, side: int, size: Array, guess: Array | None) -> Array:
    """Return the nine numbers of one camera from its own views of the board (Zhang's method, then all parameters)."""
    seen = observed.visible[:, side]
    views = np.flatnonzero(seen.any(axis=1))
    objects = [points[seen[k]].astype(np.float32) for k in views]
    images = [observed.pixels[k, side][seen[k]].astype(np.float32) for k in views]
    flags = cv2.CALIB_FIX_K3
    matrix: np.ndarray = np.eye(3)
    lens: np.ndarray = np.zeros(5)
    if guess is not None:
        flags |= cv2.CALIB_USE_INTRINSIC_GUESS
        matrix, lens = _matrix(guess), guess[4:].copy()
    shape = (int(size[0]), int(size[1]))
    try:
        _, matrix, lens, *_ = cv2.calibrateCamera(objects, images, shape, matrix, lens, flags=flags)
    except cv2.error as error:
        raise BadInput.single("VIEWS", SIDES[side], "the views do not determine this camera; tilt the board") from error
    lens = np.asarray(lens, dtype=float).ravel()
    return np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens[:5]])


def board_pose(points: Array, pixels: Array, numbers: Array) -> tuple[Array, Array]:
    """Return R (3, 3) and t (3,), m, of ``p_camera = R p_board + t`` by the corners in one camera, NaN if not seen."""
    seen = np.isfinite(pixels[:, 0])
    points, pixels = np.ascontiguousarray(points[seen]), np.ascontiguousarray(pixels[seen])
    _, rotation, position = cv2.solvePnP(points, pixels, _matrix(numbers), numbers[4:], flags=cv2.SOLVEPNP_IPPE)
    rotation, position = cv2.solvePnPRefineLM(points, pixels, _matrix(numbers), numbers[4:], rotation, position)
    return Rotation.from_rotvec(np.asarray(rotation, dtype=float).ravel()).as_matrix(), np.asarray(
        position, dtype=float
    ).ravel()


def _stereo(
    observed: Observations, points: Array, left: Array, right: Array, size: Array
) -> tuple[Array, Array, np.ndarray]:
    """Return rotation vector and baseline of the right camera, and the views with consistent pairs."""
    poses = [
        (k, board_pose(points, observed.pixels[k, 0], left), board_pose(points, observed.pixels[k, 1], right))
        for k in np.flatnonzero(_in_both(observed) >= LEAST_CORNERS)
    ]
    # all pairs must have the same relative pose: p_v = R p_r + b
    rotations = np.array([a[0] @ b[0].T for _, a, b in poses])
    positions = np.array([a[1] - a[0] @ b[0].T @ b[1] for _, a, b in poses])
    apart = np.array([Rotation.from_matrix(rotations @ rotation.T).magnitude() for rotation in rotations])
    between = np.linalg.norm(positions[:, None] - positions[None], axis=2)
    middle = int(np.argmin(np.median(apart, axis=1) / 1e-3 + np.median(between, axis=1) / 1e-2))
    angle_far, far = 5.0 * max(np.median(apart[middle]), 1e-3), 5.0 * max(np.median(between[middle]), 1e-3)
    agree = [
        k for k, (a, d) in enumerate(zip(apart[middle], between[middle], strict=True)) if a < angle_far and d < far
    ]
    chosen = [poses[k][0] for k in agree]
    common = [observed.visible[k].all(axis=0) for k in chosen]
    objects = [points[seen].astype(np.float32) for seen in common]
    if len(chosen) < LEAST_VIEWS:
        text = f"left and right image are consistent in {len(chosen)} views, {LEAST_VIEWS} are required"
        raise BadInput.single("VIEWS", "", text)
    lefts, rights = (
        [observed.pixels[k, side][seen].astype(np.float32) for k, seen in zip(chosen, common, strict=True)]
        for side in range(2)
    )
    eye, zero = np.eye(3), np.zeros(3)  # initial values, not used with these flags
    shape = (int(size[0]), int(size[1]))
    cameras = (_matrix(left), left[4:], _matrix(right), right[4:])
    fixed = cv2.CALIB_FIX_INTRINSIC
    stereo = cv2.stereoCalibrate(objects, lefts, rights, *cameras, shape, eye, zero, flags=fixed)
    # OpenCV: p_r = R p_v + T
    rotation, position = np.asarray(stereo[5], dtype=float), np.asarray(stereo[6], dtype=float).ravel()
    return (
        Rotation.from_matrix(rotation.T).as_rotvec(),
        np.asarray(-rotation.T @ position, dtype=float),
        np.array(chosen),
    )


def start_cameras(
    observed: Observations, nominal: Setup, keep: tuple[str, ...], guess: bool
) -> tuple[Array, np.ndarray]:
    """Return the numbers of both cameras and of their relative pose, and the views that agree with them.

    keep, guess: as in ``start``. A view that one camera alone shows agrees.
    """
    theta = nominal.theta[:CAMERA_ROTATION].copy()
    for side, part in enumerate(SIDES):
        if part not in keep:
            old = theta[PARTS[part]] if guess else None
            theta[PARTS[part]] = _intrinsics(observed, nominal.points, side, nominal.sizes[side], old)
    left, right = theta[PARTS["left"]], theta[PARTS["right"]]
    rotation, baseline, agree = _stereo(observed, nominal.points, left, right, nominal.sizes[0])
    if "stereo" not in keep:
        theta[ROTATION:BASELINE], theta[BASELINE:] = rotation, baseline
    alone = np.flatnonzero(_in_both(observed) < LEAST_CORNERS)
    return theta, np.sort(np.concatenate([agree, alone]))


def pose_in_left(observed: Observations, view: int, points: Array, theta: Array) -> tuple[Array, Array]:
    """Return R and t, m, of ``p_v = R p_board + t`` in a view, by the left camera, or by the right one alone."""
    if observed.visible[view, 0].any():
        return board_pose(points, observed.pixels[view, 0], theta[PARTS["left"]])
    turn, place = board_pose(points, observed.pixels[view, 1], theta[PARTS["right"]])
    back = Rotation.from_rotvec(theta[ROTATION:BASELINE]).as_matrix()
    return back @ turn, back @ place + theta[BASELINE:CAMERA_ROTATION]


def start(
    observed: Observations, board: Board, nominal: Setup, turntable: TurntableModel, keep: tuple[str, ...], guess: bool
) -> tuple[Setup, Observations, tuple[str, ...]]:
    """Return initial cameras, mounting and board from OpenCV and the hand-eye calibration.

    Also the observations with the ends of the board resolved, and the names of inconsistent views.
    guess: start the cameras at ``nominal``, whose points are the board's.
    """
    theta = nominal.theta.copy()
    theta[:CAMERA_ROTATION], agree = start_cameras(observed, nominal, keep, guess)
    poses = [pose_in_left(observed, k, nominal.points, theta) for k in agree]
    gimbals = np.array(
        [
            quat.to_matrix(euler.to_quaternion(np.ascontiguousarray(observed.axes[k, 3:]), turntable.order))
            for k in agree
        ]
    )
    rotations, flipped = np.array([pose[0] for pose in poses]), np.zeros(len(poses), dtype=bool)
    if not board.is_coded:
        rotations, flipped = _resolve_ends(rotations, gimbals)
    pixels = observed.pixels.copy()
    for k in agree[flipped]:
        pixels[k] = pixels[k, :, ::-1]
    positions = np.array([pose[1] for pose in poses])
    arm = turntable.lever_arm + theta[CAMERA_POSITION:TARGET_ROTATION]
    fit = hand_eye(rotations, positions, gimbals, observed.axes[agree, :3], nominal.camera_axes, arm)
    camera_axes = fit.camera_axes
    if "mounting" in keep:
        camera_axes = nominal.camera_axes
    else:
        theta[CAMERA_POSITION:TARGET_ROTATION] = fit.arm - turntable.lever_arm
    theta[TARGET_POSITION:SCALE] = fit.position
    begun = replace(nominal, theta=theta, camera_axes=camera_axes, target_axes=np.ascontiguousarray(fit.target_axes))
    good = set(agree[fit.good])
    bad = tuple(name for k, name in enumerate(observed.names) if k not in good)
    return begun, replace(observed, pixels=pixels), bad


def _resolve_ends(rotations: Array, gimbals: Array) -> tuple[Array, Array]:
    """Return the rotations, corrected by 180 deg for boards that were read from the other end, and which those are.

    The rotation between two views has the angle by which the turntable rotated.
    """
    half = np.diag([-1.0, -1.0, 1.0])
    tries = []
    for rotation, gimbal in zip(rotations, gimbals, strict=True):  # relative to each view, as one may be wrong
        made = Rotation.from_matrix(gimbals @ gimbal.T).magnitude()
        as_read = np.abs(Rotation.from_matrix(rotations @ rotation.T).magnitude() - made)
        turned = np.abs(Rotation.from_matrix(rotations @ half @ rotation.T).magnitude() - made)
        tries.append((float(np.sum(np.minimum(as_read, turned))), turned < as_read))
    flipped = min(tries, key=lambda attempt: attempt[0])[1]
    return np.where(flipped[:, None, None], rotations @ half, rotations), flipped
