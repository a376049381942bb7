"""Flicker of LEDs that are fed by pulses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.vmu.flicker import Flicker
from hil.vmu.kernels.records import SPOT
from hil.vmu.unit import VisionUnit
from tests.support.vmu_disturbances import VERY_GOOD, known_geometry, real_bench
from tests.support.vmu_pixels import PixelOptics


def lights(rng: np.random.Generator, hz: float, row_s: float, images: int) -> list[np.ndarray]:
    """Return the lights of a ring of eight LEDs that turns, in images that begin at random times."""
    out, middle = [], rng.uniform(300.0, 700.0)
    for _ in range(images):
        spots = np.zeros(8, SPOT)
        spots["v"] = middle + 120.0 * np.cos(np.arange(8) * 0.785 + rng.uniform(0.0, 6.3))
        wave = np.cos(2.0 * np.pi * (hz * row_s * spots["v"] + rng.random()))
        spots["flux"] = 1000.0 * np.clip(0.5 + wave, 0.02, None) * rng.uniform(0.2, 1.0)
        out.append(spots)
    return out


@pytest.mark.parametrize("hz", [250.0, 1000.0, 3000.0])
def test_frequency_of_the_pulses_follows_from_the_rows(hz: float, rng: np.random.Generator) -> None:
    camera = Flicker(15e-6)
    for spots in lights(rng, hz, 15e-6, 24):
        camera.add(spots)
    text = camera.reason()
    assert text.endswith("? Use DC, or expose whole periods")
    value, unit = text.partition("about ")[2].partition("?")[0].split()
    assert float(value) * (1e3 if unit == "kHz" else 1.0) == pytest.approx(hz, rel=0.06)


def test_steady_leds_of_which_some_are_hidden_do_not_flicker(rng: np.random.Generator) -> None:
    camera = Flicker(15e-6)
    for k in range(24):
        spots = np.zeros(3 if 8 < k < 14 else 6, SPOT)
        spots["flux"] = 1000.0 * rng.uniform(0.95, 1.05, len(spots))
        camera.add(spots)
    assert camera.reason() == ""


def test_lights_of_other_scenes_do_not_flicker(rng: np.random.Generator) -> None:
    camera = Flicker(0.0)
    for k in range(24):
        spots = np.zeros(6, SPOT)
        spots["u"], spots["v"] = rng.uniform(100.0, 900.0, (2, 1)) + rng.uniform(-50.0, 50.0, (2, 6))
        spots["flux"] = 1000.0 if k % 2 else 300.0
        camera.add(spots)
    assert camera.reason() == ""


def test_refused_pair_of_flickering_leds_has_the_reason(rng: np.random.Generator) -> None:
    unit, texts = VisionUnit(known_geometry(VERY_GOOD)), []
    scene = real_bench(VERY_GOOD, rng, PixelOptics())
    for k in range(8):
        lit = scene if k % 2 == 0 else replace(scene, leds_m=scene.leds_m[:1])
        solution = unit.solve(*lit.pair(np.zeros(3), np.array([0.1, 0.0, 3.0]), rng), 2.0 * k)
        texts.append("" if solution.status == "ok" else str(solution.doubt))
    assert texts[1].startswith("1 and 1 lights")
    assert texts[7].startswith("LEDs flicker, 1")
    assert len(texts[7]) <= 80
