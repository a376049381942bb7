"""Pixel renderer of an LED ring for the vision unit, by brute-force supersampling.

It shares no mathematics with ``hil.vmu``: its own camera, its own rotations, and lights that are sums of many points
of a disc, blurred and averaged over 4 x 4 samples of each pixel. Lens and sensor have what the vision unit does not
model: coma, a halo, a textured background.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

Array = npt.NDArray[np.float64]
Image = npt.NDArray[np.uint8]

FINE = 4
"""Samples along each side of a pixel."""
_DISC = 400
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


@dataclass(frozen=True)
class PixelCamera:
    """Real camera: pinhole with lens distortion k1 k2 p1 p2 k3; turn and place of its axes in the left one's."""

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def pixels(self, points_v: Array) -> Array:
        """Return the pixels (n, 2) of points (n, 3) in the left camera's axes; NaN behind the camera."""
        own = Rotation.from_rotvec(self.turn).inv().apply(points_v - np.array(self.place))
        depth = np.where(own[:, 2] > 0.01, own[:, 2], np.nan)
        a, b = own[:, 0] / depth, own[:, 1] / depth
        k1, k2, p1, p2, k3 = self.distortion
        s = a * a + b * b
        swell = 1.0 + k1 * s + k2 * s**2 + k3 * s**3
        x = a * swell + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a)
        y = b * swell + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b
        return np.column_stack([self.cx + self.fx * x, self.cy + self.fy * y])


@dataclass(frozen=True)
class PixelOptics:
    """Lens, exposure and sensor; levels are grey levels.

    coma_px: length of the comatic tail at the image's corner. halo: fraction of a light in a wide halo.
    texture_levels: standard deviation of the background, with structures from 3 to 24 px.
    """

    blur_px: float = 1.0
    coma_px: float = 0.0
    halo: float = 0.0
    halo_px: float = 9.0
    background_levels: float = 12.0
    texture_levels: float = 0.0
    peak_levels: float = 200.0
    electrons_per_level: float = 100.0
    read_noise_levels: float = 0.8
    led_diameter_m: float = 0.005


@dataclass(frozen=True)
class PixelScene:
    """Two real cameras and a real ring; extra: (n, 4) lights in space of the ring, with brightness relative to an LED.

    glare: for each camera lights of this image only, rows of u, v, brightness. backdrop: for each camera levels behind
    all, (h, w), and the fraction (h, w) of all light that reaches the sensor. ghost: for each camera the fraction of a
    light that the lens reflects, its place relative to the centre of the image, and that centre, u and v, px. sensor:
    what the sensor makes of the light of an image, levels, before noise and full scale.
    """

    left: PixelCamera
    right: PixelCamera
    leds_m: Array
    optics: PixelOptics = field(default_factory=PixelOptics)
    lights_v: Array = field(default_factory=lambda: np.zeros((0, 4)))
    glare: tuple[Array, Array] = field(default_factory=lambda: (np.zeros((0, 3)), np.zeros((0, 3))))
    backdrop: tuple[tuple[Array, Array], ...] = ()
    ghost: tuple[tuple[float, ...], ...] = ()
    sensor: Callable[[Array], Array] | None = None

    def pair(self, turn: Array, t_v: Array, rng: np.random.Generator) -> tuple[Image, Image]:
        """Return both images of the ring at ``p_v = exp([turn]x) p_t + t_v``."""
        return self.image(0, turn, t_v, rng), self.image(1, turn, t_v, rng)

    def image(self, side: int, turn: Array, t_v: Array, rng: np.random.Generator) -> Image:
        """Return one camera's image."""
        camera, optics = (self.left, self.right)[side], self.optics
        light = np.zeros((camera.height, camera.width))
        away = float(np.linalg.norm(t_v))
        radius_px = 0.5 * optics.led_diameter_m * camera.fx / away
        spread = 2.0 * np.pi * (optics.blur_px**2 + 0.25 * radius_px**2)  # px^2, to set the exposure
        total = optics.peak_levels * spread
        rotation = Rotation.from_rotvec(turn)
        disc = _sunflower(0.5 * optics.led_diameter_m)
        flat = np.column_stack([disc, np.zeros(len(disc))])
        lights = [(camera.pixels(rotation.apply(led + flat) + t_v), total) for led in self.leds_m]
        lights += [(camera.pixels(row[:3] + flat), total * row[3]) for row in self.lights_v]
        if self.ghost:
            part, scale, *centre = self.ghost[side]
            lights += [(centre + scale * (pixels - centre), part * levels) for pixels, levels in lights]
        for pixels, levels in lights:
            _add_light(light, camera, optics, pixels, levels)
        for row in self.glare[side]:
            _add_light(light, camera, optics, row[None, :2] + 0.4 * rng.standard_normal((4, 2)), total * row[2])
        light += optics.background_levels + _texture(light.shape, optics.texture_levels, rng)
        if self.backdrop:
            behind, seen = self.backdrop[side]
            light = (light + behind) * seen
        light = np.maximum(light if self.sensor is None else self.sensor(light), 0.0)
        variance = light / optics.electrons_per_level + optics.read_noise_levels**2  # of a thousand electrons and more
        levels = light + np.sqrt(variance) * rng.standard_normal(light.shape, dtype=np.float32)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def _sunflower(radius: float) -> Array:
    k = np.arange(_DISC)
    distance = radius * np.sqrt((k + 0.5) / _DISC)
    points = np.column_stack([distance * np.cos(k * _GOLDEN), distance * np.sin(k * _GOLDEN)])
    return np.asarray(points - points.mean(axis=0))


def _add_light(light: Array, camera: PixelCamera, optics: PixelOptics, points: Array, total: float) -> None:
    """Add the light of ``total`` levels of the disc whose points are at pixels ``points`` (n, 2)."""
    if not np.isfinite(points).all():
        return
    outward = (points.mean(axis=0) - [camera.cx, camera.cy]) / np.hypot(camera.width, camera.height) * 2.0
    tail = optics.coma_px * outward
    parts = [(0.72, 0.0, optics.blur_px), (0.2, 1.0, 1.1 * optics.blur_px), (0.08, 2.2, 1.3 * optics.blur_px)]
    if not optics.coma_px:
        parts = [(1.0, 0.0, optics.blur_px)]
    _splat(light, points, [((1.0 - optics.halo) * w, shift * tail, blur) for w, shift, blur in parts], total)
    if optics.halo:
        _splat(light, points, [(optics.halo, 0.0 * tail, optics.halo_px)], total)


def _splat(light: Array, points: Array, parts: list[tuple[float, Array, float]], total: float) -> None:
    rows, columns = light.shape
    reach = 5.0 * max(blur for _, _, blur in parts) + 2.0
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    shifts = np.array([shift for _, shift, _ in parts])
    low, high = low + np.minimum(shifts.min(axis=0), 0.0), high + np.maximum(shifts.max(axis=0), 0.0)
    u0, u1 = max(int(low[0]), 0), min(int(high[0]) + 1, columns)
    v0, v1 = max(int(low[1]), 0), min(int(high[1]) + 1, rows)
    if u1 <= u0 or v1 <= v0:
        return
    offset = (np.arange(FINE) + 0.5) / FINE - 0.5
    u = (np.arange(u0, u1)[:, None] + offset).ravel()
    v = (np.arange(v0, v1)[:, None] + offset).ravel()
    for weight, shift, blur in parts:
        # a Gaussian is a product, so that the mean over the samples of a pixel is one of means
        across = np.exp(-0.5 * ((u[:, None] - points[:, 0] - shift[0]) / blur) ** 2)
        down = np.exp(-0.5 * ((v[:, None] - points[:, 1] - shift[1]) / blur) ** 2)
        means = [each.reshape(-1, FINE, len(points)).mean(axis=1) for each in (down, across)]
        light[v0:v1, u0:u1] += total * weight / (2.0 * np.pi * blur * blur * len(points)) * (means[0] @ means[1].T)


def _texture(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> Array:
    if not sigma:
        return np.zeros(shape)
    total = np.zeros(shape)
    for scale in (3.0, 8.0, 24.0):
        layer = gaussian_filter(rng.standard_normal(shape), scale, mode="wrap")
        total += layer / layer.std()
    return sigma * total / total.std()


def turned(camera: PixelCamera, by_rad: Array) -> PixelCamera:
    """Return ``camera`` turned by the small rotation vector ``by_rad`` (3,)."""
    turn = Rotation.from_rotvec(by_rad) * Rotation.from_rotvec(camera.turn)
    return replace(camera, turn=tuple(float(x) for x in turn.as_rotvec()))
