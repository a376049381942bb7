"""Rows of the vision unit with more light than the LEDs: what takes longest to measure and to search."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter

from tests.support.disturbance_verdicts import Expectation
from tests.support.vmu_disturbances import VERY_GOOD, Frame, Frames, Row, real_bench, somewhere
from tests.support.vmu_lab import SIZE
from tests.support.vmu_pixels import Array, PixelOptics

FULL = 255.0
_V, _U = np.mgrid[0:SIZE, 0:SIZE].astype(float)
Sensor = Callable[[Array], Array]


def smear(part: float) -> Sensor:
    """Return a frame-transfer CCD, in which each pixel's light leaves ``part`` of it in its whole column."""
    return lambda light: light + part * light.sum(axis=0)


def bloom(light: Array) -> Array:
    """Return the light of a CCD without anti-blooming: what is beyond full scale flows up and down its column."""
    out = light.copy()
    for u in np.flatnonzero((light > FULL).any(axis=0)):
        column = out[:, u]
        for step in (1, -1):
            over = 0.0
            for v in range(SIZE) if step == 1 else range(SIZE - 1, -1, -1):
                excess = 0.5 * max(light[v, u] - FULL, 0.0)
                taken = min(over, max(FULL + 1.0 - column[v], 0.0))
                column[v] += taken
                over += excess - taken
    return out


def band(rng: np.random.Generator) -> Sensor:
    """Return a rolling shutter in light that follows the mains, or a sensor with a band of interference."""
    period, levels, phase = rng.uniform(15.0, 120.0), rng.uniform(6.0, 40.0), rng.uniform(0.0, 6.3)
    if rng.random() < 0.5:
        return lambda light: light + levels * (1.0 + np.sin(2.0 * np.pi * _V / period + phase))
    top, high = rng.uniform(100.0, 700.0), rng.uniform(60.0, 250.0)
    inside = ((top < _V) & (top + high > _V)) * (1.0 + np.sin(_U * rng.uniform(0.05, 1.0) + _V * rng.uniform(0.5, 2.0)))
    return lambda light: light + levels * inside


def exposed(sensor: Callable[[np.random.Generator], Sensor], peak: tuple[float, float]) -> Frames:
    """Return frames of a sensor with LEDs of ``peak`` levels, least and most."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = (
                real_bench(VERY_GOOD, rng, PixelOptics(peak_levels=rng.uniform(*peak))),
                somewhere(rng, 1.0, 7.0),
            )
            yield replace(scene, sensor=sensor(rng)), truth

    return frames


def dust(number: int) -> Frames:
    """Return frames behind a dusty pane in side light: ``number`` discs out of focus, others in each camera."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 7.0)
            radius = rng.uniform(6.0, 30.0)
            panes = []
            for _side in range(2):
                levels = np.zeros((SIZE, SIZE))
                for u, v in rng.uniform(0.0, SIZE, (number, 2)):
                    levels += rng.uniform(3.0, 25.0) * (np.hypot(_U - u, _V - v) < radius * rng.uniform(0.7, 1.3))
                panes.append((gaussian_filter(levels, 1.0), np.ones((SIZE, SIZE))))
            yield replace(scene, backdrop=tuple(panes)), truth

    return frames


def specks(number: int) -> Frames:
    """Return frames with ``number`` specks of dust in the air before each camera, small and weak to bright."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 7.0)
            glare = [
                np.column_stack([rng.uniform(5.0, SIZE - 5.0, (number, 2)), np.exp(rng.uniform(-4.0, 0.3, number))])
                for _ in range(2)
            ]
            yield replace(scene, glare=(glare[0], glare[1])), truth

    return frames


def sparkle(number: int) -> Frames:
    """Return frames of a ring on crumpled insulation: ``number`` glints on it, some seen by one camera alone."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 1.0, 5.0)
            both = truth.t_v + rng.uniform(-0.35, 0.35, (number // 2, 3)) * [1.0, 1.0, 0.2]
            glare = []
            for camera in (scene.left, scene.right):
                own = truth.t_v + rng.uniform(-0.35, 0.35, (number // 2, 3)) * [1.0, 1.0, 0.2]
                glare.append(np.column_stack([camera.pixels(own), np.exp(rng.normal(-1.2, 0.9, number // 2))]))
            lights = np.column_stack([both, np.exp(rng.normal(-1.2, 0.9, number // 2))])
            yield replace(scene, lights_v=lights, glare=(glare[0], glare[1])), truth

    return frames


_SOME = Expectation(solved=0.0, drawn=False)  # none is wrong, and none takes long

CROWDED_ROWS = (
    Row(
        "smear of a CCD, LEDs overexposed", VERY_GOOD, exposed(lambda _: smear(0.004), (600.0, 2500.0)), expected=_SOME
    ),
    Row("smear of a CCD", VERY_GOOD, exposed(lambda _: smear(0.02), (120.0, 240.0)), expected=_SOME),
    Row("blooming", VERY_GOOD, exposed(lambda _: bloom, (600.0, 4000.0)), expected=_SOME),
    Row("bands of mains light", VERY_GOOD, exposed(band, (90.0, 200.0)), expected=_SOME),
    Row("dust on a pane, 40 discs", VERY_GOOD, dust(40), expected=_SOME),
    Row("dust on a pane, 150 discs", VERY_GOOD, dust(150), expected=_SOME),
    Row("dust in the air, 60 specks", VERY_GOOD, specks(60), expected=_SOME),
    Row("dust in the air, 250 specks", VERY_GOOD, specks(250), expected=_SOME),
    Row("sparkle, 40 glints", VERY_GOOD, sparkle(40), expected=_SOME),
    Row("sparkle, 120 glints", VERY_GOOD, sparkle(120), expected=_SOME),
)
