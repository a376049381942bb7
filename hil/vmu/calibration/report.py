"""Report of a calibration and of a drift check as JSON."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hil.core.messages import Array
from hil.vmu.calibration.board import one_sided
from hil.vmu.calibration.job import CalibrationOutcome, DriftCheck, DriftLimits
from hil.vmu.calibration.model import PARTS, Parameter, Setup, parameters
from hil.vmu.calibration.quality import RangeAccuracy
from hil.vmu.kernels.chain import COMMON, SCALE


def values(setup: Setup, paper: Setup, leds: bool) -> Array:
    """Return all parameters of ``setup`` in the order of ``parameters``; rotations relative to ``paper``."""
    theta = setup.theta.copy()
    for part, mine, other in (
        ("mounting", setup.camera_axes, paper.camera_axes),
        ("target", setup.target_axes, paper.target_axes),
    ):
        rotation = slice(PARTS[part].start, PARTS[part].start + 3)
        theta[rotation] = Rotation.from_matrix(mine @ other.T).as_rotvec()
    return np.concatenate([theta, setup.points.ravel()]) if leds else theta


def found_numbers(outcome: CalibrationOutcome) -> list[tuple[Parameter, float, float, float]]:
    """Return each estimated parameter: description, value, standard deviation and nominal value."""
    fit = outcome.solved.fit
    leds = len(fit.covariance) > COMMON
    described = parameters(len(fit.setup.points) if leds else 0)
    now, nominal = (values(setup, outcome.nominal, leds) for setup in (fit.setup, outcome.nominal))
    rows = zip(described, now, fit.sigma, nominal, strict=True)
    return [(p, float(v * p.shown), float(s * p.shown), float(b * p.shown)) for p, v, s, b in rows if s > 0.0]


def led_differences(outcome: CalibrationOutcome) -> tuple[Array, Array] | None:
    """Return the positions of the LEDs from the nominal ones, and their standard deviations, (n, 3), mm.

    None if their layout has not been estimated.
    """
    fit = outcome.solved.fit
    if len(fit.covariance) == COMMON:
        return None
    return 1e3 * (fit.setup.points - outcome.nominal.points), 1e3 * fit.sigma[COMMON:].reshape(-1, 3)


def as_json(outcome: CalibrationOutcome) -> dict[str, Any]:
    """Return the content of ``hil calibrate --json``."""
    solved, fit = outcome.solved, outcome.solved.fit
    observed = solved.observations
    view_rms = np.sqrt(np.nanmean(np.square(fit.residuals), axis=(1, 2, 3)))
    return {
        "id": outcome.label.id,
        "date": outcome.label.date,
        "target": outcome.label.target,
        "passed": outcome.passed,
        "checks": [
            {
                "name": c.name,
                "value": _finite(c.value),
                "limit": c.limit,
                "unit": c.unit,
                "passed": c.passed,
                "cause": c.cause,
            }
            for c in outcome.checks
        ],
        "rms_px": fit.rms_px,
        "sigma_px": outcome.sigma_px,
        "noise": fit.noise,
        "redundancy": fit.redundancy,
        "rails_off_encoder_ratio": float(fit.axis_ratio[0]),
        "gimbals_off_encoder_ratio": float(fit.axis_ratio[1]),
        "views": {
            name: {
                "rms_px": float(rms),
                "points": int(points),
                "rails_off_mm": [float(1e3 * x) for x in offsets[:3]],
                "gimbals_off_deg": [float(x) for x in np.degrees(offsets[3:])],
            }
            for name, rms, points, offsets in zip(
                observed.names, view_rms, observed.visible.sum(axis=(1, 2)), fit.offsets, strict=True
            )
        },
        "left_out": dict(solved.left_out),
        "one_camera": one_sided(observed),
        "spots_left_out": solved.spots_left_out,
        "parameters": {
            p.name: {"value": value, "sigma": sigma, "on_paper": paper, "unit": p.unit}
            for p, value, sigma, paper in found_numbers(outcome)
        },
        "at_ranges": [_range_as_json(accuracy) for accuracy in outcome.at_ranges],
        "coverage": dict(zip(("left", "right"), outcome.shares, strict=True)),
        "halves": None if outcome.halves is None else asdict(outcome.halves),
        "board_scale": float(fit.setup.theta[SCALE]),
        "warnings": outcome.warnings,
    }


def _range_as_json(accuracy: RangeAccuracy) -> dict[str, float]:
    return {name: getattr(accuracy, name) for name in RangeAccuracy.__slots__}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None


def drift_as_json(checked: DriftCheck, limits: DriftLimits) -> dict[str, Any]:
    """Return the content of ``hil calibrate --check --json``, and ``drift_check`` of a run."""
    drift, stored = checked.drift, checked.stored
    described = parameters(len(stored.setup.points) if len(drift.explanations[0].change) > COMMON else 0)
    return {
        "calibration": stored.label.id,
        "date": stored.label.date,
        "passed": not checked.refusal(limits)[0],
        "limits": asdict(limits),
        "views": drift.views,
        "lost": list(checked.lost),
        "points": drift.points,
        "rms_px": drift.rms_px,
        "noise": drift.noise,
        "chi_square": drift.square,
        "freedom": drift.freedom,
        "chance": drift.chance,
        "moved": list(drift.alike) if drift.chance < limits.alarm else [],
        "shift_px": drift.explanations[0].shift_px,
        "shift_across_mm": checked.across_mm,
        "shift_depth_mm": checked.depth_mm,
        "range_m": checked.range_m,
        "explanations": [
            {
                "part": e.part,
                "chi_square": e.square,
                "freedom": e.freedom,
                "chance": e.chance,
                "shift_px": e.shift_px,
                "change": {
                    p.name: {"value": float(c * p.shown), "sigma": float(s * p.shown), "unit": p.unit}
                    for p, c, s in zip(described, e.change, e.sigma, strict=True)
                    if s > 0.0
                },
            }
            for e in drift.explanations
        ],
    }
