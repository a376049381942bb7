"""Renderer of the LED ring's images in the two cameras of a vision unit, including noise.

The noise is exact near lights: Poisson-distributed electrons, read noise, rounding and clipping. Between the lights
each row takes its noise from one table of normals at a random offset, a hundred times faster; no spot is measured
there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.vmu.kernels.disc import add_disc
from hil.vmu.kernels.lens import CameraPair, in_image, project
from hil.vmu.kernels.rendering import clear_box, disc_images, fill_background, project_points, to_camera

Image = np.ndarray

FULL_SCALE: Final = 255.0
_POOL: Final = 1 << 20


@dataclass(frozen=True, slots=True)
class HotPixel:
    """A pixel of constant ``level``. camera: 0 left, 1 right."""

    camera: int
    u: int
    v: int
    level: int = 200


@dataclass(frozen=True, slots=True)
class RingAppearance:
    """Properties of LEDs and cameras, the same in every frame; levels are grey levels."""

    psf_sigma_px: float = 1.0
    led_diameter_m: float = 0.005
    led_flux: tuple[float, ...] | None = None
    """brightness of each LED relative to ``flux_1m_levels``; greater for a marked LED"""
    flux_1m_levels: float = 25e3
    """sum over an LED's spot at 1 m on its axis, at a gain of 1"""
    lobe: float = 1.0
    """power of the cosine in the LED's emission; 0: isotropic"""
    auto_peak_levels: float | None = 220.0
    """peak of the brightest LED by automatic exposure, within ``gain_range``; None: gain of 1"""
    gain_range: tuple[float, float] = (0.01, 1.0)
    background_levels: float = 12.0
    gradient_levels: tuple[float, float] = (0.0, 0.0)
    """background at the right and lower edges minus that at the left and upper ones"""
    electrons_per_level: float = 100.0
    read_noise_levels: float = 0.8
    hot_pixels: tuple[HotPixel, ...] = ()


@dataclass(frozen=True, slots=True)
class Light:
    """A light in space that is not part of the target, visible to both cameras. position_v: (3,), m."""

    position_v: tuple[float, float, float]
    flux_1m_levels: float = 25e3
    diameter_m: float = 0.005


@dataclass(frozen=True, slots=True)
class Reflection:
    """A light in one image only. camera: 0 left, 1 right."""

    camera: int
    u_px: float
    v_px: float
    flux_levels: float = 1500.0
    sigma_px: float = 1.2


@dataclass(frozen=True, slots=True)
class Shade:
    """An opaque object in front of one camera: no light on the pixels from (u0, v0) up to (u1, v1)."""

    camera: int
    u0: int
    v0: int
    u1: int
    v1: int


@dataclass(frozen=True, slots=True)
class Extras:
    """Disturbances of one frame. dark: whether the left and the right camera receive no light."""

    lights: Sequence[Light] = ()
    reflections: Sequence[Reflection] = ()
    shades: Sequence[Shade] = ()
    dark: tuple[bool, bool] = (False, False)


NO_EXTRAS: Final = Extras()


@cache
def _normals() -> np.ndarray:
    table = np.random.default_rng(0).standard_normal(_POOL, dtype=np.float32)
    table.flags.writeable = False
    return table


def projections(pair: CameraPair, points_m: Array, t_v: Array, q_vt: Array) -> Array:
    """Return the pixels (2, n, 2) of ``points_m`` (n, 3), in t, in both images; NaN behind a camera.

    t_v (3,), m, and q_vt (4,) are the pose t -> v: ``p_v = A(q_vt) p_t + t_v``.
    """
    out = np.empty((2, len(points_m), 2))
    for camera in range(2):
        rotation, translation = pair.rotation[camera], pair.translation[camera]
        project_points(pair.lens[camera], rotation, translation, points_m, t_v, q_vt, out[camera])
    return out


@dataclass(slots=True)
class _SensorLight:
    """Light on one camera's sensor, zero between two frames."""

    light: Array
    boxes: list[np.ndarray] = field(default_factory=list)

    def add(self, spot: Array, blur_px: float, flux: float) -> None:
        """Add a disc's image; spot: u, v, width, shear, height as in ``disc``."""
        box = np.zeros(4, dtype=np.int64)
        add_disc(self.light, spot[0], spot[1], spot[2], spot[3], spot[4], blur_px, flux, box)
        if box[2] > box[0] and box[3] > box[1]:
            self.boxes.append(box)


class RingRenderer:
    """Renders the stereo pair of a pose. Not thread-safe: it keeps its buffers.

    leds_m: (n, 3), in t; the LEDs shine along -z_t, towards the cameras.
    """

    def __init__(self, pair: CameraPair, leds_m: Array, appearance: RingAppearance) -> None:
        self._pair = pair
        self._leds = np.ascontiguousarray(leds_m, dtype=float)
        self._appearance = appearance
        relative = appearance.led_flux if appearance.led_flux is not None else (1.0,) * len(self._leds)
        if len(relative) != len(self._leds):
            raise ValueError(f"led_flux has {len(relative)} values for {len(self._leds)} LEDs")
        self._flux = appearance.flux_1m_levels * np.array(relative)
        self._sensors = [_SensorLight(np.zeros((int(lens["height"]), int(lens["width"])))) for lens in pair.lens]

    def pair(
        self, t_v: Array, q_vt: Array, lit: Sequence[bool] | None, rng: np.random.Generator, extras: Extras = NO_EXTRAS
    ) -> tuple[Image, Image]:
        """Return the left and the right image, uint8 (height, width), for the pose t -> v.

        lit: per LED, None for all.
        """
        left, right = (self.image(camera, t_v, q_vt, lit, rng, extras) for camera in range(2))
        return left, right

    def image(
        self,
        camera: int,
        t_v: Array,
        q_vt: Array,
        lit: Sequence[bool] | None,
        rng: np.random.Generator,
        extras: Extras = NO_EXTRAS,
    ) -> Image:
        """Return one camera's image (0 left, 1 right)."""
        sensor = self._sensors[camera]
        image = self._background(sensor.light.shape, rng)
        if not extras.dark[camera]:
            self._add_lights(camera, t_v, q_vt, lit, extras)
            for box in sensor.boxes:
                self._expose(image, sensor.light, box, rng)
            for box in sensor.boxes:
                clear_box(sensor.light, box)
            sensor.boxes.clear()
        for pixel in self._appearance.hot_pixels:
            if pixel.camera == camera:
                image[pixel.v, pixel.u] = pixel.level
        return image

    def led_images(
        self, camera: int, t_v: Array, q_vt: Array, lit: Sequence[bool] | None = None
    ) -> tuple[Array, Array]:
        """Return the LEDs' images in a camera (n, 5), as in ``disc``, and their light (n,), levels: the truth."""
        spots, flux, _ = self._led_images(camera, t_v, q_vt, lit)
        return spots[:, :5], flux

    def _background(self, shape: tuple[int, ...], rng: np.random.Generator) -> Image:
        appearance, (rows, columns) = self._appearance, shape
        image = np.empty((rows, columns), dtype=np.uint8)
        across, down = appearance.gradient_levels[0] / columns, appearance.gradient_levels[1] / rows
        offsets = rng.integers(0, _POOL - columns, rows)
        level, noise = appearance.background_levels, appearance.read_noise_levels
        fill_background(image, level, across, down, appearance.electrons_per_level, noise, _normals(), offsets)
        return image

    def _add_lights(self, camera: int, t_v: Array, q_vt: Array, lit: Sequence[bool] | None, extras: Extras) -> None:
        appearance, lens, sensor = self._appearance, self._pair.lens[camera], self._sensors[camera]
        rotation, translation = self._pair.rotation[camera], self._pair.translation[camera]
        spots, fluxes, gain = self._led_images(camera, t_v, q_vt, lit)
        for spot, levels in zip(spots, fluxes, strict=True):
            if levels > 0.0:
                sensor.add(spot[:5], appearance.psf_sigma_px, levels)
        for light in extras.lights:
            p = np.empty(3)
            to_camera(rotation, translation, np.array(light.position_v, dtype=float), p)
            u, v = project(lens, p[0], p[1], p[2])
            if np.isfinite(u) and np.isfinite(v):
                radius = 0.5 * light.diameter_m / p[2]
                levels = gain * light.flux_1m_levels / float(p @ p)
                spot = np.array([u, v, radius * lens["fx"], 0.0, radius * lens["fy"]])
                sensor.add(spot, appearance.psf_sigma_px, levels)
        for reflection in extras.reflections:
            if reflection.camera == camera:
                spot = np.array([reflection.u_px, reflection.v_px, 0.0, 0.0, 0.0])
                sensor.add(spot, reflection.sigma_px, reflection.flux_levels)
        for shade in extras.shades:
            if shade.camera == camera:
                sensor.light[shade.v0 : shade.v1, shade.u0 : shade.u1] = 0.0

    def _led_images(
        self, camera: int, t_v: Array, q_vt: Array, lit: Sequence[bool] | None
    ) -> tuple[Array, Array, float]:
        appearance, lens = self._appearance, self._pair.lens[camera]
        rotation, translation = self._pair.rotation[camera], self._pair.translation[camera]
        spots = np.empty((len(self._leds), 6))
        disc_images(
            lens, rotation, translation, self._leds, t_v, q_vt, 0.5 * appearance.led_diameter_m, appearance.lobe, spots
        )
        flux = spots[:, 5] * self._flux
        if lit is not None:
            flux *= np.asarray(lit, dtype=float)
        gain = self._gain(lens, spots, flux)
        return spots, gain * flux, gain

    def _gain(self, lens: np.void, spots: Array, flux: Array) -> float:
        appearance = self._appearance
        seen = np.array([in_image(lens, spot[0], spot[1], 0.0) for spot in spots])
        if appearance.auto_peak_levels is None:
            return 1.0
        blur2 = 2.0 * (appearance.psf_sigma_px**2 + 1.0 / 12.0)
        disc2 = np.maximum(spots[:, 2] * spots[:, 4], 1e-6)  # px^2, radius squared
        area = np.pi * disc2 / -np.expm1(-disc2 / blur2)
        peak = float(np.max(flux / area * seen, initial=0.0))
        lowest, highest = appearance.gain_range
        return highest if peak <= 0.0 else float(np.clip(appearance.auto_peak_levels / peak, lowest, highest))

    def _expose(self, image: Image, light: Array, box: np.ndarray, rng: np.random.Generator) -> None:
        appearance, (rows, columns) = self._appearance, image.shape
        u, v = np.arange(box[0], box[2]), np.arange(box[1], box[3])
        window = slice(box[1], box[3]), slice(box[0], box[2])
        slope_u = appearance.gradient_levels[0] / columns * (u - 0.5 * (columns - 1))
        slope_v = appearance.gradient_levels[1] / rows * (v - 0.5 * (rows - 1))
        mean = np.maximum(appearance.background_levels + slope_v[:, None] + slope_u, 0.0) + light[window]
        level = rng.poisson(mean * appearance.electrons_per_level) / appearance.electrons_per_level
        level += appearance.read_noise_levels * rng.standard_normal(mean.shape)
        image[window] = np.clip(np.rint(level), 0.0, FULL_SCALE)
