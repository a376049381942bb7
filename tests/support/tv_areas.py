"""Television images of a docking target by areas: outlines of its parts, projected forwards, cover each pixel exactly.

A second renderer besides the rays of ``tv_pixels``: no samples, but the area of a pixel that each polygon covers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from hil.config.scene import Scene
from tests.support.tv_pixels import TvCamera

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
_FINE = 2  # cells along each side of a pixel
_STEP_PX = 4.0  # longest straight piece of an outline that a lens bends
_ROUND = 360  # pieces of a circle


@dataclass(frozen=True)
class TargetErrors:
    """Errors of the real target against its file. cross_m: the cross further in front. disc: radius, relative."""

    cross_m: float = 0.0
    disc: float = 0.0


class AreaTarget:
    """The target of ``scene`` before a real camera (``TvCamera``, without its fields, vibration and shadow)."""

    def __init__(self, scene: Scene, camera: TvCamera, errors: TargetErrors | None = None) -> None:
        self._scene, self._camera, self._errors = scene, camera, errors or TargetErrors()

    def frame(self, pose_at: Callable[[float], tuple[Array, Array]], t_s: float, rng: np.random.Generator) -> Image:
        """Return the image of the exposure at ``t_s``; pose_at returns d (3,), m, and phi (3,), rad."""
        camera = self._camera
        light = self.light(*pose_at(t_s))
        level = np.clip(light * camera.gain / 255.0, 0.0, 1.0) ** camera.gamma
        level = (1.0 - camera.s_curve) * level + camera.s_curve * level * level * (3.0 - 2.0 * level)
        levels = 255.0 * level + camera.noise_levels * rng.standard_normal(level.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def light(self, d: Array, phi: Array) -> Array:
        """Return the light (h, w) on each pixel, grey values, blurred by the lens."""
        known = self._scene.camera
        light = np.full((_FINE * known.height, _FINE * known.width), known.sky, np.float32)
        for outline_m, level in self._parts():
            at = _FINE * (self._pixels(outline_m, d, phi) + 0.5)
            low = np.clip(np.floor(at.min(axis=0)).astype(int) - 1, 0, light.shape[::-1])
            top = np.clip(np.ceil(at.max(axis=0)).astype(int) + 2, 0, light.shape[::-1])
            behind = light[low[1] : top[1], low[0] : top[0]]
            behind += _covered(at - low, behind.shape) * (level - behind)
        blur = _FINE * self._camera.blur_px
        side = 2 * int(np.ceil(5.0 * blur)) + 1
        light = cv2.GaussianBlur(light, (side, side), blur, borderType=cv2.BORDER_REPLICATE)
        return cv2.resize(light, (known.width, known.height), interpolation=cv2.INTER_AREA).astype(float)

    def _parts(self) -> list[tuple[Array, float]]:
        """Return outlines (n, 3) in C, m, and grey values of the parts, those behind first."""
        target, parts = self._scene.target, []
        if target.outline is not None:
            shape = target.outline
            edge = _circle(*shape.center_m, shape.radius_m) if shape.radius_m is not None else np.array(shape.corners_m)
            parts.append((edge, shape.offset_m, shape.level))
        boxes = sorted(target.boxes, key=lambda box: box.offset_m)
        parts += [(_rectangle(b.x_m, b.y_m, b.width_m, b.height_m), b.offset_m, b.level) for b in boxes]
        if target.plate is not None:
            behind = target.plate.offset_m - self._camera.plate_behind_m
            parts.append(
                (_rectangle(0.0, 0.0, target.plate.width_m, target.plate.height_m), behind, target.plate.level)
            )
        if target.disc is not None:
            radius = target.disc.radius_m * (1.0 + self._errors.disc)
            parts.append((_circle(0.0, 0.0, radius), 0.0, target.disc.level))
        if target.labels is not None:
            labels = target.labels
            parts += [(_circle(*centre, labels.radius_m), 0.0, labels.level) for centre in labels.centers_m]
        if target.cross is not None:
            arm, half = target.cross.arm_length_m, 0.5 * target.cross.arm_width_m
            quarter = np.array([[arm, -half], [arm, half], [half, half]])
            turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
            edge = np.concatenate([quarter @ np.linalg.matrix_power(turn, k) for k in range(4)])
            parts.append((edge, target.cross.offset_m + self._errors.cross_m, target.cross.level))
        return [(np.column_stack([edge, np.full(len(edge), offset)]), level) for edge, offset, level in parts]

    def _pixels(self, outline_m: Array, d: Array, phi: Array) -> Array:
        """Return the outline (n, 2) in the image, px, in pieces short enough for a lens with distortion."""
        known, camera = self._scene.camera, self._camera
        angle = float(np.linalg.norm(phi))
        x, y, z = phi / angle if angle else phi
        skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        turn = np.eye(3) + np.sin(angle) * skew + (1.0 - np.cos(angle)) * skew @ skew
        following = np.roll(outline_m, -1, axis=0)
        pieces = 1 if len(outline_m) > 50 else max(2, int(known.f * 5.0 / (_STEP_PX * max(d[2], 0.5))))
        along = np.arange(pieces)[None, :, None] / pieces
        points = (outline_m[:, None] * (1.0 - along) + following[:, None] * along).reshape(-1, 3)
        # y = d + diag(1, -1, -1) T x, T a rotation
        seen = ((points - d) * [1.0, -1.0, -1.0]) @ turn
        a, b = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
        swell = 1.0 + camera.distortion * (a * a + b * b)
        f = known.f * (1.0 + camera.f_share)
        return np.column_stack([known.cx + f * swell * a, known.cy - f * (1.0 + camera.aspect) * swell * b])


def _rectangle(x: float, y: float, width: float, height: float) -> Array:
    return np.array([x, y]) + 0.5 * np.array([width, height]) * [[-1, -1], [1, -1], [1, 1], [-1, 1]]


def _circle(x: float, y: float, radius: float) -> Array:
    angle = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    wider = np.sqrt(2.0 * np.pi / _ROUND / np.sin(2.0 * np.pi / _ROUND))  # of the same area
    return np.array([x, y]) + wider * radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _covered(polygon: Array, shape: tuple[int, ...]) -> Array:
    """Return the fraction (h, w) of each unit cell that ``polygon`` (n, 2), u and v, covers."""
    high, wide = shape
    start, end = polygon, np.roll(polygon, -1, axis=0)
    crossings = [np.repeat(np.arange(len(polygon)), 2)], [np.tile([0.0, 1.0], len(polygon))]
    for axis in (0, 1):  # cut at each line between cells
        low, top = np.minimum(start, end)[:, axis], np.maximum(start, end)[:, axis]
        count = np.maximum(np.floor(top) - np.ceil(low) + 1, 0).astype(int)
        edge = np.repeat(np.arange(len(polygon)), count)
        number = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        line = np.ceil(low)[edge] + number
        span = (end - start)[edge, axis]
        usable = span != 0.0
        crossings[0].append(edge[usable])
        crossings[1].append((line[usable] - start[edge[usable], axis]) / span[usable])
    edge, along = np.concatenate(crossings[0]), np.clip(np.concatenate(crossings[1]), 0.0, 1.0)
    order = np.lexsort((along, edge))
    edge, along = edge[order], along[order]
    points = start[edge] + along[:, None] * (end - start)[edge]
    one, two = points[:-1][edge[1:] == edge[:-1]], points[1:][edge[1:] == edge[:-1]]
    middle, rise = 0.5 * (one + two), (two - one)[:, 1]
    row, column = np.floor(middle[:, 1]).astype(int), np.floor(middle[:, 0]).astype(int)
    inside = (row >= 0) & (row < high)
    row, column, part, rise = row[inside], column[inside], (middle[:, 0] - column)[inside], rise[inside]
    left, right = column < 0, column >= wide
    column = np.clip(column, 0, wide - 1)
    cell, size = (row * (wide + 1) + column)[~right], high * (wide + 1)
    area = np.bincount(cell, (rise * np.where(left, 1.0, 1.0 - part))[~right], size)
    area += np.bincount(cell + 1, (rise * np.where(left, 0.0, part))[~right], size)
    return np.abs(np.cumsum(area.reshape(high, wide + 1), axis=1)[:, :wide])
