"""Solution of a calibration: robust start, joint refinement, exclusion of inconsistent views."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2

from hil.core.messages import Array
from hil.errors import BadInput
from hil.vmu.calibration.leds import LEAST_VIEWS, SpotViews, identify
from hil.vmu.calibration.model import PARTS, Observations, Setup, TurntableModel, project_view
from hil.vmu.calibration.refine import Prior, RefinementFit, RefinementProblem, layout_basis, whiteners
from hil.vmu.kernels.chain import COMMON

_FAR = 4.0  # times the median residual of a view
_DOUBTFUL = 1e-6  # probability below which a view is excluded ...
_FAR_BY_FIT = 2.5  # ... if its residuals also exceed the median by this factor: sharpness differs between views
_NEAR_GATE_PX = 3.0
Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class CalibrationSolution:
    """A fit, the observations used, the excluded views with their reasons, and the number of excluded spots."""

    fit: RefinementFit
    observations: Observations
    left_out: dict[str, str]
    spots_left_out: int


def solve(
    observed: Observations, setup: Setup, turntable: TurntableModel, held: Prior, doubtful: tuple[str, ...] = ()
) -> CalibrationSolution:
    """Return the calibration from the initial values ``setup``.

    Inconsistent views are excluded: those in ``doubtful``, those with large residuals in a robust fit, then one by one
    those with an improbable chi-square.
    """
    nominal = setup.points
    left_out = dict.fromkeys(doubtful, "its pose is inconsistent with the other views")
    observed = observed.only([k for k, name in enumerate(observed.names) if name not in left_out])
    if len(observed.names) < LEAST_VIEWS:
        text = f"{len(observed.names)} consistent views remain, {LEAST_VIEWS} are required"
        raise BadInput.single("VIEWS", "", text)
    setup = robust_fit(observed, setup, turntable, held)
    sizes = _view_rms(observed, setup, turntable)
    usual = float(np.median(sizes))
    far = sizes > _FAR * max(usual, 0.02)
    if far.sum() <= len(far) // 3:
        for k in np.flatnonzero(far):
            left_out[observed.names[k]] = f"residuals of {sizes[k]:.2f} px, median {usual:.2f} px"
        observed = observed.only(np.flatnonzero(~far))
    allowed = min(len(observed.names) // 4, len(observed.names) - LEAST_VIEWS)
    while True:
        fit = RefinementProblem(observed, turntable, held, nominal).solve(setup)
        setup = fit.setup
        ratio = fit.view_square / np.maximum(fit.view_freedom, 1.0)
        scaled = fit.view_square / max(float(np.median(ratio)), 1e-12)
        chance = chi2.sf(scaled, np.maximum(fit.view_freedom, 1.0))
        worst = int(np.argmax(scaled / np.maximum(fit.view_freedom, 1.0)))
        if chance[worst] > _DOUBTFUL or ratio[worst] < _FAR_BY_FIT**2 * np.median(ratio) or allowed == 0:
            return CalibrationSolution(fit, observed, left_out, 0)
        allowed -= 1
        text = f"residuals and encoder errors {np.sqrt(ratio[worst] / np.median(ratio)):.1f} times the median"
        left_out[observed.names[worst]] = text
        observed = observed.only([k for k in range(len(observed.names)) if k != worst])


def solve_leds(
    views: SpotViews, setup: Setup, turntable: TurntableModel, held: Prior, progress: Progress
) -> CalibrationSolution:
    """Return the calibration from spots, identified first by the nominal setup and then by the fit."""
    progress("identifying the LEDs", 0.0)
    observed = identify(views, setup, turntable)
    if _good(observed).sum() < LEAST_VIEWS and _good(identify(views, _opposite(setup), turntable)).sum() >= LEAST_VIEWS:
        text = "would fit with the opposite baseline: images exchanged, or the sign of baseline_m"
        raise BadInput.single("VIEWS", "", text)
    observed = _enough(observed)
    # the nominal mounting has the largest error: estimate only the mounting first
    mounting = replace(held, free=_only(held.free, "mounting"), layout_sigma=0.0)
    rough = robust_fit(observed, setup, turntable, mounting)
    gate = max(_NEAR_GATE_PX, 4.0 * float(np.median(_view_rms(observed, rough, turntable))))
    observed = _enough(identify(views, rough, turntable, gate))
    progress("fitting", 0.3)
    rough = robust_fit(observed, rough, turntable, held)
    observed = _enough(identify(views, rough, turntable, _NEAR_GATE_PX))
    strays = _strays(observed, rough, turntable)
    observed = _enough(observed.without(strays))
    progress("refining", 0.6)
    # the prior of the layout refers to the nominal one, so the fit starts from it
    start, held = replace(rough, points=setup.points), replace(held, centre=setup.theta.copy())
    solved = solve(observed, start, turntable, held)
    lost = {name: "fewer than 3 LEDs at their expected positions" for name in views.names if name not in observed.names}
    return replace(solved, left_out=lost | solved.left_out, spots_left_out=int(strays.sum()))


def _enough(observed: Observations) -> Observations:
    """Return the views in which one camera identified at least three LEDs."""
    good = np.flatnonzero(_good(observed))
    if len(good) < LEAST_VIEWS:
        text = (
            f"{len(good)} of {len(observed.names)} views show 3 LEDs near the positions given by rig and geometry file"
        )
        raise BadInput.single("VIEWS", "", f"{text}, {LEAST_VIEWS} are required")
    return observed.only(good)


def _good(observed: Observations) -> np.ndarray:
    return np.asarray(observed.visible.sum(axis=2).max(axis=1) >= 3)


def _opposite(setup: Setup) -> Setup:
    """Return ``setup`` with the right camera on the other side of the left one."""
    theta = setup.theta.copy()
    theta[PARTS["stereo"]] *= -1.0
    return replace(setup, theta=theta)


def _only(free: Array, part: str) -> np.ndarray:
    mask = np.zeros(COMMON, dtype=bool)
    mask[PARTS[part]] = True
    return np.asarray(free & mask)


def _view_rms(observed: Observations, setup: Setup, turntable: TurntableModel) -> Array:
    gaps = np.array([project_view(setup, turntable, axes).pixels for axes in observed.axes]) - observed.pixels
    out: Array = np.sqrt(np.nanmean(np.square(gaps), axis=(1, 2, 3)))
    return out


def _strays(observed: Observations, setup: Setup, turntable: TurntableModel) -> np.ndarray:
    """Return which points, (n, 2, m), are outliers relative to the rest of their view."""
    gaps = np.array([project_view(setup, turntable, axes).pixels for axes in observed.axes]) - observed.pixels
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a camera without points in a view
        gaps -= np.nanmedian(gaps, axis=2, keepdims=True)  # a common displacement of the view is due to the encoders
    size = np.hypot(gaps[..., 0], gaps[..., 1])
    usual = float(np.nanmedian(size))
    return np.asarray(np.nan_to_num(size) > max(6.0 * usual, 0.3))


def robust_fit(observed: Observations, setup: Setup, turntable: TurntableModel, held: Prior) -> Setup:
    """Return the setup that fits most of the pixels, without encoder errors (Cauchy loss)."""
    columns = np.flatnonzero(held.free)
    mask = observed.visible
    basis = layout_basis(setup.points) if held.layout_sigma > 0.0 else None
    whiten = whiteners(observed.covariance, mask)[mask]
    weights = 1.0 / held.sigma[columns]
    rotations = [k for part in ("mounting", "target") for k in range(PARTS[part].start, PARTS[part].start + 3)]
    centre = np.where(np.isin(columns, rotations), 0.0, held.centre[columns])

    def place(x: Array) -> Setup:
        theta = setup.theta.copy()
        theta[columns] = x[: len(columns)]
        layout = 0.0 if basis is None else (basis @ x[len(columns) :]).reshape(-1, 3)
        return replace(setup, theta=theta, points=setup.points + layout)

    def residual(x: Array) -> Array:
        here = place(x)
        gaps = (np.array([project_view(here, turntable, axes).pixels for axes in observed.axes]) - observed.pixels)[
            mask
        ]
        white = np.einsum("kab,kb->ka", whiten, np.nan_to_num(gaps, nan=1e4)).ravel()
        layout = x[len(columns) :] / held.layout_sigma if basis is not None else np.empty(0)
        return np.concatenate([white, (x[: len(columns)] - centre) * weights, layout])

    def slopes(x: Array) -> Array:
        here = place(x)
        views = [project_view(here, turntable, axes) for axes in observed.axes]
        common = np.array([view.by_common for view in views])[mask][..., columns]
        rows = np.einsum("kab,kbp->kap", whiten, common).reshape(-1, len(columns))
        prior = np.diag(weights)
        if basis is None:
            return np.vstack([rows, prior])
        which = np.nonzero(mask)[2]
        by_point = np.array([view.by_point for view in views])[mask]
        layout = np.einsum("kab,kbc,kcp->kap", whiten, by_point, basis.reshape(-1, 3, basis.shape[1])[which])
        rows = np.hstack([rows, layout.reshape(len(rows), -1)])
        prior = np.diag(np.concatenate([weights, np.full(basis.shape[1], 1.0 / held.layout_sigma)]))
        return np.vstack([rows, prior])

    x = np.concatenate([setup.theta[columns], np.zeros(0 if basis is None else basis.shape[1])])
    for loss in ("soft_l1", "cauchy"):
        scale = max(1.0, float(np.median(np.abs(residual(x)[: 2 * int(mask.sum())]))) * 1.5)
        x = least_squares(residual, x, slopes, loss=loss, f_scale=scale, x_scale="jac", max_nfev=60).x
    return place(x).folded()
