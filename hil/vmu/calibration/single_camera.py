"""Calibration of one camera from images of a chessboard, without positions of a bench: the docking monitor's camera.

The lens is that of OpenCV; a scene's camera is a pinhole with square pixels. What the pinhole does not have, pixel
aspect and distortion, becomes a tolerance of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from hil.config.scene import Scene
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration.board import Board, find_corners
from hil.vmu.calibration.views import read_image

LEAST_IMAGES: Final = 8
_SUFFIXES: Final = (".png", ".bmp", ".tif", ".tiff", ".pgm", ".jpg", ".jpeg")
_OUTLIER: Final = 3.0  # times the median residual of all images
_FLAGS: Final = cv2.CALIB_FIX_K3


@dataclass(frozen=True, slots=True)
class CameraFit:
    """Camera by its images. focal_px, centre_px: along u and v, (2,); sigma_px: of these four. lens: k1 k2 p1 p2 k3.

    corner_px: largest distortion at the image's corners. used, left_out: names of images.
    """

    size: tuple[int, int]
    focal_px: Array
    centre_px: Array
    sigma_px: Array
    lens: Array
    corner_px: float
    rms_px: float
    used: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def f_px(self) -> float:
        """Focal length of the pinhole, px: the geometric mean of both."""
        return float(math.sqrt(self.focal_px[0] * self.focal_px[1]))

    @property
    def aspect(self) -> float:
        """Height of a pixel relative to its width."""
        return float(self.focal_px[0] / self.focal_px[1])

    def scene_table(self, scene: Scene) -> dict[str, Any]:
        """Return the keys of ``[camera]`` for ``scene``, with tolerances of at least those that it states."""
        tolerances = scene.camera.tolerances
        stated = {name: float(getattr(tolerances, name)) for name in tolerances.model_fields_set}
        focal = self.sigma_px[:2] / self.focal_px
        return {
            "camera": {
                "f": self.f_px,
                "cx": float(self.centre_px[0]),
                "cy": float(self.centre_px[1]),
                "tolerances": {
                    "focal_fraction": max(stated.get("focal_fraction", 0.0), float(focal.max())),
                    "aspect_fraction": max(
                        stated.get("aspect_fraction", 0.0), abs(self.aspect - 1.0), float(np.hypot(*focal))
                    ),
                    "principal_point_px": max(stated.get("principal_point_px", 0.0), float(self.sigma_px[2:].max())),
                    "distortion_px": max(stated.get("distortion_px", 0.0), self.corner_px),
                },
            }
        }

    def as_json(self, passed: bool, limit_px: float) -> dict[str, Any]:
        """Return the content of ``hil calibrate --scene --json``."""
        return {
            "passed": passed,
            "limits": {"rms_px": limit_px},
            "f_px": self.f_px,
            "fx_fy_cx_cy_px": [*map(float, (*self.focal_px, *self.centre_px))],
            "sigma_px": [*map(float, self.sigma_px)],
            "aspect": self.aspect,
            "distortion": [*map(float, self.lens)],
            "distortion_corner_px": self.corner_px,
            "rms_px": self.rms_px,
            "images": list(self.used),
            "left_out": list(self.left_out),
        }


def board_images(
    folder: Path, size: tuple[int, int], board: Board, progress: Callable[[str, float], None]
) -> dict[str, Array]:
    """Return the corners of ``board``, (columns rows, 2), px, by the names of the images in ``folder`` that show it.

    size: (width, height), px. Raises BadInput for images of another size, and for too few.
    """
    if not folder.is_dir():
        raise BadInput.single(str(folder), "", "no such folder: give one with images of the board")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    boards: dict[str, Array] = {}
    for k, path in enumerate(paths):
        progress(f"corners of {path.name}", k / len(paths))
        image = read_image(path)
        if image.shape[::-1] != size:
            text = f"is {image.shape[1]} x {image.shape[0]} px, the camera of the scene is {size[0]} x {size[1]} px"
            raise BadInput.single(str(path), "", text)
        corners = find_corners(image, board)
        if corners is not None:
            boards[path.name] = corners
    if len(boards) < LEAST_IMAGES:
        text = f"{len(boards)} of {len(paths)} images show a board of {board.columns}x{board.rows} inner corners"
        raise BadInput.single(str(folder), "", f"{text}, {LEAST_IMAGES} are needed")
    return boards


def fit_camera(corners: dict[str, Array], size: tuple[int, int], board: Board) -> CameraFit:
    """Return the camera that fits ``corners`` best; images that contradict the rest are left out. Raises BadInput."""
    names = tuple(corners)
    lens_fit = _fit([corners[name] for name in names], size, board)
    good = lens_fit.residual_px < _OUTLIER * np.median(lens_fit.residual_px)
    used = tuple(name for name, is_good in zip(names, good, strict=True) if is_good)
    if not good.all() and len(used) >= LEAST_IMAGES:
        lens_fit = _fit([corners[name] for name in used], size, board)
    else:
        used = names
    matrix, lens = lens_fit.matrix, lens_fit.lens
    corner = np.array([(u, v) for u in (0.0, size[0] - 1.0) for v in (0.0, size[1] - 1.0)])
    ideal = cv2.undistortPoints(corner[:, None], matrix, lens, P=matrix)[:, 0]
    return CameraFit(
        size,
        np.array([matrix[0, 0], matrix[1, 1]]),
        np.array([matrix[0, 2], matrix[1, 2]]),
        lens_fit.sigma_px,
        lens,
        float(np.linalg.norm(ideal - corner, axis=1).max()),
        float(np.sqrt(np.mean(lens_fit.residual_px**2))),
        used,
        tuple(name for name in names if name not in used),
    )


@dataclass(frozen=True, slots=True)
class _LensFit:
    """Camera matrix, lens, sigmas of the matrix' four numbers, and RMS residual of each image, px."""

    matrix: Array
    lens: Array
    sigma_px: Array
    residual_px: Array


def _fit(corners: Sequence[Array], size: tuple[int, int], board: Board) -> _LensFit:
    objects = [board.points().astype(np.float32)] * len(corners)
    images = [image_corners.astype(np.float32) for image_corners in corners]
    try:
        _, matrix, lens, _, _, sigmas, _, residuals = cv2.calibrateCameraExtended(
            objects, images, size, np.eye(3), np.zeros(5), flags=_FLAGS
        )
    except cv2.error as error:
        raise BadInput.single("VIEWS", "", "the images do not determine the camera; tilt the board") from error
    return _LensFit(
        np.asarray(matrix, dtype=float),
        np.asarray(lens, dtype=float).ravel()[:5],
        np.asarray(sigmas, dtype=float).ravel()[:4],
        np.asarray(residuals, dtype=float).ravel(),
    )
