"""Docking monitor and repeated, displaced, lost frames, on images of a renderer by areas."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import CameraTolerances
from hil.parts.monitor.displacement import off_the_line, repeated
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.results import Result
from hil.parts.monitor.sources import VideoFrame
from tests.support.monitor_disturbances import EXACT, portion_truth, random_approach
from tests.support.tv_areas import AreaTarget, TargetErrors
from tests.support.tv_pixels import Image, TvCamera

SCENE = load_scene("atv").value
Shown = Callable[[int, list[Image], np.random.Generator], Image | None]


def with_noise(image: Image, rng: np.random.Generator) -> Image:
    return np.clip(np.rint(image + 1.5 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def largest_ratio(
    shown: Shown = lambda k, images, rng: images[k],
    seed: int = 1,
    camera: TvCamera | None = None,
    errors: TargetErrors | None = None,
    tolerances: CameraTolerances = EXACT,
) -> tuple[Result, float]:
    """Return a portion of ten images, and its largest error over sigma.

    shown: of the exposure k, with all images so far; None: lost.
    """
    known = SCENE.camera.model_copy(update={"tolerances": tolerances})
    scene, rng = SCENE.model_copy(update={"camera": known}), np.random.default_rng(seed)
    w, target, monitor = random_approach(rng), AreaTarget(scene, camera or TvCamera(), errors), DockingMonitor(scene)
    images: list[Image] = []
    k = number = 0
    while True:
        t_s = k / scene.fps
        images.append(target.frame(lambda t: (w[0:6:2] + t * w[1:6:2], w[6::2] + t * w[7::2]), t_s, rng))
        image = shown(k, images, rng)
        k += 1
        if image is None:
            continue
        done = monitor.feed(VideoFrame(number, number / scene.fps, image))
        number += 1
        if done:
            ratios = np.abs(done[0].values - portion_truth(w, t_s)) / done[0].sigmas
            return done[0], float(np.nanmax(ratios, initial=0.0)) if done[0].observes("range_m") else 0.0


def frozen(first: int, last: int) -> Shown:
    """Return images that stand still before they are digitised: each has a noise of its own."""
    return lambda k, images, rng: with_noise(images[first - 1], rng) if first <= k <= last else images[k]


def test_images_that_stand_still_are_left_out_though_their_noise_differs() -> None:
    found, ratio = largest_ratio(frozen(3, 7))
    assert (found.status, found.frames, found.consistent) == ("near", 5, True)
    assert ratio < 4.5


def test_portion_whose_last_images_stand_still_is_refused() -> None:
    """The ship may have stopped, or the video."""
    assert largest_ratio(frozen(6, 9))[0].status == "rejected_motion"


def test_images_displaced_by_few_lines_are_left_out() -> None:
    def shown(k: int, images: list[Image], rng: np.random.Generator) -> Image:
        return np.roll(images[k], {2: 3, 5: -5, 6: 6}.get(k, 0), axis=0)

    found, ratio = largest_ratio(shown)
    assert (found.status, found.frames, found.jitter_px) == ("near", 7, 0.0)
    assert ratio < 4.5


def test_half_of_the_images_lost_without_a_gap_are_found_by_the_motion() -> None:
    lost = {1, 2, 4, 5, 6, 7, 13, 15}
    found, ratio = largest_ratio(lambda k, images, rng: None if k in lost else images[k])
    assert (found.status, found.timing) == ("near", "8 images lost")
    assert ratio < 4.5


def test_portion_in_which_nothing_agrees_is_refused() -> None:
    def shown(k: int, images: list[Image], rng: np.random.Generator) -> Image:
        return images[(0, 5, 1, 7, 3, 9, 2, 8, 4, 6)[k]] if k == 9 else images[min(k, (0, 1, 0, 1, 2, 1, 3, 0, 2)[k])]

    assert largest_ratio(shown)[0].status.startswith("rejected_")


@pytest.mark.parametrize(
    ("camera", "errors"),
    [(TvCamera(f_share=0.005), None), (TvCamera(distortion=0.011), None), (TvCamera(), TargetErrors(cross_m=0.003))],
    ids=["focal length 0.5 %", "1 px at the corner", "cross 3 mm off"],
)
def test_error_that_is_not_stated_is_within_the_default_tolerances(
    camera: TvCamera, errors: TargetErrors | None
) -> None:
    found, ratio = largest_ratio(camera=camera, errors=errors, tolerances=CameraTolerances())
    assert found.status == "near"
    assert ratio < 4.5


def test_poses_off_the_line_of_most_are_found() -> None:
    t, information = np.arange(10.0), np.broadcast_to(np.eye(6) * 1e4, (10, 6, 6))
    poses = np.outer(t, np.full(6, 0.3)) + 0.01 * np.random.default_rng(1).standard_normal((10, 6))
    poses[[2, 7]] += 0.5
    assert np.flatnonzero(off_the_line(t, poses, information)).tolist() == [2, 7]
    poses[[0, 3, 5]] -= 0.4 * t[[0, 3, 5], None] + 1.0
    assert not off_the_line(t, poses, information).any()


def test_poses_equal_to_those_before_are_repeated() -> None:
    information = np.broadcast_to(np.eye(6) * 1e4, (6, 6, 6))
    poses = np.outer([0.0, 1.0, 1.0, 1.0, 2.0, 3.0], np.ones(6))
    assert np.flatnonzero(repeated(poses, information)).tolist() == [2, 3]
