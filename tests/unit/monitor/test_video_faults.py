"""Docking monitor and faults of the video: frozen, displaced and lost images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.sources import VideoFrame
from tests.support.monitor_disturbances import MONITOR_ROWS
from tests.support.tv_pixels import Image, TvCamera, TvTarget

BY_NAME = {row.name: row for row in MONITOR_ROWS}
SCENE = load_scene("atv").value


@pytest.fixture(scope="module")
def image() -> Image:
    place = np.array([0.1, -0.1, 5.0]), np.array([0.01, 0.0, 0.1])
    return TvTarget(SCENE, TvCamera()).frame(lambda _: place, 0.0, np.random.default_rng(3))


@pytest.mark.parametrize("name", ["video frozen for 5 of 10 frames", "vertical sync lost in 3 of 10 frames"])
def test_frames_with_a_fault_are_left_out_of_a_portion(name: str) -> None:
    tally = BY_NAME[name].run(1, 4)
    assert tally.statuses == {"near": 1}
    assert tally.consistent == 1, tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


def test_many_images_lost_without_a_gap_are_found_by_the_motion() -> None:
    tally = BY_NAME["30 % of the frames lost"].run(1, 5)
    assert tally.measured == 1, tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


def test_sigma_of_the_range_rate_includes_a_wrong_image_rate_that_is_stated() -> None:
    row = BY_NAME["23.976 images per second taken for 25, stated"]
    stated, exact = row.run(2, 6), replace(row, stated=None).run(2, 6)
    assert stated.measured == exact.measured == 2
    assert np.abs(np.concatenate(stated.ratios)).max() < 4.5, stated.line()
    assert np.abs(np.concatenate(exact.ratios)).max() > 5.0, exact.line()


def test_frozen_image_is_named(image: Image) -> None:
    monitor = DockingMonitor(SCENE)
    noisy = np.clip(image.astype(int) + np.random.default_rng(1).integers(-1, 2, image.shape), 0, 255).astype(np.uint8)
    said = []
    for number, shown in enumerate((image, image, image.copy(), noisy, image)):
        monitor.feed(VideoFrame(number, number / SCENE.fps, shown))
        assert monitor.last is not None
        said.append(monitor.last.status)
    assert said == ["near", "rejected_frozen", "rejected_frozen", "near", "near"]
    assert dict(monitor.finish()[0].reasons) == {"equal to the image before": 2}


def test_fields_are_compared_with_the_one_of_the_same_lines_before(image: Image) -> None:
    """The fields of a still image without noise are alike, and no fault."""
    monitor = DockingMonitor(SCENE.model_copy(update={"fields": "upper_first"}))
    image = image.copy()
    image[1::2] = image[0::2]
    monitor.feed(image)
    assert monitor.last is not None
    assert monitor.last.status == "near"


def test_portion_in_which_at_most_half_of_the_images_agree_is_refused() -> None:
    row = replace(BY_NAME["vertical sync lost in 3 of 10 frames"], unsynced=9)
    assert row.run(1, 4).statuses["rejected_displaced"] == 1
