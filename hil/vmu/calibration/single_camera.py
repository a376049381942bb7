"""Calibration of one camera from images of a board, without positions of a bench: the docking monitor's or a unit's.

The lens is that of OpenCV; a scene's camera is a pinhole with square pixels. What the pinhole does not have, pixel
aspect and distortion, becomes a tolerance of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.scene import Scene
from hil.config.vmu_geometry import Tolerances, VmuCamera, VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration.board import Board, find_corners
from hil.vmu.calibration.model import SIDES
from hil.vmu.calibration.views import images_of, read_image, sides_of
from hil.vmu.geometry import EXACT

LEAST_IMAGES: Final = 8
_OUTLIER: Final = 3.0  # times the median residual of all images
_FLAGS: Final = cv2.CALIB_FIX_K3


@dataclass(frozen=True, slots=True)
class CameraFit:
    """Camera by its images. focal_px, centre_px: along u and v, (2,); sigma_px: of these four. lens: k1 k2 p1 p2 k3.

    corner_px: largest distortion at the image's corners. used: names of images. left_out: the others, with the reason.
    """

    size: tuple[int, int]
    focal_px: Array
    centre_px: Array
    sigma_px: Array
    lens: Array
    corner_px: float
    rms_px: float
    used: tuple[str, ...]
    left_out: Mapping[str, str]

    @property
    def f_px(self) -> float:
        """Focal length of the pinhole, px: the geometric mean of both."""
        return float(math.sqrt(self.focal_px[0] * self.focal_px[1]))

    @property
    def aspect(self) -> float:
        """Height of a pixel relative to its width."""
        return float(self.focal_px[0] / self.focal_px[1])

    def scene_table(self, scene: Scene, identity: CameraIdentity | None = None) -> dict[str, Any]:
        """Return the keys of ``[camera]`` for ``scene``, with tolerances of at least those that it states."""
        tolerances = scene.camera.tolerances
        stated = {name: float(getattr(tolerances, name)) for name in tolerances.model_fields_set}
        focal = self.sigma_px[:2] / self.focal_px
        return {
            "camera": {
                "f": self.f_px,
                "cx": float(self.centre_px[0]),
                "cy": float(self.centre_px[1]),
                **({} if identity is None else {"identity": identity.model_dump(exclude_none=True)}),
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

    def geometry(self, nominal: VmuGeometry, side: str, identity: CameraIdentity | None = None) -> VmuGeometry:
        """Return ``nominal`` with this camera as its ``side``, and tolerances of at least this camera's sigmas."""
        names = ("fx", "fy", "cx", "cy")
        numbers = dict(zip(names, map(float, (*self.focal_px, *self.centre_px)), strict=True))
        camera = VmuCamera(
            **numbers,
            width=self.size[0],
            height=self.size[1],
            distortion=tuple(self.lens),
            row_time_s=getattr(nominal, side).row_time_s,
            identity=identity,
        )
        stated = Tolerances() if nominal.tolerances == EXACT else nominal.tolerances
        focal = float((self.sigma_px[:2] / self.focal_px).max())
        update = {
            "focal_fraction": max(stated.focal_fraction, focal),
            "principal_point_px": max(stated.principal_point_px, float(self.sigma_px[2:].max())),
        }
        tolerances = stated.model_copy(update=update)
        return nominal.model_copy(update={side: camera, "tolerances": tolerances, "calibration": None})

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
            "left_out": dict(self.left_out),
        }


def images_of_camera(folder: Path, side: str | None = None) -> tuple[Path, ...]:
    """Return the images of ``folder``, or those of its ``side`` if it has any of a side. Raises BadInput."""
    if not folder.is_dir():
        raise BadInput.single(str(folder), "", "no such folder: give one with images of the board")
    of_sides = sides_of(folder)
    return of_sides[SIDES.index(side)] if side is not None and any(of_sides) else images_of(folder)


def board_images(
    paths: Sequence[Path], size: tuple[int, int] | None, board: Board, progress: Callable[[str, float], None]
) -> tuple[dict[str, Array | None], tuple[int, int]]:
    """Return the corners of ``board``, (columns rows, 2), px, by the names of the images, and the images' size.

    None for an image that does not show it. size: (width, height), px, that the images must have, None: any, but the
    same. Raises BadInput for images of another size, and for too few that show it.
    """
    boards: dict[str, Array | None] = {}
    others = "the others are" if size is None else "the camera of the scene is"
    for k, path in enumerate(paths):
        progress(f"corners of {path.name}", k / len(paths))
        image = read_image(path)
        shape = image.shape[1], image.shape[0]
        if size is not None and shape != size:
            raise BadInput.single(str(path), "", f"is {shape[0]} x {shape[1]} px, {others} {size[0]} x {size[1]} px")
        size = shape
        boards[path.name] = find_corners(image, board)
    number = sum(corners is not None for corners in boards.values())
    if number < LEAST_IMAGES or size is None:
        text = f"{number} of {len(paths)} images show a board of {board.columns}x{board.rows} inner corners"
        raise BadInput.single("--board", "", f"{text}, {LEAST_IMAGES} are needed")
    return boards, size


def fit_camera(images: Mapping[str, Array | None], size: tuple[int, int], board: Board) -> CameraFit:
    """Return the camera that fits ``images`` best; those that contradict the rest are left out. Raises BadInput."""
    corners = {name: each for name, each in images.items() if each is not None}
    left_out = {name: "the board is not completely visible" for name in images if name not in corners}
    names = tuple(corners)
    lens_fit = _fit([corners[name] for name in names], size, board)
    usual = float(np.median(lens_fit.residual_px))
    good = lens_fit.residual_px < _OUTLIER * usual
    used = tuple(name for name, is_good in zip(names, good, strict=True) if is_good)
    if not good.all() and len(used) >= LEAST_IMAGES:
        left_out |= {
            name: f"residuals of {residual:.2f} px, median {usual:.2f} px"
            for name, residual in zip(names, lens_fit.residual_px, strict=True)
            if name not in used
        }
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
        left_out,
    )


@dataclass(frozen=True, slots=True)
class _LensFit:
    """Camera matrix, lens, sigmas of the matrix' four numbers, and RMS residual of each image, px."""

    matrix: Array
    lens: Array
    sigma_px: Array
    residual_px: Array


def _fit(corners: Sequence[Array], size: tuple[int, int], board: Board) -> _LensFit:
    seen = [np.isfinite(image_corners[:, 0]) for image_corners in corners]
    objects = [board.points()[each].astype(np.float32) for each in seen]
    images = [each[which].astype(np.float32) for each, which in zip(corners, seen, strict=True)]
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
