"""LED layout from pairs of images of the ring at different places, by cameras whose calibration is known.

The vision unit identifies the LEDs and gives the start poses; the refinement is that of a board that is held by hand
(``hand_held.py``) with the cameras held and the layout free. What errors of the cameras do to the layout is added to
its covariance, ``C + G P G.T``, and its correlation with them, ``-G P``, is kept: P of the cameras, G the change of the
layout per error of theirs. The layout is free up to rigid motion: its frame is that of the best fit to the nominal one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration import hand_held
from hil.vmu.calibration.hand_held import AXIS_SIGMA, LEAST_VIEWS, TURNTABLE, bench_at, consistent_fit
from hil.vmu.calibration.leds import measured
from hil.vmu.calibration.model import Observations, Setup
from hil.vmu.calibration.refine import Prior, information, layout_basis, weak_prior
from hil.vmu.calibration.solve import CalibrationSolution
from hil.vmu.calibration.views import Views, read_pair
from hil.vmu.geometry import considered_covariance
from hil.vmu.kernels.chain import COMMON
from hil.vmu.kernels.records import SHARED
from hil.vmu.unit import VisionUnit

_FEWEST_LEDS = 4  # of a view: of three only their distances are left


def solve(
    views: Views, geometry: VmuGeometry, nominal: Setup, led_sigma: float, progress: Callable[[str, float], None]
) -> tuple[CalibrationSolution, Prior]:
    """Return the layout by ``views`` and its prior; raise BadInput if fewer than ``LEAST_VIEWS`` can be used.

    geometry: calibrated cameras and nominal layout. nominal: the same, with the target at the origin of the cameras.
    led_sigma: m, of the nominal positions, along each axis.
    """
    uncertain = _with_uncertain_leds(geometry, led_sigma)
    observed, left_out = _observations(views, uncertain, nominal.sizes, progress)
    if len(observed.names) < LEAST_VIEWS:
        why = next(iter(left_out.values()), "")
        text = (
            f"{len(observed.names)} pairs show {_FEWEST_LEDS} LEDs, {LEAST_VIEWS} are needed (the first without: {why})"
        )
        raise BadInput.single("VIEWS", "", text)
    held = weak_prior(nominal, hand_held.ALL_PARTS, AXIS_SIGMA, led_sigma, 0.0)
    solved = consistent_fit(observed, nominal, held, left_out)
    cameras = considered_covariance(uncertain)[:SHARED, :SHARED]
    return replace(solved, fit=replace(solved.fit, covariance=_with_cameras(solved, held, nominal, cameras))), held


def _with_uncertain_leds(geometry: VmuGeometry, led_sigma: float) -> VmuGeometry:
    """Return ``geometry`` with LEDs that are known to ``led_sigma`` only, even if it has a calibrated layout."""
    calibration = geometry.calibration
    update: dict[str, object] = {"tolerances": geometry.tolerances.model_copy(update={"led_m": led_sigma})}
    if calibration is not None:
        update["calibration"] = calibration.model_copy(update={"covariance": calibration.covariance[:COMMON]})
    return geometry.model_copy(update=update)


def _observations(
    views: Views, geometry: VmuGeometry, sizes: Array, progress: Callable[[str, float], None]
) -> tuple[Observations, dict[str, str]]:
    """Return the LEDs of the views with a pose, whose axes are those of a bench that has it, and why others have none.

    The covariance of a spot that does not count (cut by the edge, merged) is not used.
    """
    unit, left_out, kept = VisionUnit(geometry), {}, []
    pixels = np.full((len(views.names), 2, len(geometry.leds_m), 2), np.nan)
    covariance = np.broadcast_to(np.eye(2), (*pixels.shape, 2)).copy()
    axes = np.zeros((len(views.names), 6))
    for k, name in enumerate(views.names):
        progress(f"LEDs of view {name}", k / len(views.names))
        unit.track.drop()
        solution = unit.solve(*read_pair(views, k, sizes), 0.0)
        if solution.pose is None:
            left_out[name] = f"no pose: {solution.status}{'' if solution.doubt is None else f', {solution.doubt}'}"
            continue
        for side, (spots, leds) in enumerate(zip(solution.spots, solution.leds, strict=True)):
            points, usable = measured(spots)
            for led, spot in enumerate(leds):
                if spot >= 0 and usable[spot]:
                    pixels[k, side, led], covariance[k, side, led] = points.positions[spot], points.covariance[spot]
        if np.isfinite(pixels[k]).all(axis=-1).any(axis=0).sum() < _FEWEST_LEDS:
            left_out[name] = f"fewer than {_FEWEST_LEDS} LEDs"
            continue
        axes[k] = bench_at(solution.R, solution.t)
        kept.append(k)
    return Observations(views.names, axes, pixels, covariance).only(kept), left_out


def _with_cameras(solved: CalibrationSolution, held: Prior, nominal: Setup, cameras: Array) -> Array:
    """Return the covariance, (COMMON + 3 m,) squared, of the layout with errors of ``cameras`` (24, 24)."""
    fit, basis = solved.fit, layout_basis(nominal.points)
    matrix = information(solved.observations, fit.setup, TURNTABLE, AXIS_SIGMA, fit.noise, True).matrix
    normal = basis.T @ matrix[COMMON:, COMMON:] @ basis + np.eye(basis.shape[1]) / held.layout_sigma**2
    gain = basis @ np.linalg.solve(normal, basis.T @ matrix[COMMON:, :SHARED])
    covariance: Array = fit.covariance.copy()
    covariance[:SHARED, :SHARED] = cameras
    covariance[COMMON:, :SHARED] = -gain @ cameras
    covariance[:SHARED, COMMON:] = covariance[COMMON:, :SHARED].T
    covariance[COMMON:, COMMON:] += gain @ cameras @ gain.T
    return covariance
