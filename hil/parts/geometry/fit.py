"""Bundle fit of the bench's geometry to observed poses: robust, with a third held out, and what is not observable."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.config.bench_geometry import BenchGeometryFile, content_digest, nominal_digest
from hil.config.tables.machine import NAMES, PARAMETERS, ROTATIONS, MachineGeometry
from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths.chi_square import upper_quantile
from hil.parts.geometry.model import MachineModel
from hil.parts.geometry.observations import PoseObservations

UNIT: Final = 1e-3
"""m and rad: parameters and combinations of them that are known less well than this are not observable."""
_NULL: Final = 1e-5  # largest fraction of a parameter that is in what is not observable
_HELD_OUT: Final = 3  # every third pose
_GROSS: Final = 1e-5  # probability of the residuals of a pose below which it is rejected
_REJECTED_MAX: Final = 0.2
_CHANCE: Final = 1e-4  # probability of the held-out residuals below which the fit is refused
_ITERATIONS: Final = 30
_PASSES: Final = 5
_NOISE_MAX: Final = 1.5
_HUBER: Final = 3.5  # of the root of the weighted squares of a pose's six components


@dataclass(frozen=True)
class Limits:
    """Largest parameters that are errors of a bench: beyond them its rig file describes another one, m and rad."""

    length: float = 0.010
    angle: float = 0.0175
    base_factor: float = 5.0


@dataclass(frozen=True)
class Fitted:
    """Result of a fit. vector: (PARAMETERS,), with the observed parameters, m and rad. whole: with the solution of
    least norm for the others, which predicts the observations. observed: (PARAMETERS,), mask. covariance: (PARAMETERS,
    PARAMETERS), zero for those not observed. used, held_out, rejected: masks of the observations. chi_square, dof: of
    those used. held_chi_square, held_dof: of those held out."""

    vector: Array
    whole: Array
    observed: np.ndarray
    covariance: Array
    used: np.ndarray
    held_out: np.ndarray
    rejected: np.ndarray
    chi_square: float
    dof: int
    held_chi_square: float
    held_dof: int
    held_rms: tuple[float, float]

    @property
    def not_observed(self) -> list[str]:
        """Names of the parameters that are not observable, in their order."""
        return [name for name, known in zip(NAMES, self.observed, strict=True) if not known]

    @property
    def noise(self) -> float:
        """Factor of the given sigmas by the residuals, at least 1, by which the covariance is enlarged."""
        return float(np.sqrt(max(1.0, self.chi_square / max(1, self.dof))))

    def problem(self, limits: Limits) -> str:
        """Return why the result must not be used, "" if it may."""
        share = self.rejected.mean()
        if share > _REJECTED_MAX:
            return f"{100.0 * share:.0f} % of the poses are gross errors, allowed {100.0 * _REJECTED_MAX:g} %"
        if self.noise > _NOISE_MAX:
            return (
                f"residuals are {self.noise:.1f} times the given sigmas, allowed {_NOISE_MAX:g}: the bench has errors "
                "that the model does not have, or the sigmas are too small"
            )
        if self.held_dof and self.held_chi_square > self.noise**2 * upper_quantile(_CHANCE, self.held_dof):
            ratio = np.sqrt(self.held_chi_square / self.held_dof) / self.noise
            return (
                f"poses held out are off by {1e3 * self.held_rms[0]:.3f} mm, {np.degrees(self.held_rms[1]):.4f} deg "
                f"rms, {ratio:.1f} times what the fit predicts: the bench has errors that the model does not have"
            )
        largest = np.where(ROTATIONS, limits.angle, limits.length)
        largest = largest * np.where([name.startswith("base") for name in NAMES], limits.base_factor, 1.0)
        share = np.abs(self.whole) / largest
        k = int(share.argmax())
        if share[k] > 1.0:
            text = _text(self.whole[k], bool(ROTATIONS[k]))
            return (
                f"{NAMES[k]} is {text}, allowed {_text(largest[k], bool(ROTATIONS[k]))}: the rig file describes "
                "another bench: correct arms and mountings in table [bench], and fit again"
            )
        return ""


def _text(value: float, is_rotation: bool) -> str:
    return f"{np.degrees(value):.3g} deg" if is_rotation else f"{1e3 * value:.3g} mm"


def fit(model: MachineModel, observations: PoseObservations) -> Fitted:
    """Return the parameters by least squares. Raises BadInput for too few poses."""
    poses = np.unique(observations.pose)
    held_out = np.isin(observations.pose, poses[_HELD_OUT - 1 :: _HELD_OUT])
    if len(poses) < 2 * _HELD_OUT:
        raise BadInput.single("observations", "", f"{len(poses)} poses, at least {2 * _HELD_OUT} are required")
    vector, used, gross = np.zeros(PARAMETERS), ~held_out, np.zeros(len(observations), dtype=bool)
    for passes in range(_PASSES):
        vector, singular, right, chi = _solved(model, observations, used & ~gross, vector, robust=passes == 0)
        before = gross
        noise = max(1.0, float(np.median(chi[used])) / _MEDIAN_6)
        gross = chi > noise * upper_quantile(_GROSS, 6)
        if passes and (gross == before).all():
            break
    used = used & ~gross
    kept = singular > 1.0
    null = 1.0 - (right[kept] ** 2).sum(axis=0)
    observed = null < _NULL
    covariance = UNIT**2 * (right[kept].T / singular[kept] ** 2) @ right[kept]
    dof = 6 * int(used.sum()) - int(kept.sum())
    if dof <= 0:
        text = f"{len(np.unique(observations.pose[used]))} poses determine {int(kept.sum())} parameters: give more"
        raise BadInput.single("observations", "", text)
    chi_square = float(chi[used].sum())
    covariance = covariance * max(1.0, chi_square / dof)
    predicted = model.predict(vector, observations.axes, observations.source)
    residuals = predicted.residuals(observations.value)
    held = held_out & ~gross
    held_chi, held_dof = 0.0, 6 * int(held.sum())
    if held_dof:
        slopes = predicted.slopes[held].reshape(held_dof, PARAMETERS)
        total = slopes @ covariance @ slopes.T + np.diag(observations.sigma[held].ravel() ** 2)
        off = residuals[held].ravel()
        held_chi = float(off @ np.linalg.solve(total, off))
    rms = tuple(float(np.sqrt(np.mean(residuals[held][:, part] ** 2))) if held_dof else 0.0 for part in _PARTS)
    covariance[~observed] = 0.0
    covariance[:, ~observed] = 0.0
    return Fitted(
        np.where(observed, vector, 0.0), vector, observed, covariance, used, held_out, gross, chi_square, dof, held_chi,
        held_dof, (rms[0], rms[1]),
    )  # fmt: skip


_MEDIAN_6: Final = 5.348  # of chi-square with six degrees of freedom
_PARTS: Final = (slice(0, 3), slice(3, 6))


def _solved(
    model: MachineModel, observations: PoseObservations, used: np.ndarray, vector: Array, robust: bool
) -> tuple[Array, Array, Array, Array]:
    """Return the solution of least norm from ``vector`` on, singular values and right vectors of the slopes in UNIT
    over sigma, and the weighted squares of all observations."""
    weight = np.ones(len(observations))
    for _ in range(_ITERATIONS):
        predicted = model.predict(vector, observations.axes, observations.source)
        off = predicted.residuals(observations.value) / observations.sigma
        chi = (off * off).sum(axis=1)
        if robust:
            weight = np.minimum(1.0, _HUBER / np.sqrt(np.maximum(chi, 1e-12)))
        root = np.sqrt(weight)[used, None]
        slopes = UNIT * predicted.slopes / observations.sigma[:, :, None]
        left, singular, right = np.linalg.svd(
            (slopes[used] * root[:, :, None]).reshape(-1, PARAMETERS), full_matrices=False
        )
        kept = singular > 1.0
        change = UNIT * right[kept].T @ ((left[:, kept].T @ (off[used] * root).ravel()) / singular[kept])
        vector = vector + change
        if np.abs(change).max() < 1e-9:
            break
    return vector, singular, right, chi


def geometry_file(model: MachineModel, fitted: Fitted, observations: PoseObservations, date: str) -> BenchGeometryFile:
    """Return the content of the geometry file."""
    numbers = np.flatnonzero(fitted.observed)
    lower = [[float(f"{fitted.covariance[i, j]:.6e}") for j in numbers[: k + 1]] for k, i in enumerate(numbers)]
    table: dict[str, Any] = {
        "format": "hil bench geometry 1",
        "date": date,
        "digest": "sha256:" + 64 * "0",
        "rig": nominal_digest(model.rig),
        "source": sorted(set(observations.source.tolist())),
        "poses": len(np.unique(observations.pose[fitted.used])),
        "rejected": int(fitted.rejected.sum()),
        "held_out": {
            "poses": len(np.unique(observations.pose[fitted.held_out])),
            "rms_m": float(f"{fitted.held_rms[0]:.4e}"),
            "rms_deg": float(f"{np.degrees(fitted.held_rms[1]):.4e}"),
            "chi_square": float(f"{fitted.held_chi_square:.6g}"),
        },
        "parameters": MachineGeometry.tables_of(np.round(fitted.vector, 10)),
        "not_observed": fitted.not_observed,
        "covariance": lower,
    }
    content = BenchGeometryFile.model_validate_json(json.dumps(table))
    digest = content_digest(content.model_dump(mode="json"))
    return content.model_copy(update={"digest": digest})
