"""Rows of scenes in which something looks right and is not: a reflection of the ring, a second ring."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.support.disturbance_verdicts import Expectation
from tests.support.vmu_disturbances import (
    USUAL,
    VERY_GOOD,
    Frame,
    Frames,
    Pose,
    Row,
    approach,
    real_bench,
    somewhere,
)
from tests.support.vmu_pixels import Array, PixelOptics, PixelScene

ALL_LIT = (0, 1, 2, 3, 4, 5)


def in_space(leds_m: Array, truth: Pose) -> Array:
    """Return points (n, 3) of the ring's frame in the left camera's axes, m."""
    return np.asarray(Rotation.from_rotvec(truth.turn).apply(leds_m) + truth.t_v)


def reflected(scene: PixelScene, truth: Pose, below_m: float, brightness: float, lit: tuple[int, ...]) -> PixelScene:
    """Return the scene with a level mirror ``below_m`` below the ring's centre, and only the LEDs ``lit``.

    Those that are not lit are hidden from the cameras, not from the mirror.
    """
    image = in_space(scene.leds_m, truth)
    image[:, 1] = 2.0 * (truth.t_v[1] + below_m) - image[:, 1]
    lights = np.column_stack([image, np.full(len(image), brightness)])
    return replace(scene, leds_m=scene.leds_m[list(lit)], lights_v=lights)


def hidden_by_arm(rng: np.random.Generator) -> tuple[int, ...]:
    """Return the LEDs that remain if two are hidden."""
    return tuple(sorted(rng.choice(6, 4, replace=False).tolist()))


def reflections(below_m: float, brightness: float) -> Frames:
    """Return frames of a ring with two hidden LEDs above its complete reflection."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.5, 6.0)
            yield reflected(scene, truth, below_m, brightness, hidden_by_arm(rng)), truth

    return frames


def reflection_on_track(below_m: float, brightness: float, lead_in: int) -> Frames:
    """Return an approach in which, after ``lead_in`` frames, two LEDs are hidden and the ring is reflected."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        lit = hidden_by_arm(rng)
        for k, (scene, truth) in enumerate(approach(VERY_GOOD)(rng, count)):
            yield (scene if k < lead_in else reflected(scene, truth, below_m, brightness, lit)), truth

    return frames


def second_ring(behind_m: float) -> Frames:
    """Return frames of two equal rings, the other one ``behind_m`` behind, aside and turned."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.5, 5.0)
            aside = np.array([*rng.uniform(-0.3, 0.3, 2), behind_m])
            turn = Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)]) * Rotation.from_rotvec(truth.turn)
            other = Pose(turn.as_rotvec(), truth.t_v + aside)
            lights = np.column_stack([in_space(scene.leds_m, other), np.ones(len(scene.leds_m))])
            yield replace(scene, lights_v=lights), truth

    return frames


def mirror_behind(depth_m: float, brightness: float, near_m: float = 1.0, far_m: float = 6.0) -> Frames:
    """Return frames of a ring before a plate that mirrors the LEDs, parallel to it and ``depth_m`` behind it."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, near_m, far_m)
            image = scene.leds_m * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * depth_m]
            lights = np.column_stack([in_space(image, truth), np.full(len(image), brightness)])
            yield replace(scene, lights_v=lights), truth

    return frames


def other_scale(focal: float = 0.0, ring: float = 0.0) -> Frames:
    """Return frames whose focal lengths, or whose ring, are larger than in the geometry file, relative."""
    errors = replace(USUAL, focal_scale=0.0, led_scale=0.0)

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(errors, rng, PixelOptics()), somewhere(rng)
            left, right = (
                replace(camera, fx=(1.0 + focal) * camera.fx, fy=(1.0 + focal) * camera.fy)
                for camera in (scene.left, scene.right)
            )
            yield replace(scene, left=left, right=right, leds_m=(1.0 + ring) * scene.leds_m), truth

    return frames


_EITHER = Expectation(refused=("ambiguous",))
_MIRRORED = Expectation(refused=("ambiguous", "suspect", "rejected_geometry_file", "rejected_sync"))

LOOKALIKE_ROWS = (
    Row("two LEDs hidden, reflection of 80 %", VERY_GOOD, reflections(0.15, 0.8), expected=_EITHER),
    Row("two LEDs hidden, reflection of 100 %", VERY_GOOD, reflections(0.2, 1.0), expected=_EITHER),
    Row(
        "reflection of 80 %, tracked", VERY_GOOD, reflection_on_track(0.15, 0.8, 10), tracked=True, piece=8,
        lead_in=10,
    ),
    Row("second ring 1.5 m behind", VERY_GOOD, second_ring(1.5), expected=_EITHER),
    Row("second ring beside", VERY_GOOD, second_ring(0.0), expected=_EITHER),
    *(
        Row(f"plate {100 * depth:.0f} cm behind, {100 * brightness:.0f} %", VERY_GOOD, mirror_behind(depth, brightness),
            expected=_MIRRORED)
        for depth, brightness in ((0.03, 0.4), (0.03, 0.2), (0.03, 0.6), (0.01, 0.4), (0.06, 0.4))
    ),
    *(
        Row(f"plate {100 * depth:.0f} cm behind, {100 * brightness:.0f} %, 6 to 12 m", VERY_GOOD,
            mirror_behind(depth, brightness, 6.0, 12.0), expected=_MIRRORED)
        for depth, brightness in ((0.03, 0.2), (0.01, 0.2), (0.03, 0.4))
    ),
    Row("focal lengths 0.5 % longer, not stated", None, other_scale(focal=0.005), expected=Expectation(drawn=False)),
    Row("ring 0.5 % larger, not stated", None, other_scale(ring=0.005), expected=Expectation(drawn=False)),
)  # fmt: skip
