"""Consistency of many poses with the geometry file, on spots of a camera that shares no mathematics with the unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hil.vmu.kernels.records import SPOT
from hil.vmu.unit import Solution, VisionUnit
from tests.support.vmu_disturbances import (
    PERIOD_S,
    USUAL,
    VERY_GOOD,
    CalibrationErrors,
    Pose,
    approach,
    known_geometry,
    real_bench,
    somewhere,
)
from tests.support.vmu_lookalikes import in_space
from tests.support.vmu_pixels import PixelOptics, PixelScene

NOISE_PX = 0.02


def solutions(
    stated: CalibrationErrors | None, errors: CalibrationErrors, frames: int, seed: int,
    change: Callable[[PixelScene], PixelScene] = lambda scene: scene,
) -> list[Solution]:  # fmt: skip
    """Return the solutions of an approach of one bench, ``change`` of which the geometry file does not state."""
    rng, unit, found = np.random.default_rng([seed, 3]), VisionUnit(known_geometry(stated)), []
    for k, (scene, truth) in enumerate(approach(errors)(rng, frames)):
        found.append(unit.solve_spots(*spots_of(change(scene), truth, rng), PERIOD_S * k))
    return found


def spots_of(scene: PixelScene, truth: Pose, rng: np.random.Generator) -> list[np.ndarray]:
    """Return the spots of both images."""
    spots = []
    for camera in (scene.left, scene.right):
        pixels = camera.pixels(in_space(scene.leds_m, truth))
        rows = np.zeros(len(pixels), SPOT)
        rows["u"], rows["v"] = (pixels + NOISE_PX * rng.standard_normal(pixels.shape)).T
        rows["var_u"] = rows["var_v"] = NOISE_PX**2
        rows["flux"], rows["size"] = 1000.0, 1.2
        spots.append(rows)
    return spots


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


def test_poses_of_different_benches_are_not_compared() -> None:
    """Each track has a bench of its own: what they contradict is each other, not the geometry file."""
    unit, rng = VisionUnit(known_geometry(USUAL)), np.random.default_rng(5)
    for k in range(40):
        scene, truth = real_bench(USUAL, rng, PixelOptics()), somewhere(rng, 1.5, 4.0)
        unit.track.drop()
        assert unit.solve_spots(*spots_of(scene, truth, rng), PERIOD_S * k).doubt is None
