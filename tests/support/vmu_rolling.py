"""Images of a ring that moves, by a camera with a rolling shutter: each row of pixels sees it at its own moment."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.vmu_disturbances import PERIOD_S, VERY_GOOD, Frame, Frames, Pose, real_bench, somewhere
from tests.support.vmu_pixels import FINE, Array, Image, PixelOptics, PixelScene, _sunflower

TOP_DOWN_S = 30e-6
"""From one row to the next."""


@dataclass(frozen=True)
class RollingScene(PixelScene):
    """A bench whose rows are exposed one after the other, the middle one at the pose given to ``image``.

    speed: (3,), m/s, and rate: (3,), rad/s, of the ring in the left camera's axes. row_s: from one row to the next.
    """

    speed: Array = field(kw_only=True)
    rate: Array = field(kw_only=True)
    row_s: float = field(default=TOP_DOWN_S, kw_only=True)

    def pose_at(self, turn: Array, t_v: Array, later_s: float) -> tuple[Rotation, Array]:
        """Return attitude and position ``later_s`` after those given."""
        return Rotation.from_rotvec(later_s * self.rate) * Rotation.from_rotvec(turn), t_v + later_s * self.speed

    def image(self, side: int, turn: Array, t_v: Array, rng: np.random.Generator) -> Image:
        """Return one camera's image: every row of pixels is rendered on its own."""
        camera, optics = (self.left, self.right)[side], self.optics
        light = np.zeros((camera.height, camera.width))
        radius_px = 0.5 * optics.led_diameter_m * camera.fx / float(np.linalg.norm(t_v))
        total = optics.peak_levels * 2.0 * np.pi * (optics.blur_px**2 + 0.25 * radius_px**2)
        disc = _sunflower(0.5 * optics.led_diameter_m)
        offset = (np.arange(FINE) + 0.5) / FINE - 0.5
        middle, span = 0.5 * (camera.height - 1), 0.5 * camera.height * abs(self.row_s)
        for led in self.leds_m:
            on_ring = led + np.column_stack([disc, np.zeros(len(disc))])
            reached = []
            for later_s in (-span, 0.0, span):
                rotation, t = self.pose_at(turn, t_v, later_s)
                reached.append(camera.pixels(rotation.apply(on_ring) + t))
            places, reach = np.concatenate(reached), 5.0 * optics.blur_px + 2.0
            if not np.isfinite(places).all():
                continue
            (u0, v0), (u1, v1) = (places.min(axis=0) - reach).astype(int), (places.max(axis=0) + reach + 1).astype(int)
            u0, v0, u1, v1 = max(u0, 0), max(v0, 0), min(u1, camera.width), min(v1, camera.height)
            if u1 <= u0 or v1 <= v0:
                continue
            u = (np.arange(u0, u1)[:, None] + offset).ravel()
            for v in range(v0, v1):
                rotation, t = self.pose_at(turn, t_v, self.row_s * (v - middle))
                points = camera.pixels(rotation.apply(on_ring) + t)
                if np.abs(points[:, 1] - v).min() > reach:
                    continue
                down = np.exp(-0.5 * ((v + offset[:, None] - points[:, 1]) / optics.blur_px) ** 2)
                across = np.exp(-0.5 * ((u[:, None] - points[:, 0]) / optics.blur_px) ** 2)
                fine = (down @ across.T) / (2.0 * np.pi * optics.blur_px**2 * len(points))
                light[v, u0:u1] += total * fine.reshape(FINE, u1 - u0, FINE).mean(axis=(0, 2))
        light += optics.background_levels
        variance = light / optics.electrons_per_level + optics.read_noise_levels**2
        levels = light + np.sqrt(variance) * rng.standard_normal(light.shape, dtype=np.float32)
        return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def drawn_rolling(speed_mps: float, rate_degps: float, row_s: float = TOP_DOWN_S, near_m: float = 0.8) -> Frames:
    """Return frames that each have a bench, a pose, and a motion of this size in a direction of their own."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, near_m, 6.0)
            yield _moving(scene, speed_mps * _direction(rng), np.radians(rate_degps) * _direction(rng), row_s), truth

    return frames


def rolling_approach(speed_mps: float, rate_degps: float, row_s: float = TOP_DOWN_S) -> Frames:
    """Return frames of a bench at a constant velocity and rate, for a track; the ring stays in view."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        scene, last = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 3.0, 10.0)
        speed = speed_mps * np.array([*rng.uniform(-0.3, 0.3, 2), -1.0])
        rate = np.radians(rate_degps) * np.array([*rng.uniform(-0.2, 0.2, 2), rng.choice([-1.0, 1.0])])
        moving = _moving(scene, speed, rate, row_s)
        for k in range(count):
            turn, t_v = moving.pose_at(last.turn, last.t_v, PERIOD_S * (k - count + 1))
            yield moving, Pose(turn.as_rotvec(), t_v)

    return frames


def _moving(scene: PixelScene, speed: Array, rate: Array, row_s: float) -> RollingScene:
    return RollingScene(scene.left, scene.right, scene.leds_m, scene.optics, speed=speed, rate=rate, row_s=row_s)


def _direction(rng: np.random.Generator) -> Array:
    found = rng.standard_normal(3)
    return np.asarray(found / np.linalg.norm(found))
