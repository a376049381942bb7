"""Television images of a docking target for the monitor: rays through each pixel, supersampled at the edges.

It shares no mathematics with ``hil.parts.monitor``: its own rotation, planes and lens. It has what the monitor does not
model: lens distortion, pixel aspect, gamma and S-curve, overexposure, vibration, fields, lost frames, a shadow next to
an arm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, maximum_filter, minimum_filter
from scipy.spatial.transform import Rotation

from hil.config.scene import Outline, Scene

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]
FINE = 8
"""Samples of each quarter of a pixel on an edge, a Fibonacci lattice: each has a row and a column of its own."""
_TURNS = 5  # the lattice's generator
_FINER = (89, 55)  # samples and generator of the finer one
_COARSE = 4  # rows and columns of a plain grid
_PARTS = 32
_KEPT = 20  # of a portion with fields
_LAST: dict[tuple[str, TvCamera, tuple[float, ...]], Array] = {}
"""Light of the last exposures: monitors with several scene files see the same images."""


@dataclass(frozen=True)
class TvCamera:
    """Real camera and sensor. f_share, aspect: relative errors of the focal length and of the pixels' height.

    distortion: k1. gamma: exponent of the levels. s_curve: strength of a smooth step mixed in. jitter_px: 1 sigma of
    the displacement of each frame by a rotation of the camera. fields: "" for whole frames, else which field is exposed
    first, the other half a period later. shadow: depth of one at the cross, 0..1. plate_behind_m: of the plate
    behind the disc. coarse: pixels are integrated in steps of a quarter of a pixel and blurred afterwards, which
    displaces edges by about 0.02 px. finer: eleven times as many samples, for long straight edges, which the usual ones
    displace by about 0.003 px. f_drift: change of the focal length per second, relative. parts_px: 1 sigma of the
    displacement of each part in each frame, as by a renderer that rounds coordinates. log_curve: strength of a
    logarithmic tone curve.
    """

    f_share: float = 0.0
    aspect: float = 0.0
    distortion: float = 0.0
    gain: float = 1.0
    gamma: float = 1.0
    s_curve: float = 0.0
    jitter_px: float = 0.0
    fields: str = ""
    shadow: float = 0.0
    plate_behind_m: float = 0.0
    coarse: bool = False
    finer: bool = False
    blur_px: float = 0.8
    noise_levels: float = 2.0
    f_drift: float = 0.0
    parts_px: float = 0.0
    log_curve: float = 0.0


class TvTarget:
    """The target of ``scene`` before a real camera."""

    def __init__(self, scene: Scene, camera: TvCamera) -> None:
        self._scene, self._camera = scene, camera
        self._t_s, self._off = 0.0, np.zeros((_PARTS, 2))
        self._seen = scene.camera.model_dump_json(exclude={"tolerances"}) + scene.target.model_dump_json()

    def frame(self, pose_at: Callable[[float], tuple[Array, Array]], t_s: float, rng: np.random.Generator) -> Image:
        """Return the image of the exposure at ``t_s``; pose_at returns d (3,), m, and phi (3,), rad."""
        self._t_s = t_s
        if self._camera.parts_px:
            self._off = self._camera.parts_px * rng.standard_normal(self._off.shape)
        shaken = self._camera.jitter_px / self._scene.camera.f * np.append(rng.standard_normal(2), 0.0)

        def light_at(t: float) -> Array:
            d, phi = pose_at(t)
            at = (*map(float, (*d, *(phi + shaken), *self._off.flat)), self._camera.f_drift * t_s)
            if (found := _LAST.get(key := (self._seen, self._camera, at))) is None:
                found = _LAST[key] = self._light(d, phi + shaken)
                if len(_LAST) > _KEPT:
                    del _LAST[next(iter(_LAST))]
            return found

        light = light_at(t_s)
        if self._camera.fields:
            light, later = light.copy(), light_at(t_s + 0.5 / self._scene.fps)
            second = 1 if self._camera.fields == "upper_first" else 0
            light[second::2] = later[second::2]
        return self._sensor(light, rng)

    def _sensor(self, light: Array, rng: np.random.Generator) -> Image:
        camera = self._camera
        level = np.clip(light * camera.gain / 255.0, 0.0, 1.0) ** camera.gamma
        if camera.log_curve:
            level = np.log1p(camera.log_curve * level) / np.log1p(camera.log_curve)
        level = (1.0 - camera.s_curve) * level + camera.s_curve * level * level * (3.0 - 2.0 * level)
        levels = 255.0 * level + camera.noise_levels * rng.standard_normal(level.shape)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)

    def _light(self, d: Array, phi: Array) -> Array:
        """Return the light on each pixel: blurred by the lens, then integrated over the pixel."""
        known, blur = self._scene.camera, self._camera.blur_px
        rows, columns = np.mgrid[: known.height, : known.width].astype(float)
        level = self._levels(columns, rows, d, phi)
        edge = maximum_filter(level, 3) != minimum_filter(level, 3)
        v, u = np.nonzero(edge)
        if self._camera.coarse:
            du, dv = _grid()
            level[v, u] = self._levels(u[:, None] + du, v[:, None] + dv, d, phi).mean(axis=1)
            return np.asarray(gaussian_filter(level, blur, mode="nearest"))
        parts = np.repeat(np.repeat(level.astype(np.float32), 2, axis=0), 2, axis=1)
        du, dv = _lattice(*(_FINER if self._camera.finer else (FINE, _TURNS)))
        for row in range(2):
            for column in range(2):
                at_u, at_v = u[:, None] + 0.5 * column - 0.25 + 0.5 * du, v[:, None] + 0.5 * row - 0.25 + 0.5 * dv
                parts[2 * v + row, 2 * u + column] = self._levels(at_u, at_v, d, phi).mean(axis=1)
        parts = gaussian_filter(parts, 2.0 * blur, mode="nearest")
        whole = parts.reshape(known.height, 2, known.width, 2).mean(axis=(1, 3))
        return np.asarray(whole, dtype=float)

    def _levels(self, u: Array, v: Array, d: Array, phi: Array) -> Array:
        """Return the grey levels that the rays of pixels see, nearest plane first."""
        known, camera, target = self._scene.camera, self._camera, self._scene.target
        f = known.f * (1.0 + camera.f_share) * (1.0 + camera.f_drift * self._t_s)
        parts = iter(self._off)
        a, b = (u - known.cx) / f, -(v - known.cy) / (f * (1.0 + camera.aspect))
        x, y = a, b
        for _ in range(4 if camera.distortion else 0):
            swell = 1.0 + camera.distortion * (x * x + y * y)
            x, y = a / swell, b / swell
        to_target = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(phi).as_matrix()
        ray = [to_target[i, 0] * x + to_target[i, 1] * y + to_target[i, 2] for i in range(3)]
        level = np.full(u.shape, known.sky)

        def plane(offset: float) -> tuple[Array, Array]:
            reach = (offset - d[2]) / ray[2]
            du, dv = next(parts)
            return d[0] + reach * (ray[0] + du / f), d[1] + reach * (ray[1] + dv / f)

        def paint(where: npt.NDArray[np.bool_], grey: float) -> None:
            level[where] = grey

        if target.outline is not None:
            p, q = plane(target.outline.offset_m)
            paint(_inside(target.outline, p, q), target.outline.level)
        for box in sorted(target.boxes, key=lambda box: box.offset_m):
            p, q = plane(box.offset_m)
            paint((abs(p - box.x_m) < 0.5 * box.width_m) & (abs(q - box.y_m) < 0.5 * box.height_m), box.level)
        if target.plate is not None:
            p, q = plane(target.plate.offset_m - camera.plate_behind_m)
            paint((abs(p) < 0.5 * target.plate.width_m) & (abs(q) < 0.5 * target.plate.height_m), target.plate.level)
        p, q = plane(0.0)
        if target.disc is not None:
            paint(np.hypot(p, q) < target.disc.radius_m, target.disc.level)
        if target.labels is not None:
            for one, two in target.labels.centers_m:
                paint(np.hypot(p - one, q - two) < target.labels.radius_m, target.labels.level)
        if target.cross is not None:
            arm, half = target.cross.arm_length_m, 0.5 * target.cross.arm_width_m
            if camera.shadow:
                beside = (abs(p) < arm) & (q < -half) & (q > -2.5 * half)
                level[beside] *= 1.0 - camera.shadow
            p, q = plane(target.cross.offset_m)
            bar = ((abs(p) < arm) & (abs(q) < half)) | ((abs(q) < arm) & (abs(p) < half))
            paint(bar, target.cross.level)
        return level


def _inside(outline: Outline, p: Array, q: Array) -> npt.NDArray[np.bool_]:
    """Return where points of its plane are inside of ``outline``."""
    if outline.radius_m is not None:
        return np.asarray(np.hypot(p - outline.center_m[0], q - outline.center_m[1]) < outline.radius_m)
    crossed = np.zeros(p.shape, bool)
    for (x0, y0), (x1, y1) in zip(outline.corners_m, outline.corners_m[1:] + outline.corners_m[:1], strict=True):
        if y0 != y1:
            crossed ^= ((q < y0) != (q < y1)) & (p < x0 + (q - y0) * (x1 - x0) / (y1 - y0))
    return crossed


def _lattice(count: int, turns: int) -> tuple[Array, Array]:
    """Return the places of the samples in a square."""
    k = np.arange(count)
    return (k + 0.5) / count - 0.5, (k * turns % count + 0.5) / count - 0.5


def _grid() -> tuple[Array, Array]:
    step = (np.arange(_COARSE) + 0.5) / _COARSE - 0.5
    du, dv = np.meshgrid(step, step)
    return du.ravel(), dv.ravel()
