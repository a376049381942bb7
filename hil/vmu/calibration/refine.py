"""Joint refinement of all shared parameters and the encoders' errors on all pixels of all views, by Gauss-Newton.

Every view has six own unknowns, the errors of the axes' encoders, constrained by the encoders'
sigmas. They affect no other view, so they are eliminated view by view (Schur complement), and the remaining system
has only the shared unknowns, however many views there are (docs/explanation/calibration.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hil.core.messages import Array
from hil.vmu.calibration.model import PARTS, Observations, Setup, TurntableModel, project_view
from hil.vmu.kernels.chain import COMMON, SCALE

_STEPS = 60
_THIRD, _LEAST_K1 = 0.25, 0.1  # distortion of lenses by k3 at the corner of the image, relative to that by k1


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of the parameters.

    free: (COMMON,) of bool. centre, sigma: (COMMON,). axis_sigma: (6,), of the encoders, m and rad.
    layout_sigma: m, of each LED coordinate; 0: the layout is fixed.
    """

    free: Array
    centre: Array
    sigma: Array
    axis_sigma: Array
    layout_sigma: float


def weak_prior(
    setup: Setup, keep: tuple[str, ...], axis_sigma: Array, layout_sigma: float, scale_sigma: float
) -> Prior:
    """Return a weak prior around ``setup``, wide enough to matter only for what the views leave open.

    keep: PARTS to be kept fixed. layout_sigma: 0 for a rigid target, whose scale then has ``scale_sigma``.
    """
    sigma = np.empty(COMMON)
    for part, size in zip(("left", "right"), setup.sizes, strict=True):
        focal, k1 = setup.theta[PARTS[part]][0], setup.theta[PARTS[part]][4]
        corner = 0.5 * float(np.hypot(*size)) / focal
        k3 = min(3.0, _THIRD * max(abs(k1), _LEAST_K1) / corner**4)
        sigma[PARTS[part]] = (0.2 * focal, 0.2 * focal, 100.0, 100.0, 1.0, 2.0, 0.05, 0.05, k3)
    sigma[PARTS["stereo"]] = (0.2, 0.2, 0.2, 0.1, 0.1, 0.1)
    sigma[PARTS["mounting"]] = (1.0, 1.0, 1.0, 2.0, 2.0, 2.0)
    sigma[PARTS["target"]] = (1.0, 1.0, 1.0, 20.0, 20.0, 20.0)
    sigma[SCALE] = scale_sigma
    free = np.ones(COMMON, dtype=bool)
    for part in keep:
        if part != "leds":
            free[PARTS[part]] = False
    free[SCALE] = layout_sigma == 0.0 and scale_sigma > 0.0
    return Prior(free, setup.theta.copy(), sigma, axis_sigma, layout_sigma)


@dataclass(frozen=True, slots=True)
class RefinementFit:
    """Result of the refinement.

    covariance: (COMMON, COMMON), 3 m more if the layout of the LEDs is estimated too; zero for fixed parameters.
    offsets: (n, 6), errors of the axes' encoders.
    residuals: (n, 2, m, 2), px, measured minus projected, NaN if not measured. noise: factor on the assumed standard
    deviations of the pixels. redundancy: of the pixels. view_square: (n,), sum of the squares of each
    view's white residuals and offsets; view_freedom: their number of degrees of freedom.
    axis_ratio: (2,), of rails and of gimbals, square root of the variance component of their assumed sigmas.
    axis_redundancy: (2,).
    """

    setup: Setup
    covariance: Array
    offsets: Array
    residuals: Array
    noise: float
    redundancy: float
    view_square: Array
    view_freedom: Array
    axis_ratio: Array
    axis_redundancy: Array

    @property
    def sigma(self) -> Array:
        """Return the standard deviations, (COMMON,) or (COMMON + 3 m,)."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def rms_px(self) -> float:
        """Return the RMS of all residuals, each of u and v, px."""
        return float(np.sqrt(np.nanmean(np.square(self.residuals))))


def layout_basis(points: Array) -> Array:
    """Return the deformations of the points without rigid motion, (3 m, 3 m - 6) with orthonormal columns."""
    rigid = []
    centred = points - points.mean(axis=0)
    for axis in np.eye(3):
        rigid += [np.tile(axis, len(points)), np.cross(axis, centred).ravel()]
    u, s, _ = np.linalg.svd(np.array(rigid).T, full_matrices=True)
    return np.ascontiguousarray(u[:, int((s > 1e-9 * s[0]).sum()) :])


def whiteners(covariance: Array, observed: Array) -> Array:
    """Return W (..., 2, 2) with W cov W' = 1, zero if a point was not measured."""
    out = np.zeros(covariance.shape)
    out[observed] = np.linalg.inv(np.linalg.cholesky(covariance[observed]))
    return out


class _System:
    """Normal equations of one linearisation, with the views' own unknowns eliminated."""

    def __init__(self, problem: RefinementProblem, setup: Setup, offsets: Array, noise: float) -> None:
        held, observations = problem.prior, problem.observations
        n = len(observations.names)
        shared = problem.shared
        self.axis_weight = 1.0 / held.axis_sigma**2
        prior = np.zeros(shared)
        gap = np.zeros(shared)
        common = problem.columns
        prior[: len(common)] = 1.0 / held.sigma[common] ** 2
        gap[: len(common)] = (held.centre - setup.theta)[common]
        # rotations are relative to the current ones: their prior is too wide to matter
        for part in ("mounting", "target"):
            rotation = range(PARTS[part].start, PARTS[part].start + 3)
            gap[: len(common)][np.isin(common, rotation)] = 0.0
        if problem.basis is not None:
            prior[len(common) :] = 1.0 / held.layout_sigma**2
            gap[len(common) :] = problem.basis.T @ (problem.nominal - setup.points).ravel()
        self.reduced = np.diag(prior)
        self.right = prior * gap
        self.cost = float(prior @ gap**2)
        self.prior = prior
        self.blocks: list[tuple[Array, Array, Array]] = []
        self.residuals = np.full(observations.pixels.shape, np.nan)
        self.rows: list[tuple[Array, Array, Array]] = []
        for i in range(n):
            slopes = project_view(setup, problem.turntable, observations.axes[i] + offsets[i])
            observed = problem.visible[i]
            gaps = np.where(observed[..., None], observations.pixels[i] - slopes.pixels, 0.0)
            self.residuals[i][observed] = gaps[observed]
            white = problem.whiten[i][observed] / noise
            r = np.einsum("kab,kb->ka", white, gaps[observed]).ravel()
            a = np.einsum("kab,kbp->kap", white, slopes.by_common[observed][..., common]).reshape(len(r), -1)
            if problem.basis is not None:
                a = np.hstack([a, self._by_layout(problem.basis, white, slopes.by_point, observed)])
            b = np.einsum("kab,kbp->kap", white, slopes.by_axes[observed]).reshape(len(r), 6)
            if not np.isfinite(r).all():
                self.cost = np.inf
                return
            own = b.T @ b + np.diag(self.axis_weight)
            own_right = b.T @ r - self.axis_weight * offsets[i]
            mixed = np.linalg.solve(own, b.T @ a)
            self.reduced += a.T @ a - (b.T @ a).T @ mixed
            self.right += a.T @ r - mixed.T @ own_right
            self.blocks.append((own, own_right, mixed))
            self.rows.append((r, a, b))
            self.cost += float(r @ r + self.axis_weight @ offsets[i] ** 2)

    @staticmethod
    def _by_layout(basis: Array, white: Array, by_point: Array, observed: Array) -> Array:
        _, which = np.nonzero(observed)
        blocks = basis.reshape(-1, 3, basis.shape[1])[which]
        out: Array = np.einsum("kab,kbc,kcp->kap", white, by_point[observed], blocks)
        return out.reshape(2 * len(which), -1)

    def step(self, damping: float) -> tuple[Array, Array]:
        """Return the change of the shared unknowns and of each view's own."""
        scale = 1.0 / np.sqrt(np.diagonal(self.reduced))
        matrix = self.reduced * scale[:, None] * scale
        matrix[np.diag_indices(len(matrix))] += damping
        change = scale * np.linalg.solve(matrix, scale * self.right)
        own = [np.linalg.solve(h, g) - mixed @ change for h, g, mixed in self.blocks]
        return change, np.array(own)

    def covariance(self) -> Array:
        """Return the covariance of the shared unknowns."""
        scale = 1.0 / np.sqrt(np.diagonal(self.reduced))
        inverse = np.linalg.inv(self.reduced * scale[:, None] * scale)
        out: Array = inverse * scale[:, None] * scale
        return 0.5 * (out + out.T)


class RefinementProblem:
    """Observations of one set of views and the prior; solved by ``solve``."""

    def __init__(
        self,
        observations: Observations,
        turntable: TurntableModel,
        held: Prior,
        nominal: Array,
        basis: Array | None = None,
    ) -> None:
        self.observations = observations
        self.turntable = turntable
        self.prior = held
        self.nominal = nominal
        self.visible = observations.visible
        self.whiten = whiteners(observations.covariance, self.visible)
        self.columns = np.flatnonzero(held.free)
        self.basis = layout_basis(nominal) if basis is None and held.layout_sigma > 0.0 else basis
        self.shared = len(self.columns) + (0 if self.basis is None else self.basis.shape[1])

    def solve(self, start: Setup) -> RefinementFit:
        """Return the fit from ``start``; the noise of the pixels is estimated too."""
        noise, offsets, setup = 1.0, np.zeros(self.observations.axes.shape), start.folded()
        for _ in range(4):
            setup, offsets, system = self._settle(setup, offsets, noise)
            fit = self._fit(setup, offsets, system, noise)
            if abs(fit.noise / noise - 1.0) < 1e-3:
                break
            noise = fit.noise
        return fit

    def _settle(self, setup: Setup, offsets: Array, noise: float) -> tuple[Setup, Array, _System]:
        system, damping = _System(self, setup, offsets, noise), 1e-6
        for _ in range(_STEPS):
            change, own = system.step(damping)
            new_setup, new_offsets = self._moved(setup, change), offsets + own
            tried = _System(self, new_setup, new_offsets, noise)
            if not tried.cost <= system.cost * (1.0 + 1e-12):
                damping = max(damping, 1e-9) * 10.0
                if damping > 1e6:
                    break
                continue
            settled = system.cost - tried.cost < 1e-9 * max(system.cost, 1.0)
            setup, offsets, system, damping = new_setup, new_offsets, tried, damping * 0.1
            if settled:
                break
        return setup, offsets, system

    def _moved(self, setup: Setup, change: Array) -> Setup:
        common = np.zeros(COMMON)
        common[self.columns] = change[: len(self.columns)]
        if self.basis is None:
            return setup.moved(common)
        return setup.moved(common, (self.basis @ change[len(self.columns) :]).reshape(-1, 3))

    def _fit(self, setup: Setup, offsets: Array, system: _System, noise: float) -> RefinementFit:
        shared = system.covariance()
        n = len(offsets)
        axis_freedom = np.empty((n, 6))
        view_square, view_freedom, squares, freedom = np.empty(n), np.empty(n), 0.0, 0.0
        for i, ((own, _, mixed), (r, a, b)) in enumerate(zip(system.blocks, system.rows, strict=True)):
            inverse = np.linalg.inv(own)
            view = inverse + mixed @ shared @ mixed.T
            axis_freedom[i] = 1.0 - np.diagonal(view) * system.axis_weight
            cross = -mixed @ shared  # covariance of the view's own with the shared unknowns
            leverage = float(np.sum((a @ shared) * a) + np.sum((b @ view) * b) + 2.0 * np.sum((b @ cross) * a))
            squares += float(r @ r)
            freedom += len(r) - leverage
            view_square[i] = r @ r + system.axis_weight @ offsets[i] ** 2
            view_freedom[i] = len(r) - leverage + axis_freedom[i].sum()
        in_sigmas = offsets**2 * system.axis_weight
        axis_redundancy = np.array([axis_freedom[:, :3].sum(), axis_freedom[:, 3:].sum()])
        axis_square = np.array([in_sigmas[:, :3].sum(), in_sigmas[:, 3:].sum()])
        noise_estimate = noise * float(np.sqrt(squares / freedom)) if freedom > 1.0 else noise
        spread = np.zeros((COMMON + (0 if self.basis is None else setup.points.size), self.shared))
        spread[self.columns, : len(self.columns)] = np.eye(len(self.columns))
        if self.basis is not None:
            spread[COMMON:, len(self.columns) :] = self.basis
        return RefinementFit(
            setup,
            spread @ shared @ spread.T,
            offsets,
            system.residuals,
            noise_estimate,
            float(freedom),
            view_square,
            view_freedom,
            np.sqrt(axis_square / np.maximum(axis_redundancy, 1e-9)),
            axis_redundancy,
        )


@dataclass(frozen=True, slots=True)
class Information:
    """Information of pixels on all parameters, (COMMON,) or (COMMON + 3 m,): square sum, its gradient, its curvature.

    The encoders' errors are eliminated. rows: number of white residuals. rms_px: of the residuals, with encoder errors.
    """

    matrix: Array
    score: Array
    square: float
    rows: int
    rms_px: float


def information(
    observations: Observations,
    setup: Setup,
    turntable: TurntableModel,
    axis_sigma: Array,
    noise: float,
    with_points: bool,
) -> Information:
    """Return the information of ``observations`` on changes of ``setup``, and of its points if ``with_points``."""
    flat = Prior(np.ones(COMMON, dtype=bool), setup.theta, np.full(COMMON, np.inf), axis_sigma, 0.0)
    problem = RefinementProblem(observations, turntable, flat, setup.points)
    if with_points:
        flat = replace(flat, layout_sigma=np.inf)
        problem = RefinementProblem(observations, turntable, flat, setup.points, basis=np.eye(setup.points.size))
    system = _System(problem, setup, np.zeros(observations.axes.shape), noise)
    square = system.cost - sum(float(right @ np.linalg.solve(own, right)) for own, right, _ in system.blocks)
    rows = 2 * int(problem.visible.sum())
    rms = float(np.sqrt(np.nanmean(np.square(system.residuals))))
    return Information(system.reduced, system.right, square, rows, rms)
