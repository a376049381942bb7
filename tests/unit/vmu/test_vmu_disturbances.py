"""Vision unit on images of another renderer: errors of calibration, lens, sensor and surroundings."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hil.config.vmu_geometry import VmuGeometry
from hil.vmu.geometry import considered_covariance
from hil.vmu.kernels.chain import COMMON
from hil.vmu.kernels.records import FIT, SHARED
from hil.vmu.unit import VisionUnit, with_strained_tolerances
from tests.support.disturbance_verdicts import judge
from tests.support.vmu_disturbances import (
    EXACT,
    ROWS,
    USUAL,
    VERY_GOOD,
    Row,
    Tally,
    approach,
    drawn_motion,
    known_geometry,
    real_bench,
    somewhere,
)
from tests.support.vmu_lookalikes import LOOKALIKE_ROWS
from tests.support.vmu_pixels import PixelOptics

BY_NAME = {row.name: row for row in ROWS}
APART = (
    "right images one frame late",
    "right images late, tracked",
    "cameras swapped",
    "wrong ring",
    "overexposed background",
)


@pytest.mark.parametrize(
    "name",
    [
        "very good calibration",
        "usual calibration",
        "usual calibration, nothing stated",
        "right camera turned 0.01 deg",
        "LEDs 0.1 mm off",
        "coma 0.5 px",
        "halo of 10 %",
        "bright textured background",
        "50 false lights",
        "10 ms between the cameras, tracked",
    ],
)
def test_frames_with_errors_of_calibration_and_optics_are_solved(name: str) -> None:
    tally = BY_NAME[name].run(4, 12)
    assert tally.solved == 4, tally.line()
    assert tally.gross == 0
    assert np.abs(tally.ratios).max() < 4.5


@cache
def apart(name: str) -> Tally:
    """Return the verdict counts of six frames of a row of ``APART``, for all its tests."""
    return BY_NAME[name].run(6, 5)


@pytest.mark.parametrize("name", APART)
def test_images_that_do_not_belong_together_are_never_grossly_wrong(name: str) -> None:
    tally = apart(name)
    assert tally.gross == 0, tally.line()
    assert tally.solved <= 1  # a target that hardly moves within a frame


@pytest.mark.parametrize("name", ["right images one frame late", "cameras swapped", "overexposed background"])
def test_images_without_a_pose_have_the_status_of_their_cause(name: str) -> None:
    tally = apart(name)
    assert sum(tally.statuses[status] for status in BY_NAME[name].expected.refused) == 6, tally.line()
    assert tally.solved == 0


def test_images_that_fit_alone_but_not_together_are_refused_whatever_the_floor_of_the_spots() -> None:
    """The floor, which is estimated from the residuals, must not explain what the motion between two images does."""
    tally = BY_NAME["right images late, default tolerances"].run(24, 0)
    assert tally.solved == 0, tally.line()
    assert tally.statuses["rejected_sync"] + tally.statuses["rejected_geometry_file"] == 24


def test_target_that_moves_between_the_images_has_the_sigmas_of_its_speed_and_rates() -> None:
    """With a stated time between the cameras; without usual rates, a target that turns would be refused."""
    apart_s = 0.08
    row = Row("80 ms apart", replace(VERY_GOOD, sync_s=apart_s), drawn_motion(VERY_GOOD, apart_s))
    tally = row.run(6, 3)
    assert tally.solved == 6, tally.line()
    assert np.abs(tally.ratios).max() < 4.0


def test_covariance_grows_where_the_images_are_further_apart_than_usual() -> None:
    fit = np.zeros(1, FIT)[0]
    fit["covariance"], fit["noise"] = 5.0 * np.eye(6), np.eye(6)
    for shift, variance in ((0.0, 5.0), (2.0, 5.0), (-4.0, 17.0)):
        fit["shift"] = (0.5, shift)
        assert np.allclose(with_strained_tolerances(fit)["covariance"], variance * np.eye(6))
    assert fit["covariance"][0, 0] == 5.0


def test_epipolar_distance_and_scale_show_errors_that_are_not_stated(rng: np.random.Generator) -> None:
    scene, truth = real_bench(EXACT, rng, PixelOptics()), somewhere(rng, 2.0, 2.5)
    raised = replace(scene, right=replace(scene.right, cy=scene.right.cy + 0.3))
    found = []
    for bench, stated in ((scene, EXACT), (raised, USUAL), (raised, EXACT)):
        left, right = bench.pair(truth.turn, truth.t_v, rng)
        found.append(VisionUnit(known_geometry(stated)).solve(left, right, 0.0))
    good, stated, rejected = found
    assert 0.0 < good.epipolar_px < 0.05
    assert 0.5 < good.scale < 1.6
    assert stated.epipolar_px == pytest.approx(0.3, abs=0.03)
    assert stated.scale < 2.0
    assert rejected.status == "rejected_sync"
    assert np.isnan([rejected.epipolar_px, rejected.scale]).all()


def test_glint_on_the_ring_does_not_turn_a_tracked_pose() -> None:
    tally = BY_NAME["glint on a tracked ring"].run(10, 3)
    assert tally.gross == 0, tally.line()
    assert tally.solved >= 7


def test_covariance_grows_with_the_stated_tolerances_and_separates_noise_from_bias(rng: np.random.Generator) -> None:
    scene, truth = real_bench(EXACT, rng, PixelOptics()), somewhere(rng, 2.0, 2.5)
    left, right = scene.pair(truth.turn, truth.t_v, rng)
    exact, usual = (VisionUnit(known_geometry(errors)).solve(left, right, 0.0) for errors in (EXACT, USUAL))
    assert exact.pose is not None
    assert usual.pose is not None
    assert (np.diag(usual.covariance) > 4.0 * np.diag(exact.covariance)).all()
    assert np.allclose(exact.pose.noise, exact.covariance, rtol=0.05, atol=1e-12)
    bias = usual.covariance - usual.pose.noise
    assert np.linalg.eigvalsh(bias).min() > -1e-12
    assert np.trace(bias[:3, :3]) > np.trace(usual.pose.noise[:3, :3])
    whole, noise = usual.frame(0, 0.0), usual.frame(0, 0.0, only_noise=True)
    assert whole is not None
    assert noise is not None
    assert np.array_equal(whole.covariance, usual.covariance)
    assert np.array_equal(noise.covariance, usual.pose.noise)


def test_covariance_of_a_calibration_takes_the_place_of_the_tolerances() -> None:
    plain = known_geometry(USUAL)
    size = COMMON + 3 * len(plain.leds_m)
    covariance = np.diag(np.linspace(1e-6, 2e-6, size))
    covariance[0, 1] = covariance[1, 0] = 5e-7
    keys = plain.model_dump(mode="json", exclude_none=True)
    keys["calibration"] = calibration_of(covariance)
    found = considered_covariance(VmuGeometry.model_validate_json(json.dumps(keys)))
    kept = np.r_[:SHARED, COMMON:size]
    assert np.allclose(found, covariance[np.ix_(kept, kept)])
    assert not np.allclose(found, considered_covariance(plain))


def calibration_of(covariance: np.ndarray) -> dict[str, object]:
    """Return a calibration record with ``covariance``."""
    return {
        "id": "a",
        "date": "2026-01-01",
        "target": "leds",
        "views": 20,
        "rms_px": 0.02,
        "noise": 1.0,
        "rail_sigma_m": 5e-5,
        "gimbal_sigma_deg": 0.005,
        "lever_arm_m": [0.0, 0.0, 0.0],
        "gimbal_order": "zyx",
        "camera_position_m": [0.0, 0.0, 0.0],
        "camera_axes": np.eye(3).tolist(),
        "target_position_m": [0.0, 0.0, 0.0],
        "target_axes": np.eye(3).tolist(),
        "covariance": [row[: k + 1].tolist() for k, row in enumerate(covariance)],
    }


@pytest.mark.slow
@pytest.mark.parametrize("row", [*ROWS, *LOOKALIKE_ROWS], ids=lambda row: row.name)
def test_every_row_is_as_expected(row: Row) -> None:
    """The table of ``python sims/disturbances.py vmu``."""
    verdict = judge(row.expected, [row.run(40, seed).result() for seed in range(3)])
    assert not verdict.why, verdict


def test_track_continues_on_lights_that_are_too_weak_for_a_search() -> None:
    """LEDs of 3 levels have an SNR of 6: half of them are below the threshold of a whole image."""
    rng, unit, found = np.random.default_rng(12), VisionUnit(known_geometry(VERY_GOOD)), []
    for k, (scene, truth) in enumerate(approach(VERY_GOOD)(rng, 11)):
        optics = replace(scene.optics, peak_levels=200.0 if k < 4 else 3.0)
        solution = unit.solve(*replace(scene, optics=optics).pair(truth.turn, truth.t_v, rng), 0.16 * k)
        if k >= 4 and solution.status == "ok":
            found.append(np.abs(truth.error(solution)) / np.sqrt(np.diag(solution.covariance)))
    assert len(found) >= 6
    assert np.max(found) < 4.5
