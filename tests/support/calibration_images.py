"""Rendered images of a chessboard or of LEDs in known cameras, and a folder of views from them."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.maths import euler, quat
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.model import Setup, TurntableModel
from hil.vmu.calibration.views import COLUMNS
from hil.vmu.kernels import chain
from hil.vmu.kernels.chain import BASELINE, CAMERA_POSITION, CAMERA_ROTATION, ROTATION, TARGET_POSITION
from hil.vmu.kernels.lens import LENS, CameraPair
from hil.vmu.render import Extras, RingAppearance, RingRenderer

_LIGHT, _DARK, _AROUND = 200.0, 30.0, 90.0
_FINE = 3  # rays along each side of a pixel


def camera_pair_of(setup: Setup) -> CameraPair:
    """Return the two cameras of ``setup``."""
    lenses = np.zeros(2, LENS)
    for side in range(2):
        chain.fill_lens(lenses[side], setup.theta, 9 * side)
        lenses[side]["width"], lenses[side]["height"] = setup.sizes[side]
    to_right = Rotation.from_rotvec(setup.theta[ROTATION:BASELINE]).as_matrix().T
    rotation = np.stack([np.eye(3), to_right])
    translation = np.stack([np.zeros(3), -to_right @ setup.theta[BASELINE:CAMERA_ROTATION]])
    return CameraPair(lenses, rotation, translation)


def pose(setup: Setup, turntable: TurntableModel, axes: Array) -> tuple[Array, Array]:
    """Return R (3, 3) and t_v (3,), m, of ``p_v = R p_t + t_v`` with the bench's axes at ``axes`` (6,)."""
    a_ch = quat.to_matrix(euler.to_quaternion(np.ascontiguousarray(axes[3:]), turntable.order))
    arm = turntable.lever_arm + setup.theta[CAMERA_POSITION : CAMERA_POSITION + 3]
    station = setup.theta[TARGET_POSITION : TARGET_POSITION + 3]
    t_v: Array = setup.camera_axes @ (a_ch @ (station - axes[:3]) - arm)
    return setup.camera_axes @ a_ch @ setup.target_axes, t_v


def board_pair(
    setup: Setup,
    turntable: TurntableModel,
    axes: Array,
    board: Board,
    noise_levels: float,
    generator: np.random.Generator,
) -> list[np.ndarray]:
    """Return left and right image of the board, 8 bit: each pixel is the mean of 3 x 3 rays, blurred by 0.7 px."""
    turn, t_v = pose(setup, turntable, axes)
    pair = camera_pair_of(setup)
    images = []
    for side in range(2):
        turned, place = pair.rotation[side] @ turn, pair.rotation[side] @ t_v + pair.translation[side]
        image = board_image(setup.theta[9 * side : 9 * side + 9], setup.sizes[side], turned, place, board)
        image = cv2.GaussianBlur(image, (0, 0), 0.7) + noise_levels * generator.standard_normal(image.shape)
        images.append(np.clip(np.rint(image), 0, 255).astype(np.uint8))
    return images


def board_image(numbers: Array, size: Array, turn: Array, place: Array, board: Board) -> np.ndarray:
    width, height = int(size[0]), int(size[1])
    image = np.full((height, width), _AROUND)
    x0, y0, x1, y1 = _box(numbers, turn, place, board, width, height)
    if x1 <= x0 or y1 <= y0:
        return image
    steps = (np.arange(_FINE) + 0.5) / _FINE - 0.5
    u = (np.arange(x0, x1)[:, None] + steps).ravel()
    v = (np.arange(y0, y1)[:, None] + steps).ravel()
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    matrix = np.array([[numbers[0], 0.0, numbers[2]], [0.0, numbers[1], numbers[3]], [0.0, 0.0, 1.0]])
    ideal = cv2.undistortPoints(pixels, matrix, numbers[4:])[:, 0]
    rays = np.column_stack([ideal, np.ones(len(ideal))])
    reach = float(turn[:, 2] @ place) / (rays @ turn[:, 2])
    on_board = (rays * reach[:, None] - place) @ turn[:, :2]
    level = _level(on_board, board)
    fine = level.reshape(y1 - y0, _FINE, x1 - x0, _FINE)
    image[y0:y1, x0:x1] = fine.mean(axis=(1, 3))
    return image


def _level(on_board: Array, board: Board) -> Array:
    """Return the grey level at points on the board, (n, 2), m; a white margin of one square around it."""
    column = np.floor(on_board[:, 0] / board.square_m + 0.5 * (board.columns + 1))
    row = np.floor(on_board[:, 1] / board.square_m + 0.5 * (board.rows + 1))
    inside = (column >= 0) & (column <= board.columns) & (row >= 0) & (row <= board.rows)
    margin = (column >= -1) & (column <= board.columns + 1) & (row >= -1) & (row <= board.rows + 1)
    dark = (column + row) % 2 == 0
    out: Array = np.where(inside & dark, _DARK, np.where(margin, _LIGHT, _AROUND))
    return out


def _box(numbers: Array, turn: Array, place: Array, board: Board, width: int, height: int) -> tuple[int, ...]:
    across, down = 0.5 * (board.columns + 3.2) * board.square_m, 0.5 * (board.rows + 3.2) * board.square_m
    edge = np.linspace(-1.0, 1.0, 9)
    rim = [(across * e, down * s, 0.0) for e in edge for s in (-1, 1)] + [
        (across * s, down * e, 0.0) for e in edge for s in (-1, 1)
    ]
    points = np.array(rim) @ turn.T + place
    matrix = np.array([[numbers[0], 0.0, numbers[2]], [0.0, numbers[1], numbers[3]], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, numbers[4:])
    low, high = pixels[:, 0].min(axis=0), pixels[:, 0].max(axis=0)
    x0, y0 = max(int(low[0]) - 1, 0), max(int(low[1]) - 1, 0)
    return x0, y0, min(int(high[0]) + 3, width), min(int(high[1]) + 3, height)


def led_pair(
    renderer: RingRenderer,
    setup: Setup,
    turntable: TurntableModel,
    axes: Array,
    extras: Extras,
    generator: np.random.Generator,
) -> list[np.ndarray]:
    """Return left and right image of the LEDs."""
    turn, t_v = pose(setup, turntable, axes)
    return list(renderer.pair(t_v, quat.from_matrix(np.ascontiguousarray(turn)), None, generator, extras))


def led_renderer(setup: Setup) -> RingRenderer:
    """Return the renderer of the LEDs of ``setup``."""
    return RingRenderer(camera_pair_of(setup), setup.points, RingAppearance())


def write_views(folder: Path, axes: Array, pairs: list[list[np.ndarray]]) -> None:
    """Write a folder of views. axes: (n, 6), rails, m, gimbals, rad, from the encoders."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True, exist_ok=True)
    with (folder / "views.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for k, row in enumerate(axes):
            rails, gimbals = (f"{x:.7f}" for x in row[:3]), (f"{x:.6f}" for x in np.degrees(row[3:]))
            writer.writerow([f"{k:04d}", *rails, *gimbals])
    for k, pair in enumerate(pairs):
        for side, image in zip(("left", "right"), pair, strict=True):
            cv2.imwrite(str(folder / side / f"{k:04d}.png"), image)
