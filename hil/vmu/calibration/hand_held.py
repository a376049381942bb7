"""Calibration of the two cameras from a board that is held by hand: no bench, every view has a free pose.

The refinement is that of views on a bench (``refine.py``): the board's pose in each view, by the left camera, is given
as the position of a bench whose encoders are as good as unknown. Mounting and target are held at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import euler, quat
from hil.vmu.calibration import board as boards
from hil.vmu.calibration import quality
from hil.vmu.calibration import views as views_files
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.model import Observations, Setup, TurntableModel
from hil.vmu.calibration.refine import Prior, RefinementFit, RefinementProblem, weak_prior
from hil.vmu.calibration.solve import CalibrationSolution
from hil.vmu.calibration.views import Views
from hil.vmu.kernels.chain import CAMERA_ROTATION, SCALE

TURNTABLE: Final = TurntableModel(np.zeros(3), np.array([2, 1, 0]))
ALL_PARTS: Final = ("left", "right", "stereo", "mounting", "target")
AXIS_SIGMA: Final = np.array([10.0, 10.0, 10.0, 3.0, 3.0, 3.0])
LEAST_VIEWS: Final = 8
_FAR: Final = 3.0  # times the median residual of a view
_FEW: Final = 15
_TILTED_RAD: Final = np.radians(15.0)


@dataclass(frozen=True, slots=True)
class Halves:
    """Difference of the calibrations by every second view, of a point at ``range_m``, and its standard deviation."""

    across_mm: float
    depth_mm: float
    sigma_across_mm: float
    sigma_depth_mm: float
    range_m: float

    @property
    def in_sigmas(self) -> float:
        """Return the larger of both differences over its standard deviation."""
        return max(self.across_mm / self.sigma_across_mm, self.depth_mm / self.sigma_depth_mm)


def read_pairs(folder: Path) -> Views:
    """Return the pairs of images in ``folder``; raise BadInput if there are too few."""
    views = views_files.read_pairs(folder)
    if len(views.names) < LEAST_VIEWS:
        text = f"{len(views.names)} pairs left/NAME.png, right/NAME.png, {LEAST_VIEWS} are needed"
        first = next(iter(views.unused.items()), None)
        raise BadInput.single(str(folder), "", text if first is None else f"{text} ({first[0]} {first[1]})")
    return views


def solve(
    observed: Observations, board: Board, nominal: Setup, keep: tuple[str, ...], square_sigma: float, guess: bool
) -> tuple[CalibrationSolution, Prior]:
    """Return the calibration of ``observed`` and its prior. Views that contradict the rest are left out.

    keep, guess: as in ``board.start``. square_sigma: of the board's size, relative, and with it of the baseline.
    """
    begun, axes, agree = _start(observed, board, nominal, keep, guess)
    left_out = {name: "its pair of images is inconsistent with the others" for k, name in enumerate(observed.names)
                if k not in agree}  # fmt: skip
    observed = replace(observed, axes=axes).only(agree)
    held = weak_prior(begun, (*keep, "mounting", "target"), AXIS_SIGMA, 0.0, square_sigma)
    solved = consistent_fit(observed, begun, held, left_out)
    if len(solved.observations.names) < LEAST_VIEWS:
        text = f"{len(solved.observations.names)} consistent views remain, {LEAST_VIEWS} are needed"
        raise BadInput.single("VIEWS", "", text)
    return solved, held


def consistent_fit(observed: Observations, begun: Setup, held: Prior, left_out: dict[str, str]) -> CalibrationSolution:
    """Return the fit from ``begun`` without views of far larger residuals than the others, which join ``left_out``."""
    fit = RefinementProblem(observed, TURNTABLE, held, begun.points).solve(begun)
    rms_px = np.sqrt(np.nanmean(np.square(fit.residuals), axis=(1, 2, 3)))
    usual = float(np.median(rms_px))
    good = np.flatnonzero(rms_px <= _FAR * usual)
    if LEAST_VIEWS <= len(good) < len(rms_px):
        left_out |= {observed.names[k]: f"residuals of {rms_px[k]:.2f} px, median {usual:.2f} px"
                     for k in np.flatnonzero(rms_px > _FAR * usual)}  # fmt: skip
        observed = observed.only(good)
        fit = RefinementProblem(observed, TURNTABLE, held, begun.points).solve(fit.setup)
    return CalibrationSolution(fit, observed, left_out, 0)


def bench_at(turn: Array, position: Array) -> Array:
    """Return the axes (6,) of a bench at the origin with a target at ``p_v = turn p_t + place``."""
    angles = np.empty(3)
    euler.from_quaternion_into(quat.from_matrix(np.ascontiguousarray(turn)), TURNTABLE.order, angles)
    return np.array([*(-turn.T @ position), *angles])


def _start(
    observed: Observations, board: Board, nominal: Setup, keep: tuple[str, ...], guess: bool
) -> tuple[Setup, Array, np.ndarray]:
    """Return initial cameras, the axes (n, 6) of a bench at the origin that has the board's poses, and good views."""
    cameras, agree = boards.start_cameras(observed, nominal, keep, guess)
    begun = at_origin(nominal, board.points())
    theta = begun.theta
    theta[:CAMERA_ROTATION] = cameras
    axes = np.zeros((len(observed.names), 6))
    for k in agree:
        turn, position = boards.pose_in_left(observed, k, board.points(), theta)
        axes[k] = bench_at(turn, position)
    return begun, axes, agree


def at_origin(nominal: Setup, points: Array) -> Setup:
    """Return the cameras of ``nominal`` and ``points`` with neither mounting nor place of the target."""
    theta = nominal.theta.copy()
    theta[CAMERA_ROTATION:SCALE], theta[SCALE] = 0.0, 1.0
    return Setup(theta, np.eye(3), np.eye(3), points, nominal.sizes)


def halves(solution: CalibrationSolution, held: Prior, range_m: float) -> Halves | None:
    """Return by how much the calibrations by even and odd views differ; None with fewer than twice ``LEAST_VIEWS``."""
    observed, setup = solution.observations, solution.fit.setup
    if len(observed.names) < 2 * LEAST_VIEWS:
        return None
    fits: list[RefinementFit] = [
        RefinementProblem(observed.only(range(first, len(observed.names), 2)), TURNTABLE, held, setup.points).solve(
            setup
        )
        for first in (0, 1)
    ]
    change = fits[0].setup.theta - fits[1].setup.theta
    change[SCALE] = 0.0  # the board's, in both
    both = fits[0].covariance + fits[1].covariance
    across, depth = quality.displacement(setup, change, range_m, by_hand=True)
    expected = quality.at_range(setup, quality.without_scale(both), 0.0, range_m, by_hand=True)
    if expected is None:
        return None
    return Halves(across, depth, expected.calibration_across_mm, expected.calibration_depth_mm, range_m)


def warnings_of(solution: CalibrationSolution, shares: list[float]) -> list[str]:
    """Return the deficiencies of the views, one sentence each."""
    observed = solution.observations
    warnings = quality.coverage_warnings(shares)
    if len(observed.names) < _FEW:
        warnings.append(f"few views: {len(observed.names)}, {_FEW} or more are recommended")
    tilt = observed.axes[:, 3:5]
    if min(float(np.ptp(tilt[:, k])) for k in range(2)) < 2.0 * _TILTED_RAD:
        warnings.append("little tilt: hold the target tilted by 20 to 35 deg about both of its axes, both ways")
    range_m = np.linalg.norm(observed.axes[:, :3], axis=1)
    if float(range_m.max()) < 1.3 * float(range_m.min()):
        warnings.append(f"little change of range: {range_m.min():.2f} to {range_m.max():.2f} m")
    return warnings
