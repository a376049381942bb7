"""Calibration and drift check of a folder of views, up to the figures of the report."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from hil.config.rig import Rig
from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration import board as boards
from hil.vmu.calibration import drift, hand_held, led_layout, quality
from hil.vmu.calibration.board import Board
from hil.vmu.calibration.files import HAND_HELD, Label, StoredCalibration
from hil.vmu.calibration.leds import SpotViews, identify, spot_views
from hil.vmu.calibration.model import PARTS, SIDES, Observations, Setup, TurntableModel
from hil.vmu.calibration.refine import Prior, weak_prior
from hil.vmu.calibration.solve import CalibrationSolution, robust_fit, solve, solve_leds
from hil.vmu.calibration.views import Views
from hil.vmu.kernels.chain import BASELINE, CAMERA_ROTATION, COMMON, SCALE

Progress = Callable[[str, float], None]

_WIDE_GATE_PX = 12.0
_HALVES_SIGMAS = 3.0
_REMEDY = "take more views: near and far, tilted, at the edges of both images"
_ERROR_MM = 2.0
_BASELINES = (0.8, 1.25)  # to that of the initial values


@dataclass(frozen=True, slots=True)
class CalibrationInputs:
    """Prior knowledge. axis_sigma: (6,), of rails, m, and gimbals, rad. led_sigma: m. square_sigma: relative."""

    board: Board | None
    keep: tuple[str, ...]
    axis_sigma: Array
    led_sigma: float
    square_sigma: float


@dataclass(frozen=True, slots=True)
class CalibrationLimits:
    """Limits that a calibration must satisfy. error_mm: None: 2, or the depth of ``rms_px`` of disparity if larger."""

    rms_px: float
    error_mm: float | None
    range_m: float
    mounting_mm: float
    mounting_deg: float
    square_percent: float
    spot_px: float = 0.5

    def position_mm(self, setup: Setup) -> float:
        """Return the limit of a point's position with the cameras of ``setup``."""
        if self.error_mm is not None:
            return self.error_mm
        baseline_m = float(np.linalg.norm(setup.theta[BASELINE:CAMERA_ROTATION]))
        return max(_ERROR_MM, 1e3 * self.rms_px * self.range_m**2 / (float(setup.theta[0]) * baseline_m))


@dataclass(frozen=True, slots=True)
class CalibrationCheck:
    """One line of the verdict. needed: the vision unit cannot use a calibration that fails it. cause: largest part."""

    name: str
    value: float
    limit: float
    unit: str
    needed: bool = False
    cause: str = ""

    @property
    def passed(self) -> bool:
        return self.value <= self.limit

    def __str__(self) -> str:
        cause = f", mostly by {self.cause}" if self.cause else ""
        return f"{self.name} {self.value:.4g} {self.unit}, allowed {self.limit:.3g} {self.unit}{cause}"


@dataclass(frozen=True, slots=True)
class CalibrationOutcome:
    """A calibration with its quality."""

    label: Label
    solved: CalibrationSolution
    turntable: TurntableModel
    held: Prior
    nominal: Setup
    sigma_px: float
    at_ranges: list[quality.RangeAccuracy]
    shares: list[float]
    warnings: list[str]
    checks: list[CalibrationCheck] = field(default_factory=list)
    halves: hand_held.Halves | None = None

    @property
    def is_hand_held(self) -> bool:
        """Whether the board was held by hand: there are no encoders to compare with."""
        return self.label.target.startswith(HAND_HELD)

    @property
    def passed(self) -> bool:
        return all(check.passed for check in self.checks)

    def refuse_unusable(self, views: str) -> None:
        """Raise BadInput if the vision unit cannot use the calibration of ``views``."""
        failed = [check for check in self.checks if check.needed and not check.passed]
        if failed:
            exceeded = ", ".join(map(str, failed))
            text = f"{exceeded}: the vision unit cannot use this calibration, no geometry file is written; {_REMEDY}"
            raise BadInput.single(views, "", text)


def target_name(board: Board | None) -> str:
    """Return ``leds``, or ``board 11x8 30 mm``."""
    return "leds" if board is None else f"board {board.columns}x{board.rows} {1e3 * board.square_m:g} mm"


def calibrate(
    views: Views,
    rig: Rig,
    geometry: VmuGeometry,
    given: CalibrationInputs,
    limits: CalibrationLimits,
    label: Label,
    guess: bool,
    progress: Progress,
) -> CalibrationOutcome:
    """Return the calibration of ``views``. guess: ``geometry`` has approximate camera parameters.

    Raises BadInput if the views are insufficient.
    """
    turntable = TurntableModel.of(rig.bench)
    if given.board is None:
        nominal = Setup.of(geometry, rig.bench)
        layout = 0.0 if "leds" in given.keep else given.led_sigma
        held = weak_prior(nominal, given.keep, given.axis_sigma, layout, 0.0)
        spots = spot_views(views, nominal.sizes, geometry.sensor, progress)
        solved = solve_leds(spots, nominal, turntable, held, progress)
    else:
        observed, sizes = boards.observations(views, given.board, progress)
        nominal = Setup.of(geometry, rig.bench, given.board.points())
        if (sizes != nominal.sizes).any():
            raise BadInput.single("VIEWS", "", _sizes_differ(sizes, nominal.sizes))
        progress("fitting", 0.9)
        begun, resolved, doubtful = boards.start(observed, given.board, nominal, turntable, given.keep, guess)
        held = weak_prior(begun, given.keep, given.axis_sigma, 0.0, given.square_sigma)
        solved = solve(resolved, begun, turntable, held, doubtful)
        solved.left_out.update(_not_used(views, observed, given.board))
    return _outcome(label, solved, turntable, held, nominal, limits, given.board is not None)


def calibrate_hand_held(
    views: Views,
    rig: Rig,
    geometry: VmuGeometry,
    given: CalibrationInputs,
    limits: CalibrationLimits,
    label: Label,
    guess: bool,
    progress: Progress,
) -> CalibrationOutcome:
    """Return the calibration of both cameras by pairs of a board that is held by hand; arguments: see ``calibrate``.

    Without ``guess`` the images may have another size than those of ``geometry``. Without a board the target is the
    ring, and its layout is measured by the cameras of ``geometry``.
    """
    if given.board is None:
        ring = hand_held.at_origin(Setup.of(geometry, rig.bench), np.array(geometry.leds_m))
        solved, held = led_layout.solve(views, geometry, ring, given.led_sigma, progress)
        outcome = _outcome(label, solved, hand_held.TURNTABLE, held, ring, limits, False)
        return replace(outcome, warnings=hand_held.warnings_of(solved, [1.0, 1.0]), checks=outcome.checks[:1])
    observed, sizes = boards.observations(views, given.board, progress)
    nominal = Setup.of(geometry, rig.bench, given.board.points())
    if guess and (sizes != nominal.sizes).any():
        raise BadInput.single("VIEWS", "", _sizes_differ(sizes, nominal.sizes))
    nominal = replace(nominal, sizes=sizes)
    progress("fitting", 0.9)
    solved, held = hand_held.solve(observed, given.board, nominal, given.keep, given.square_sigma, guess)
    solved.left_out.update(_not_used(views, observed, given.board))
    outcome = _outcome(label, solved, hand_held.TURNTABLE, held, nominal, limits, False)
    halves = hand_held.halves(solved, held, limits.range_m)
    checks = list(outcome.checks)
    if halves is not None:
        checks.append(
            CalibrationCheck("difference of two halves of the views", halves.in_sigmas, _HALVES_SIGMAS, "sigma")
        )
    warnings = hand_held.warnings_of(solved, outcome.shares) + quality.exchange_warnings(solved.fit.setup, held)
    warnings += _baseline_warnings(solved.fit.setup, nominal) if guess else []
    return replace(outcome, warnings=warnings, halves=halves, checks=checks)


def _baseline_warnings(setup: Setup, nominal: Setup) -> list[str]:
    """Return a sentence if the baseline is not as long as that of the initial values: a board of another size."""
    now, before = (float(np.linalg.norm(each.theta[BASELINE:CAMERA_ROTATION])) for each in (setup, nominal))
    if _BASELINES[0] < now / before < _BASELINES[1]:
        return []
    return [f"the baseline is {1e3 * now:.0f} mm long, {1e3 * before:.0f} mm in --geometry: is --square-mm right?"]


def _not_used(views: Views, observed: Observations, board: Board) -> dict[str, str]:
    """Return the views that show the board to neither camera, and the images of no view, with the reason."""
    names = (name for name in views.names if name not in observed.names)
    least = f"fewer than {boards.LEAST_CORNERS} corners are" if board.is_coded else "the board is not completely"
    return {**dict.fromkeys(names, f"{least} visible to a camera"), **views.unused}


def _sizes_differ(actual: Array, expected: Array) -> str:
    sides = [
        f"the {side} images are {a[0]:g} x {a[1]:g} px, {b[0]:g} x {b[1]:g} px in geometry or rig file"
        for side, a, b in zip(SIDES, actual, expected, strict=True)
        if (a != b).any()
    ]
    return sides[0]


def _outcome(
    label: Label,
    solved: CalibrationSolution,
    turntable: TurntableModel,
    held: Prior,
    nominal: Setup,
    limits: CalibrationLimits,
    rigid: bool,
) -> CalibrationOutcome:
    fit, observed = solved.fit, solved.observations
    sigma, hand = quality.sigma_px(fit, observed), label.target.startswith(HAND_HELD)
    at_ranges = [
        accuracy
        for range_m in sorted({*quality.RANGES_M, limits.range_m})
        if (accuracy := quality.at_range(fit.setup, fit.covariance, sigma, range_m, hand)) is not None
    ]
    is_sized = hand and bool(held.free[SCALE])
    covariance = quality.without_scale(fit.covariance) if is_sized else fit.covariance
    here = quality.at_range(fit.setup, covariance, sigma, limits.range_m, hand)
    error = float("inf") if here is None else float(np.hypot(here.calibration_across_mm, here.calibration_depth_mm))
    known = ", for a known size of the board" if is_sized else ""
    checks = [
        CalibrationCheck("reprojection, RMS", fit.rms_px, limits.rms_px, "px", needed=True),
        CalibrationCheck(
            f"position of a point at {limits.range_m:g} m, 1 sigma{known}",
            error,
            limits.position_mm(fit.setup),
            "mm",
            cause=quality.dominant(fit.setup, covariance, limits.range_m, hand),
        ),
        CalibrationCheck(
            f"spot of an LED at {limits.range_m:g} m by the calibration, 1 sigma",
            quality.spot_error_px(fit.setup, fit.covariance, limits.range_m, hand),
            limits.spot_px,
            "px",
            needed=True,
        ),
    ]
    if held.free[PARTS["mounting"]].any():
        rotation, position = np.split(fit.sigma[PARTS["mounting"]], 2)
        checks.append(
            CalibrationCheck("camera's position, 1 sigma", 1e3 * float(position.max()), limits.mounting_mm, "mm")
        )
        checks.append(
            CalibrationCheck("camera's axes, 1 sigma", float(np.degrees(rotation.max())), limits.mounting_deg, "deg")
        )
    if rigid and held.free[SCALE]:
        off = 100.0 * abs(float(fit.setup.theta[SCALE]) - 1.0)
        checks.append(CalibrationCheck("board's size against the rails", off, limits.square_percent, "%"))
    shares = quality.coverage(observed, fit.setup.sizes)
    warnings = quality.warnings_of(fit, observed, held, shares, rigid)
    return CalibrationOutcome(label, solved, turntable, held, nominal, sigma, at_ranges, shares, warnings, checks)


@dataclass(frozen=True, slots=True)
class DriftLimits:
    """Limits of a drift check. alarm: probability of a chance result below which a drift is significant."""

    rms_px: float
    drift_px: float
    alarm: float


@dataclass(frozen=True, slots=True)
class DriftCheck:
    """A drift check. across_mm, depth_mm: displacement of a point at ``range_m`` by the best explanation."""

    stored: StoredCalibration
    setup: Setup
    drift: drift.Drift
    across_mm: float
    depth_mm: float
    range_m: float
    lost: tuple[str, ...]

    def refusal(self, limits: DriftLimits) -> tuple[str, str]:
        """Return what exceeds ``limits``, and the limit, as texts; "" if nothing does."""
        change = self.drift
        best = change.explanations[0]
        if change.chance < limits.alarm and best.shift_px > limits.drift_px:
            moved = f"{' or '.join(change.alike)} moved, {best.shift_px:.3f} px RMS (by chance: {change.chance:.1e})"
            return moved, f"{limits.drift_px:g} px"
        if change.rms_px > limits.rms_px:
            return f"residuals {change.rms_px:.3f} px RMS", f"{limits.rms_px:g} px"
        return "", ""


def check(
    views: Views, stored: StoredCalibration, board: Board | None, moved: bool, range_m: float, progress: Progress
) -> DriftCheck:
    """Return the deviation of today's views from the calibration ``stored``; raise BadInput if they are insufficient.

    moved: the target may have moved since the calibration; a board always may.
    """
    if board is None:
        spots = spot_views(views, stored.setup.sizes, stored.sensor, progress)
        elsewhere = moved or stored.label.target != "leds"
        observed, setup = _identify_leds(spots, stored, elsewhere)
    else:
        observed, sizes = boards.observations(views, board, progress)
        if (sizes != stored.setup.sizes).any():
            raise BadInput.single("VIEWS", "", _sizes_differ(sizes, stored.setup.sizes))
        keep = ("left", "right", "stereo", "mounting")
        with_board = Setup(
            stored.setup.theta, stored.setup.camera_axes, stored.setup.target_axes, board.points(), stored.setup.sizes
        )
        begun, observed, _ = boards.start(observed, board, with_board, stored.turntable, keep, True)
        setup, elsewhere = _locate_target(observed, begun, stored), True
    analysis = drift.check(stored, observed, setup, elsewhere)
    across, depth = quality.displacement(setup, analysis.explanations[0].change[:COMMON], range_m)
    lost = tuple(name for name in views.names if name not in observed.names)
    return DriftCheck(stored, setup, analysis, across, depth, range_m, lost)


def _identify_leds(spots: SpotViews, stored: StoredCalibration, moved: bool) -> tuple[Observations, Setup]:
    """Return today's LEDs, searched first near the positions predicted by the calibration."""
    setup = stored.setup
    observed = identify(spots, setup, stored.turntable, None if moved else _WIDE_GATE_PX)
    if not moved and not _enough(observed):
        observed = identify(spots, setup, stored.turntable)
    good = np.flatnonzero(observed.visible.sum(axis=2).max(axis=1) >= 3)
    if len(good) < 2:
        text = f"{len(good)} of {len(spots.names)} views show 3 LEDs near their positions, 2 are required"
        raise BadInput.single("VIEWS", "", text)
    observed = observed.only(good)
    return observed, _locate_target(observed, setup, stored) if moved else setup


def _enough(observed: Observations) -> bool:
    return bool((observed.visible.sum(axis=2).max(axis=1) >= 3).mean() > 0.5)


def _locate_target(observed: Observations, setup: Setup, stored: StoredCalibration) -> Setup:
    """Return ``setup`` with the target's pose fitted to today's views, all else as calibrated."""
    held = weak_prior(setup, ("left", "right", "stereo", "mounting"), stored.axis_sigma, 0.0, 0.0)
    return robust_fit(observed, setup, stored.turntable, held)
