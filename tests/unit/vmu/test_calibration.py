"""Calibration from simulated observations: truth recovered, sigmas honest, what does not belong left out by name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.rig import Rig
from hil.errors import BadInput
from hil.vmu.calibration import quality
from hil.vmu.calibration.board import start
from hil.vmu.calibration.drift import Drift, check
from hil.vmu.calibration.files import Label, StoredCalibration
from hil.vmu.calibration.leds import Spots, SpotViews
from hil.vmu.calibration.model import PARTS, Observations, Setup, TurntableModel
from hil.vmu.calibration.refine import RefinementFit, RefinementProblem, weak_prior
from hil.vmu.calibration.solve import CalibrationSolution, robust_fit, solve, solve_leds
from hil.vmu.kernels.chain import SCALE
from tests.support.calibration_sets import AXIS_SIGMA, BOARD, PIXEL_SIGMA, as_made, board_seen, leds_seen, on_paper
from tests.support.calibration_views import observe, plan, shifted

LAYOUT_SIGMA, SQUARE_SIGMA = 1e-3, 1e-3


def errors_of(fit: RefinementFit, truth: Setup) -> np.ndarray:
    """Return the errors of all numbers; a board may lie the other way round."""
    error = fit.setup.theta - truth.theta
    target = fit.setup.target_axes
    if np.trace(target @ truth.target_axes.T) < 0.0:
        target = target @ np.diag([-1.0, -1.0, 1.0])
    for part, mine, other in (
        ("mounting", fit.setup.camera_axes, truth.camera_axes),
        ("target", target, truth.target_axes),
    ):
        error[PARTS[part].start : PARTS[part].start + 3] = Rotation.from_matrix(mine @ other.T).as_rotvec()
    if len(fit.sigma) > len(error):
        error = np.concatenate([error, (fit.setup.points - truth.points).ravel()])
    return error


def in_sigmas(fit: RefinementFit, truth: Setup) -> np.ndarray:
    """Return the errors of all numbers that were found over their sigmas."""
    found = fit.sigma > 0.0
    return errors_of(fit, truth)[found] / fit.sigma[found]


def nees(fit: RefinementFit, truth: Setup) -> float:
    """Return the normalised square of all errors together, by its number of degrees of freedom."""
    found = fit.sigma > 0.0
    sigma = fit.sigma[found]
    values, vectors = np.linalg.eigh(fit.covariance[np.ix_(found, found)] / np.outer(sigma, sigma))
    free = values > 1e-9 * values[-1]  # a layout does not move as a whole
    components = (vectors.T @ in_sigmas(fit, truth))[free]
    return float(np.mean(components**2 / values[free]))


def spots_of(seen: Observations, rng: np.random.Generator) -> SpotViews:
    """Return the spots of ``seen`` in any order, with two lights in every image that are no LEDs, and LEDs unlit."""
    views = []
    for view in seen.pixels:
        pair = []
        for positions in view:
            lit = positions[np.isfinite(positions).all(axis=1) & (rng.random(len(positions)) > 0.05)]
            lit = np.vstack([lit, rng.uniform(0.0, 1023.0, (2, 2))])
            lit = lit[rng.permutation(len(lit))]
            pair.append(Spots(lit, np.tile(PIXEL_SIGMA**2 * np.eye(2), (len(lit), 1, 1))))
        views.append((pair[0], pair[1]))
    return SpotViews(seen.names, seen.axes, tuple(views))


def calibrated_by_leds(rig: Rig, seed: int, spoil: float = 0.0) -> tuple[CalibrationSolution, Setup]:
    rng = np.random.default_rng(seed)
    paper, turntable = on_paper(rig, True), TurntableModel.of(rig.bench)
    truth = as_made(paper, rng, True)
    seen = leds_seen(truth, turntable, rng)
    seen.axes[5, 1] += spoil
    held = weak_prior(paper, (), AXIS_SIGMA, LAYOUT_SIGMA, 0.0)
    return solve_leds(spots_of(seen, rng), paper, turntable, held, lambda *_: None), truth


def calibrated_by_board(
    rig: Rig, seed: int, told: float = 1.0, spoil: float = 0.0
) -> tuple[CalibrationSolution, Setup]:
    rng = np.random.default_rng(seed)
    paper, turntable = on_paper(rig, False), TurntableModel.of(rig.bench)
    truth = as_made(paper, rng, False)
    seen = board_seen(truth, turntable, rng)
    seen.axes[5, 1] += spoil
    seen.pixels[::3] = seen.pixels[::3, :, ::-1]  # read from the other end
    paper = replace(paper, points=paper.points * told)
    begun, seen, doubtful = start(seen, BOARD, paper, turntable, (), False)
    held = weak_prior(begun, (), AXIS_SIGMA, 0.0, SQUARE_SIGMA)
    return solve(seen, begun, turntable, held, doubtful), truth


def test_leds_give_cameras_mounting_and_layout_within_their_sigmas(mock_rig: Rig) -> None:
    found = [nees(solved.fit, truth) for solved, truth in (calibrated_by_leds(mock_rig, k) for k in range(4))]
    assert 0.7 < np.mean(found) < 1.35


@pytest.mark.slow
def test_a_board_gives_cameras_and_mounting_within_their_sigmas(mock_rig: Rig) -> None:
    found = [nees(solved.fit, truth) for solved, truth in (calibrated_by_board(mock_rig, k) for k in range(3))]
    assert 0.65 < np.mean(found) < 1.4


def test_the_noise_of_the_pixels_is_found(mock_rig: Rig) -> None:
    solved, _ = calibrated_by_board(mock_rig, 1)
    assert quality.sigma_px(solved.fit, solved.observations) == pytest.approx(PIXEL_SIGMA, rel=0.05)


@pytest.mark.parametrize("calibrated", [calibrated_by_leds, calibrated_by_board])
def test_view_with_wrong_axes_is_excluded_by_name(mock_rig: Rig, calibrated) -> None:  # type: ignore[no-untyped-def]
    solved, truth = calibrated(mock_rig, 2, spoil=0.01)
    clean, _ = calibrated(mock_rig, 2)
    assert "0005" in solved.left_out or len(solved.left_out) == 1
    assert not clean.left_out
    assert nees(solved.fit, truth) < 1.8


def test_rails_reveal_a_wrong_square_size(mock_rig: Rig) -> None:
    solved, _ = calibrated_by_board(mock_rig, 3, told=0.97)
    scale, sigma = solved.fit.setup.theta[SCALE], solved.fit.sigma[SCALE]
    assert scale == pytest.approx(1.0 / 0.97, abs=3e-3)
    assert sigma < 1e-3


def test_warnings_name_what_views_without_tilt_and_travel_leave_open(mock_rig: Rig) -> None:
    paper, turntable = on_paper(mock_rig, True), TurntableModel.of(mock_rig.bench)
    rng = np.random.default_rng(1)
    axes = plan(paper, turntable, 8, (1.5, 1.5001), 0.01, rng, 0.001)
    seen = observe(paper, turntable, axes, AXIS_SIGMA, PIXEL_SIGMA, rng)
    held = weak_prior(paper, (), AXIS_SIGMA, LAYOUT_SIGMA, 0.0)
    fit = RefinementProblem(seen, turntable, held, paper.points).solve(paper)
    text = " ".join(quality.warnings_of(fit, seen, held, quality.coverage(seen, paper.sizes), False))
    for words in ("few views", "covered to", "no tilt", "nothing fixes the scale", "not determined", "left.k1"):
        assert words in text
    assert fit.sigma[PARTS["mounting"]][3:].max() > 0.02


def test_what_is_kept_is_not_touched(mock_rig: Rig) -> None:
    paper, turntable = on_paper(mock_rig, True), TurntableModel.of(mock_rig.bench)
    rng = np.random.default_rng(4)
    seen = leds_seen(shifted(paper, TARGET_POSITION=[0.0, 3e-3, 0.0]), turntable, rng)
    held = weak_prior(paper, ("left", "right", "stereo"), AXIS_SIGMA, LAYOUT_SIGMA, 0.0)
    fit = RefinementProblem(seen, turntable, held, paper.points).solve(paper)
    assert (fit.setup.theta[:24] == paper.theta[:24]).all()
    assert not fit.sigma[:24].any()
    assert (fit.sigma[24:36] > 0.0).all()


def test_spots_far_from_the_projected_leds_are_rejected(mock_rig: Rig) -> None:
    paper, turntable = on_paper(mock_rig, True), TurntableModel.of(mock_rig.bench)
    rng = np.random.default_rng(4)
    seen = leds_seen(paper, turntable, rng, 6)
    nothing = Spots(np.empty((0, 2)), np.empty((0, 2, 2)))
    views = SpotViews(seen.names, seen.axes, ((nothing, nothing),) * 6)
    with pytest.raises(BadInput, match="0 of 6 views show 3 LEDs"):
        solve_leds(views, paper, turntable, weak_prior(paper, (), AXIS_SIGMA, LAYOUT_SIGMA, 0.0), lambda *_: None)


@pytest.fixture(scope="module")
def known(mock_rig: Rig) -> tuple[StoredCalibration, Setup]:
    """Return a calibration by LEDs and the truth."""
    rng = np.random.default_rng(11)
    paper, turntable = on_paper(mock_rig, True), TurntableModel.of(mock_rig.bench)
    truth = as_made(paper, rng, True)
    seen = leds_seen(truth, turntable, rng, 40)
    held = weak_prior(paper, (), AXIS_SIGMA, LAYOUT_SIGMA, 0.0)
    fit = RefinementProblem(seen, turntable, held, paper.points).solve(robust_fit(seen, paper, turntable, held))
    return StoredCalibration(Label("a", "", "leds"), fit.setup, turntable, fit.covariance, fit.noise, AXIS_SIGMA), truth


def today(
    known: tuple[StoredCalibration, Setup], seed: int, sigma_px: float = PIXEL_SIGMA, **changes: list[float]
) -> Drift:
    calibrated, truth = known
    rng = np.random.default_rng(seed)
    moved = shifted(truth, **{name: np.array(change) for name, change in changes.items()})
    axes = plan(truth, calibrated.turntable, 8, (0.6, 1.5), 15.0, rng, 0.25)
    seen = observe(moved, calibrated.turntable, axes, AXIS_SIGMA, sigma_px, rng)
    seen = replace(seen, covariance=seen.covariance * (PIXEL_SIGMA / sigma_px) ** 2)
    return check(calibrated, seen, calibrated.setup, False)


def test_no_drift_is_reported_without_drift(known: tuple[StoredCalibration, Setup]) -> None:
    assert min(today(known, seed).chance for seed in range(20)) > 1e-3


def test_noisier_pixels_are_no_drift(known: tuple[StoredCalibration, Setup]) -> None:
    found = today(known, 3, sigma_px=3.0 * PIXEL_SIGMA)
    assert found.chance > 1e-3
    assert 2.0 < found.noise < 3.3  # the encoders, whose share is as ever, take part in it


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"BASELINE": [1e-4, 0.0, 0.0]}, "stereo"),
        ({"CAMERA_ROTATION": [0.0, np.radians(0.05), 0.0]}, "mounting"),
        ({"CAMERA_ROTATION": [0.0, 0.0, np.radians(0.05)]}, "mounting"),
        ({"LEFT": [0.0, 0.0, 1.0]}, "left"),
        ({"TARGET_POSITION": [0.0, 1e-3, 0.0]}, "target"),
    ],
)
def test_what_moved_is_found_and_named(
    known: tuple[StoredCalibration, Setup], changes: dict[str, list[float]], part: str
) -> None:
    found = today(known, 5, **changes)
    assert found.chance < 1e-3
    assert part in found.alike


def test_the_size_of_a_drift_comes_with_its_sigma(known: tuple[StoredCalibration, Setup]) -> None:
    found = today(known, 6, TARGET_POSITION=[0.0, 1e-3, 0.0])
    best = found.explanations[0]
    assert best.part == "target"
    error = best.change[PARTS["target"]][4] - 1e-3
    assert abs(error) < 4.0 * best.sigma[PARTS["target"]][4] < 4e-4
