"""Renderer of the docking camera's images of a target, with the defects of a television image.

A ``TargetRenderer`` renders one scene under one set of conditions, ``film`` a sequence along a trajectory. Time and
randomness are arguments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from hil.config.scene import PixelNoise, Scene, Target
from hil.models import docking_view
from hil.parts.monitor.kernels.coverage import NEAREST_M, draw_parts, expose
from hil.parts.monitor.sources import WHOLE, VideoFrame, exposure, lines_of

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]
Trajectory = Callable[[float], tuple[Floats, Floats]]  # time, s -> d (3,), m, and phi (3,), rad

_BIG_CIRCLE: Final = 720  # corners: error below 1e-5 of the radius
_SMALL_CIRCLE: Final = 96


@dataclass(frozen=True)
class FlatShape:
    """A flat shape parallel to the disc: corners (n, 2), m, ``offset_m`` along y3, and its grey value."""

    corners_m: Floats
    offset_m: float
    level: float


@dataclass(frozen=True)
class Glare:
    """A bright spot at ``place_m`` in C: its height in grey values (more than 255 saturates) and radius, px."""

    place_m: tuple[float, float, float]
    height: float
    radius_px: float


@dataclass(frozen=True)
class Conditions:
    """Conditions of the imaging of a target.

    blur_px: 1 sigma of the point spread of lens and tube. noise: None: the scene camera's. flicker: fraction
    of the brightness, at flicker_hz. slope_right, slope_down: relative increase of the brightness from the image's
    middle to its right and lower edge. extra: parts that hide others (in front) or resemble them (next to the target).
    black_s: intervals (start, end), s, without an image.
    """

    blur_px: float = 0.8
    noise: PixelNoise | None = None
    gain: float = 1.0
    offset: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 3.1
    slope_right: float = 0.0
    slope_down: float = 0.0
    glare: tuple[Glare, ...] = ()
    extra: tuple[FlatShape, ...] = ()
    black_s: tuple[tuple[float, float], ...] = ()

    def gain_at(self, t_s: float) -> float:
        """Return the brightness at ``t_s`` relative to the scene file's levels."""
        if any(start <= t_s < stop for start, stop in self.black_s):
            return 0.0
        return self.gain * (1.0 + self.flicker * float(np.sin(2.0 * np.pi * self.flicker_hz * t_s)))


def circle(radius_m: float, centre_m: tuple[float, float], corners: int = _BIG_CIRCLE) -> Floats:
    """Return the corners (n, 2), m, of the regular polygon of the circle's area."""
    step = 2.0 * np.pi / corners
    radius = radius_m * np.sqrt(step / np.sin(step))
    angle = step * np.arange(corners)
    return np.column_stack((centre_m[0] + radius * np.cos(angle), centre_m[1] + radius * np.sin(angle)))


def rectangle(width_m: float, height_m: float, centre_m: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return the corners (4, 2), m, of a rectangle."""
    half = 0.5 * np.array([width_m, height_m])
    corners: Floats = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * half + np.array(centre_m)
    return corners


def cross(arm_length_m: float, arm_width_m: float, centre_m: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """Return the corners (12, 2), m, of an upright cross."""
    a, w = arm_length_m, 0.5 * arm_width_m
    quarter = np.array([[a, w], [w, w], [w, a]])
    turn = np.array([[0.0, 1.0], [-1.0, 0.0]])  # row vector times it: rotation by 90 deg
    rows = [quarter]
    for _ in range(3):
        rows.append(rows[-1] @ turn)
    corners: Floats = np.vstack(rows) + np.array(centre_m)
    return corners


def parts_of(target: Target) -> list[FlatShape]:
    """Return the target's parts, back to front."""
    parts: list[FlatShape] = []
    if target.outline is not None:
        corners = np.array(target.outline.corners_m)
        if target.outline.radius_m is not None:
            corners = circle(target.outline.radius_m, target.outline.center_m)
        parts.append(FlatShape(corners, target.outline.offset_m, target.outline.level))
    parts += [
        FlatShape(rectangle(box.width_m, box.height_m, (box.x_m, box.y_m)), box.offset_m, box.level)
        for box in target.boxes
    ]
    if target.plate is not None:
        plate = target.plate
        parts.append(FlatShape(rectangle(plate.width_m, plate.height_m), plate.offset_m, plate.level))
    if target.disc is not None:
        parts.append(FlatShape(circle(target.disc.radius_m, (0.0, 0.0)), 0.0, target.disc.level))
    if target.labels is not None:
        for centre in target.labels.centers_m:
            corners = circle(target.labels.radius_m, centre, _SMALL_CIRCLE)
            parts.append(FlatShape(corners, 0.0, target.labels.level))
    if target.cross is not None:
        corners = cross(target.cross.arm_length_m, target.cross.arm_width_m)
        parts.append(FlatShape(corners, target.cross.offset_m, target.cross.level))
    return parts


class TargetRenderer:
    """Renders ``target`` of ``scene`` (default: the basic one) as seen by its camera."""

    def __init__(self, scene: Scene, target: Target | None = None, conditions: Conditions | None = None) -> None:
        self.scene = scene
        self.conditions = conditions or Conditions()
        camera = scene.camera
        self._lens = np.array([camera.f, camera.cx, camera.cy])
        self._noise = self.conditions.noise or camera.noise
        # stable sort: of parts in one plane, labels remain on the disc
        parts = sorted([*parts_of(target or scene.target), *self.conditions.extra], key=lambda part: part.offset_m)
        rows = [np.column_stack((part.corners_m, np.full(len(part.corners_m), part.offset_m))) for part in parts]
        self._corners = np.vstack(rows)
        self._starts = np.concatenate(([0], np.cumsum([len(row) for row in rows])))
        self._levels = np.array([part.level for part in parts])
        self._area = np.zeros((camera.height, camera.width + 2))
        self._normals = np.empty((camera.height, camera.width), np.float32)

    def draw(self, d_m: Floats, phi_rad: Floats) -> NDArray[np.float32]:
        """Return the brightness (h, w), grey values, after the lens and without noise, at pose d (3,), phi (3,)."""
        camera = self.scene.camera
        image = np.full((camera.height, camera.width), camera.sky, np.float32)
        d, phi = np.asarray(d_m, float), np.asarray(phi_rad, float)
        draw_parts(self._lens, d, phi, self._corners, self._starts, self._levels, self._area, image)
        return blurred(image, self.conditions.blur_px)

    def expose(
        self, clean: NDArray[np.float32], d_m: Floats, phi_rad: Floats, t_s: float, rng: np.random.Generator
    ) -> Image:
        """Return the camera's image (h, w) of ``clean`` at ``t_s``."""
        gain = self.conditions.gain_at(t_s)
        light = np.array([gain, self.conditions.offset, self.conditions.slope_right, self.conditions.slope_down])
        glare = self._spots(np.asarray(d_m, float), np.asarray(phi_rad, float)) if gain > 0.0 else np.empty((0, 4))
        rng.standard_normal(out=self._normals, dtype=np.float32)
        out = np.empty(clean.shape, np.uint8)
        expose(clean, light, glare, self._noise.read, self._noise.k, self._normals, out)
        return out

    def image(self, d_m: Floats, phi_rad: Floats, t_s: float, rng: np.random.Generator) -> Image:
        """Return the image (h, w) of the pose d (3,), m, phi (3,), rad, at ``t_s``."""
        return self.expose(self.draw(d_m, phi_rad), d_m, phi_rad, t_s, rng)

    def frame(self, number: int, trajectory: Trajectory, rng: np.random.Generator) -> VideoFrame:
        """Return frame ``number`` of a trajectory: the image, or the field exposed at that time."""
        t_s, field = exposure(self.scene, number)
        image = self.image(*trajectory(t_s), t_s, rng)
        if field != WHOLE:
            image = np.ascontiguousarray(image[lines_of(field)])
        return VideoFrame(number, t_s, image, field)

    def _spots(self, d: Floats, phi: Floats) -> Floats:
        a = docking_view.attitude(phi)
        rows = []
        for spot in self.conditions.glare:
            x = docking_view.to_camera(a, d, np.array(spot.place_m))
            if x[2] > NEAREST_M:
                u, v = docking_view.project_point(self._lens[0], self._lens[1], self._lens[2], x)
                rows.append([u, v, spot.height, spot.radius_px])
        return np.array(rows).reshape(-1, 4)


def blurred(image: NDArray[np.float32], sigma_px: float) -> NDArray[np.float32]:
    """Return ``image`` after a lens with a Gaussian point spread of ``sigma_px``."""
    if sigma_px <= 0.0:
        return image
    side = 2 * int(np.ceil(4.0 * sigma_px)) + 1
    return cv2.GaussianBlur(image, (side, side), sigma_px, borderType=cv2.BORDER_REPLICATE).astype(
        np.float32, copy=False
    )


def film(
    renderer: TargetRenderer, trajectory: Trajectory, images: int, rng: np.random.Generator
) -> Iterator[VideoFrame]:
    """Yield the frames of ``images`` images along a trajectory at the scene's rate; two fields each if interlaced."""
    halves = 1 if renderer.scene.fields == "whole" else 2
    for number in range(halves * images):
        yield renderer.frame(number, trajectory, rng)
