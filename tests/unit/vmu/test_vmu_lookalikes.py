"""Vision unit before scenes with something that looks like the ring: no pose of the wrong lights is ``ok``."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.vmu.unit import VisionUnit
from tests.support.vmu_disturbances import (
    USUAL,
    VERY_GOOD,
    Row,
    known_geometry,
    real_bench,
    somewhere,
)
from tests.support.vmu_lookalikes import LOOKALIKE_ROWS, mirror_behind, other_scale
from tests.support.vmu_pixels import Image, PixelOptics

BY_NAME = {row.name: row for row in LOOKALIKE_ROWS}


@pytest.mark.parametrize(
    "name",
    [
        "two LEDs hidden, reflection of 80 %",
        "two LEDs hidden, reflection of 100 %",
        "second ring 1.5 m behind",
        "second ring beside",
    ],
)
def test_two_patterns_without_a_track_are_ambiguous_whichever_is_more_complete(name: str) -> None:
    tally = BY_NAME[name].run(3, 3)
    assert tally.statuses == {"ambiguous": 3}, tally.line()


def test_track_is_kept_while_its_own_leds_are_where_they_are_expected() -> None:
    """The reflection has all LEDs in every frame, the ring four."""
    tally = BY_NAME["reflection of 80 %, tracked"].run(4, 5)
    assert tally.solved == 4, tally.line()
    assert np.abs(tally.ratios).max() < 4.5


@pytest.mark.parametrize("name", [row.name for row in LOOKALIKE_ROWS if row.name.startswith("plate")])
def test_pose_of_a_ring_before_a_mirroring_plate_is_not_ok_beyond_its_sigmas(name: str) -> None:
    tally = BY_NAME[name].run(5, 2)
    assert not tally.ratios or np.abs(tally.ratios).max() < 5.0, tally.line()


def test_ring_before_a_mirroring_plate_is_suspect_with_what_shows_it() -> None:
    """Either the raised LED's reflection is a light of its own, or it makes the LED's spot longer than the others'."""
    rng, unit, doubts = np.random.default_rng([0, 20]), VisionUnit(known_geometry(VERY_GOOD)), set()
    for scene, truth in mirror_behind(0.03, 0.4, 6.0, 12.0)(rng, 6):
        unit.track.drop()
        solution = unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
        assert solution.status != "ok"
        assert solution.frame(0, 0.0) is None
        doubts.add(solution.doubt and solution.doubt.what)
    assert {"reflection", "doubled_lights"} < doubts
    unit.track.drop()
    assert unit.solve(*replace(scene, lights_v=np.zeros((0, 4))).pair(truth.turn, truth.t_v, rng), 0.0).status == "ok"


@pytest.mark.parametrize("scale", [{"focal": 0.005}, {"focal": -0.005}, {"ring": 0.01}, {"ring": -0.01}])
def test_common_scale_that_is_not_stated_is_within_the_default_tolerances(scale: dict[str, float]) -> None:
    tally = Row("", None, other_scale(**scale)).run(6, 1)
    assert tally.solved >= 5, tally.line()
    assert np.abs(tally.ratios).max() < 5.0, tally.line()
    exact = Row("", replace(USUAL, focal_scale=0.0, led_scale=0.0), other_scale(**scale)).run(6, 1)
    assert np.abs(exact.ratios).max() > 1.5 * np.abs(tally.ratios).max()  # the tolerances are what covers it


def with_clusters(image: Image, count: int, rng: np.random.Generator) -> Image:
    """Return ``image`` with ``count`` hot clusters of 2 x 2 pixels."""
    levels = image.astype(float)
    for u, v in rng.integers(2, np.array(image.shape)[::-1] - 4, (count, 2)):
        levels[v : v + 2, u : u + 2] += rng.uniform(40.0, 240.0, (2, 2))
    return np.asarray(np.clip(levels, 0.0, 255.0).astype(np.uint8))


@pytest.mark.parametrize(
    ("clusters", "lit", "status"),
    [(300, 6, "ok"), (300, 0, "rejected_no_match"), (1500, 6, "rejected_crowded"), (0, 0, "rejected_dark")],
)
def test_hot_clusters_do_not_make_an_image_dark(clusters: int, lit: int, status: str) -> None:
    unit, rng = VisionUnit(known_geometry(VERY_GOOD)), np.random.default_rng(4)
    for _ in range(2):
        scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng)
        pair = replace(scene, leds_m=scene.leds_m[:lit]).pair(truth.turn, truth.t_v, rng)
        unit.track.drop()
        solution = unit.solve(*(with_clusters(image, clusters, rng) for image in pair), 0.0)
        assert solution.status == status
        if solution.pose is not None:
            assert np.abs(truth.error(solution) / np.sqrt(np.diag(solution.covariance))).max() < 4.5
