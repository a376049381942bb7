"""Consistency of many poses with the geometry file, on spots of a camera that shares no mathematics with the unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hil.vmu.kernels.records import SPOT
from hil.vmu.unit import Solution, VisionUnit
from tests.support.vmu_disturbances import PERIOD_S, USUAL, VERY_GOOD, CalibrationErrors, approach, known_geometry
from tests.support.vmu_lookalikes import in_space
from tests.support.vmu_pixels import PixelScene

NOISE_PX = 0.02


def solutions(
    stated: CalibrationErrors | None, errors: CalibrationErrors, frames: int, seed: int,
    change: Callable[[PixelScene], PixelScene] = lambda scene: scene,
) -> list[Solution]:  # fmt: skip
    """Return the solutions of an approach of one bench, ``change`` of which the geometry file does not state."""
    rng, unit, found = np.random.default_rng([seed, 3]), VisionUnit(known_geometry(stated)), []
    for k, (scene, truth) in enumerate(approach(errors)(rng, frames)):
        real, spots = change(scene), []
        for camera in (real.left, real.right):
            pixels = camera.pixels(in_space(real.leds_m, truth))
            rows = np.zeros(len(pixels), SPOT)
            rows["u"], rows["v"] = (pixels + NOISE_PX * rng.standard_normal(pixels.shape)).T
            rows["var_u"] = rows["var_v"] = NOISE_PX**2
            rows["flux"], rows["size"] = 1000.0, 1.2
            spots.append(rows)
        found.append(unit.solve_spots(spots[0], spots[1], PERIOD_S * k))
    return found


def test_ring_of_another_size_that_each_pair_hides_is_suspect_and_then_refused() -> None:
    """3 % of the size is within the tolerances of a single pair from 4 m, with the noise and a floor."""
    found = solutions(None, USUAL, 80, 1, lambda scene: replace(scene, leds_m=1.03 * scene.leds_m))
    statuses = [solution.status for solution in found]
    first = statuses.index("suspect")
    doubt = found[first].doubt
    assert doubt is not None
    assert (doubt.what, doubt.unit) == ("size_against_disparity", "%")
    assert 2.0 < doubt.amount < 3.5
    assert found[first].pose is not None
    assert found[first].frame(0, 0.0) is None
    assert "ok" not in statuses[first:]
    assert "rejected_geometry_file" in statuses[first:]


def test_errors_within_the_tolerances_are_never_suspect() -> None:
    for seed in range(2):
        assert all(solution.doubt is None for solution in solutions(VERY_GOOD, VERY_GOOD, 50, seed))
    assert all(solution.doubt is None for solution in solutions(None, USUAL, 50, 0))
