"""Vibration of the cameras, from the shifts between their images."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from hil.vmu.kernels.records import FIT
from hil.vmu.vibration import Vibration, with_pointing
from tests.support.vmu_disturbances import USUAL, Frame, Row, approach, each_bench, real_bench, somewhere
from tests.support.vmu_lab import LAB_ROWS, shaken
from tests.support.vmu_pixels import PixelOptics

BY_NAME = {row.name: row for row in LAB_ROWS}


def one_bench(rng: np.random.Generator, count: int) -> Iterator[Frame]:
    scene = real_bench(USUAL, rng, PixelOptics())
    for _ in range(count):
        yield scene, somewhere(rng, 1.0, 7.0)


def fit_with(shift_px: float, noise_px: float, stated_px: float = 0.5) -> np.void:
    fit = np.zeros(1, FIT)[0]
    fit["shift_px"], fit["shift_noise"], fit["shift"][1] = shift_px, noise_px**2, shift_px / stated_px
    return fit


def test_shift_that_stays_is_no_vibration(rng: np.random.Generator) -> None:
    still, shaking = Vibration(0.0), Vibration(0.0)
    for k in range(40):
        still.add(fit_with(0.7 + 0.002 * k + 0.05 * rng.standard_normal(), 0.05), is_first=k == 0)
        shaking.add(fit_with(0.7 + 0.6 * rng.standard_normal(), 0.05), is_first=k == 0)
    assert still.sigma_px == 0.0
    assert shaking.sigma_px == pytest.approx(0.6, rel=0.35)
    assert Vibration(0.3).sigma_px == 0.3


def test_pairs_without_a_track_show_a_vibration_beyond_the_tolerances(rng: np.random.Generator) -> None:
    """Once it is learnt, the tolerances that the shifts are compared with include it."""
    still, shaking = Vibration(0.0), Vibration(0.0)
    for _ in range(40):
        still.add(fit_with(0.5 * rng.standard_normal(), 0.05), is_first=True)
        stated_px = np.hypot(0.5, shaking.sigma_px)
        shaking.add(fit_with(1.4 * rng.standard_normal(), 0.05, stated_px), is_first=True)
    assert still.sigma_px == 0.0
    assert shaking.sigma_px == pytest.approx(1.4, rel=0.35)


def test_pointing_of_the_left_camera_moves_and_turns_the_target() -> None:
    fit = np.zeros(1, FIT)[0]
    fit["t"] = 0.0, 0.0, 4.0
    out = with_pointing(fit, 1e-6)
    assert np.allclose(np.diag(out["covariance"]), [16e-6, 16e-6, 0.0, 1e-6, 1e-6, 0.0])
    assert np.array_equal(out["noise"], out["covariance"])
    assert with_pointing(fit, 0.0) is fit


def test_poses_of_vibrating_cameras_are_within_their_sigmas() -> None:
    """Learnt from a track or from single pairs, or stated; the first pairs do not show it."""
    learnt = BY_NAME["cameras vibrate by 1 px, tracked"].run(20, 4)
    stated = BY_NAME["cameras vibrate by 1 px, stated"].run(8, 4)
    unknown = Row("", USUAL, shaken(each_bench(USUAL), 1.0)).run(8, 4)
    single = Row("", USUAL, shaken(one_bench, 1.0)).run(30, 4)
    for tally in (learnt, stated):
        assert tally.solved >= 0.8 * tally.frames, tally.line()
        assert np.abs(tally.ratios).max() < 4.5
    assert np.abs(unknown.ratios).max() > np.abs(stated.ratios).max()
    assert single.solved >= 24, single.line()
    assert np.abs(single.ratios[8:]).max() < 4.5


def test_vibration_that_is_learnt_from_steady_cameras_is_none() -> None:
    steady = Row("", USUAL, approach(USUAL), tracked=True).run(12, 6)
    assert steady.solved == 12
    assert 0.5 < np.sqrt(np.mean(np.square(steady.ratios))) < 1.6
