"""Layouts of 4 to 16 LEDs: solved without a track, within their sigmas, from near to where they merge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.vmu.unit import VisionUnit
from tests.support.vmu_disturbances import VERY_GOOD, Tally, known_geometry, real_bench, somewhere
from tests.support.vmu_pixels import Array, PixelOptics


def ring_of(count: int) -> Array:
    """Return LEDs on a circle of 0.24 m, two of them raised."""
    angles = 2.0 * np.pi * np.arange(count) / count
    leds = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.zeros(count)])
    leds[0, 2], leds[2, 2] = -0.06, -0.03
    return leds


def grid_of(side: int) -> Array:
    """Return ``side`` times ``side`` LEDs over 0.3 m, not quite regular, some of them raised."""
    rng = np.random.default_rng(side)
    steps = 0.3 * np.arange(side) / (side - 1) - 0.15
    flat = np.array([(x, y) for x in steps for y in steps]) + rng.uniform(-0.01, 0.01, (side * side, 2))
    return np.column_stack([flat, -0.05 * rng.integers(0, 2, side * side)])


@pytest.mark.parametrize(("near_m", "far_m"), [(0.6, 2.0), (8.0, 18.0)])
@pytest.mark.parametrize("leds", [ring_of(4), ring_of(6), ring_of(9), grid_of(3), grid_of(4)], ids=len)
def test_layout_is_solved_within_its_sigmas(leds: Array, near_m: float, far_m: float) -> None:
    known = known_geometry(VERY_GOOD).model_copy(update={"leds_m": tuple(map(tuple, leds.tolist()))})
    unit, rng, tally = VisionUnit(known), np.random.default_rng([len(leds), 5]), Tally()
    for _ in range(4):
        scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, near_m, far_m)
        scene = replace(scene, leds_m=leds + 5e-5 * rng.standard_normal(leds.shape))
        unit.track.drop()
        solution = unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
        tally.add(solution, truth, 0.0)
    assert tally.solved == 4, tally.line()
    assert np.abs(tally.ratios).max() < 4.5, tally.line()
    assert bin(solution.bits(0)).count("1") == len(leds)
