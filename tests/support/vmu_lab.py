"""Rows of a real laboratory for the vision unit: backgrounds with steps, ghosts of the lens, twins of the ring."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.support.disturbance_verdicts import Expectation
from tests.support.vmu_disturbances import (
    USUAL,
    VERY_GOOD,
    Frame,
    Frames,
    Row,
    approach,
    each_bench,
    real_bench,
    somewhere,
)
from tests.support.vmu_lookalikes import in_space, reflected
from tests.support.vmu_pixels import Array, PixelOptics, turned

SIZE = 1024
Backdrop = Callable[[np.random.Generator], tuple[Array, Array]]
"""Levels of the background (h, w) in the left image, and the fraction (h, w) of the light that reaches the sensor."""

_V, _U = np.mgrid[0:SIZE, 0:SIZE].astype(float)
_ALL = np.ones((SIZE, SIZE))


def _side(rng: np.random.Generator, along_u: bool) -> Array:
    """Return 0 to 1 on both sides of a nearly straight edge through the middle of the image, blurred by 1 to 2 px."""
    across, along = (_U, _V) if along_u else (_V, _U)
    edge = rng.uniform(0.3, 0.7) * SIZE + rng.uniform(-0.06, 0.06) * (along - 0.5 * SIZE)
    return np.asarray(np.clip((across - edge) / rng.uniform(1.0, 3.0) + 0.5, 0.0, 1.0))


def curtain(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a dark curtain next to a lit wall."""
    return rng.uniform(5.0, 15.0) + rng.uniform(40.0, 130.0) * _side(rng, True), _ALL


def horizon(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a dark floor below a lit wall."""
    return rng.uniform(8.0, 20.0) + rng.uniform(40.0, 130.0) * (1.0 - _side(rng, False)), _ALL


def border(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a black border of about 32 px."""
    width = rng.uniform(16.0, 64.0)
    seen = np.minimum(np.minimum(_U, SIZE - 1 - _U), np.minimum(_V, SIZE - 1 - _V)) >= width
    return np.full((SIZE, SIZE), rng.uniform(40.0, 130.0)), seen.astype(float)


def image_circle(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the image of a lens that does not cover the sensor."""
    away = np.hypot(_U - rng.uniform(490.0, 530.0), _V - rng.uniform(490.0, 530.0))
    seen = np.clip((rng.uniform(440.0, 520.0) - away) / rng.uniform(2.0, 12.0), 0.0, 1.0)
    return np.full((SIZE, SIZE), rng.uniform(40.0, 130.0)), np.asarray(seen)


def letterbox(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return black bars above and below."""
    seen = np.abs(_V - 0.5 * SIZE) < 0.5 * SIZE - rng.uniform(80.0, 200.0)
    return np.full((SIZE, SIZE), rng.uniform(40.0, 130.0)), seen.astype(float)


def window(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a bright window with bars."""
    u0, v0 = rng.uniform(50.0, 400.0, 2)
    inside = (u0 < _U) & (v0 < _V) & (u0 + rng.uniform(400.0, 600.0) > _U) & (v0 + rng.uniform(400.0, 600.0) > _V)
    pitch, bar = rng.uniform(110.0, 180.0), rng.uniform(12.0, 24.0)
    panes = inside & ((_U - u0) % pitch > bar) & ((_V - v0) % pitch > bar)
    return rng.uniform(8.0, 25.0) + rng.uniform(60.0, 130.0) * gaussian_filter(panes.astype(float), 1.0), _ALL


def door(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a bright doorway."""
    u0, wide, v0 = rng.uniform(200.0, 700.0), rng.uniform(120.0, 250.0), rng.uniform(100.0, 350.0)
    inside = (u0 < _U) & (u0 + wide > _U) & (v0 < _V)
    return rng.uniform(8.0, 25.0) + rng.uniform(60.0, 130.0) * gaussian_filter(inside.astype(float), 1.2), _ALL


def tubes(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return fluorescent tubes at full scale under the ceiling."""
    levels = np.full((SIZE, SIZE), rng.uniform(10.0, 30.0))
    for _ in range(3):
        u0, v0 = rng.uniform(0.0, 500.0), rng.uniform(20.0, 330.0)
        inside = (u0 < _U) & (u0 + rng.uniform(250.0, 450.0) > _U) & (np.abs(_V - v0) < rng.uniform(6.0, 14.0))
        levels += 400.0 * gaussian_filter(inside.astype(float), 1.5)
    return levels, _ALL


def checker(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a wall of dark and bright squares."""
    pitch, (u0, v0) = rng.uniform(110.0, 200.0), rng.uniform(0.0, 200.0, 2)
    squares = ((np.floor((_U + u0) / pitch) + np.floor((_V + v0) / pitch)) % 2.0).astype(float)
    return rng.uniform(10.0, 30.0) + rng.uniform(30.0, 90.0) * gaussian_filter(squares, 1.0), _ALL


def rectangles(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return rectangles of all sizes and levels, as of racks and boxes."""
    levels = np.full((SIZE, SIZE), rng.uniform(15.0, 60.0))
    for _ in range(40):
        (u0, v0), (wide, high) = rng.uniform(-60.0, SIZE, 2), np.exp(rng.uniform(np.log(40.0), np.log(300.0), 2))
        levels[int(max(v0, 0)) : int(max(v0 + high, 0)), int(max(u0, 0)) : int(max(u0 + wide, 0))] = rng.uniform(
            10, 110
        )
    return gaussian_filter(levels, 1.0), _ALL


def cables(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return bright and dark cables before a grey wall."""
    levels = np.full((SIZE, SIZE), rng.uniform(40.0, 70.0))
    for _ in range(8):
        angle, offset = rng.uniform(0.0, np.pi), rng.uniform(-350.0, 350.0)
        away = np.abs((_U - 512.0) * np.cos(angle) + (_V - 512.0) * np.sin(angle) - offset)
        levels += rng.choice([-30.0, 50.0]) * np.clip(rng.uniform(2.0, 5.0) - away + 0.5, 0.0, 1.0)
    return np.maximum(levels, 0.0), _ALL


def shaded_wall(rng: np.random.Generator) -> tuple[Array, Array]:
    """Return a wall lit from one side, with the shadow of a cabinet."""
    angle = rng.uniform(0.0, 2.0 * np.pi)
    slope = 0.5 + ((_U - 512.0) * np.cos(angle) + (_V - 512.0) * np.sin(angle)) / 1450.0
    shadow = (rng.uniform(200.0, 600.0) < _U) & (rng.uniform(200.0, 600.0) < _V)
    return rng.uniform(60.0, 130.0) * slope * (1.0 - 0.8 * gaussian_filter(shadow.astype(float), 2.0)) + 8.0, _ALL


BACKDROPS = {
    "curtain": curtain, "horizon": horizon, "border": border, "image circle": image_circle, "letterbox": letterbox,
    "window with bars": window, "doorway": door, "tubes": tubes, "squares": checker, "racks": rectangles,
    "cables": cables, "shadow on a wall": shaded_wall,
}  # fmt: skip


def backgrounds(draw: Backdrop) -> Frames:
    """Return frames before a background, which the right camera sees displaced as a whole."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 6.0)
            levels, seen = draw(rng)
            shift = int(rng.integers(20, 60))
            right = np.pad(levels, ((0, 0), (0, shift)), mode="edge")[:, shift:]
            optics = replace(scene.optics, background_levels=0.0, peak_levels=rng.uniform(90.0, 120.0))
            yield replace(scene, optics=optics, backdrop=((levels, seen), (right, seen))), truth

    return frames


def ghosts(part: float, magnification: float = -1.0) -> Frames:
    """Return frames in which each light has a ghost of ``part`` of it, mirrored at the centre of the image."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        middle = 511.5 + rng.uniform(-5.0, 5.0, (2, 2))
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 6.0)
            ghost = tuple((part, magnification, *centre) for centre in middle)
            yield replace(scene, ghost=ghost), truth

    return frames


def twins(rng: np.random.Generator, count: int) -> Iterable[Frame]:
    """Yield rings of which some LEDs are hidden, above the whole ring's reflection, near and far, weak and bright."""
    for _ in range(count):
        scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.5, 7.0)
        lit = tuple(sorted(rng.choice(6, int(rng.integers(3, 6)), replace=False).tolist()))
        yield reflected(scene, truth, rng.uniform(0.14, 0.4), rng.uniform(0.5, 1.3), lit), truth


def beside(rng: np.random.Generator, count: int) -> Iterable[Frame]:
    """Yield a ring of which some LEDs are hidden next to its complete image in a vertical mirror."""
    for _ in range(count):
        scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.5, 7.0)
        lit = rng.choice(6, int(rng.integers(3, 6)), replace=False)
        image = in_space(scene.leds_m, truth)
        image[:, 0] = 2.0 * (truth.t_v[0] + rng.choice([-1.0, 1.0]) * rng.uniform(0.14, 0.4)) - image[:, 0]
        lights = np.column_stack([image, np.full(6, rng.uniform(0.5, 1.3))])
        yield replace(scene, leds_m=scene.leds_m[np.sort(lit)], lights_v=lights), truth


def dead_leds(rng: np.random.Generator, count: int) -> Iterable[Frame]:
    """Yield rings with one or two dead LEDs and up to three other lights."""
    for _ in range(count):
        scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 7.0)
        lit = np.sort(rng.choice(6, int(rng.integers(4, 6)), replace=False))
        z, others = truth.t_v[2], int(rng.integers(0, 4))
        lights = np.column_stack([
            rng.uniform(-0.3, 0.3, (others, 2)) * z, rng.uniform(0.7, 1.3, others) * z, rng.uniform(0.3, 1.2, others)
        ])  # fmt: skip
        yield replace(scene, leds_m=scene.leds_m[lit], lights_v=lights), truth


def shaken(frames: Frames, sigma_px: float, alike: bool = False) -> Frames:
    """Return ``frames`` with both cameras turned in each pair otherwise, about their u and v axes."""

    def out(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for scene, truth in frames(rng, count):
            turns = np.zeros((2, 3))
            turns[:, :2] = rng.normal(0.0, sigma_px / scene.left.fx, (2, 2))
            left, right = turns[[0, 0]] if alike else turns
            yield replace(scene, left=turned(scene.left, left), right=turned(scene.right, right)), truth

    return out


_SOLVED = {"window with bars": 0.85, "cables": 0.85}  # LEDs on several bars or cables at once are lost
_EITHER = Expectation(refused=("ambiguous", "ok_position", "ok_sight", "too_few"))
_SHAKEN = Expectation(solved=0.8, drawn=False)
_VIBRATING = replace(USUAL, vibration_px=1.0)

LAB_ROWS = (
    *(
        Row(f"background: {name}", VERY_GOOD, backgrounds(draw), expected=Expectation(_SOLVED.get(name, 0.9)))
        for name, draw in BACKDROPS.items()
    ),
    Row("ghost of 20 %", VERY_GOOD, ghosts(0.2)),
    Row("ghost of 20 %, half the size", VERY_GOOD, ghosts(0.2, -0.5)),
    Row("ghost of 8 %, upright", VERY_GOOD, ghosts(0.08, 0.6)),
    Row("reflections below a ring with hidden LEDs", VERY_GOOD, twins, expected=_EITHER),
    Row("reflections beside a ring with hidden LEDs", VERY_GOOD, beside, expected=_EITHER),
    Row("one or two dead LEDs, up to three other lights", VERY_GOOD, dead_leds, expected=Expectation(0.6)),
    Row(
        "cameras vibrate by 1 px, tracked",
        USUAL,
        shaken(approach(USUAL), 1.0),
        tracked=True,
        piece=20,
        lead_in=4,
        expected=_SHAKEN,
    ),
    Row("cameras vibrate by 1 px, stated", _VIBRATING, shaken(each_bench(USUAL), 1.0), expected=_SHAKEN),
    Row(
        "cameras vibrate by 1 px alike, stated",
        _VIBRATING,
        shaken(each_bench(USUAL), 1.0, alike=True),
        expected=_SHAKEN,
    ),
)
