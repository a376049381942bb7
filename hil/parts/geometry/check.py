"""Drift check of the bench against its geometry file, and the control chart of earlier checks.

Residuals of a few poses are compared with what the file and the observations are worth, chi-square; if they are larger,
the cause is the one whose own error explains them best. The chart is a CSV file that each check appends to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from hil.config.bench_geometry import geometry_of
from hil.config.rig import BENCH_AXES
from hil.config.tables.machine import NAMES
from hil.core.csv_table import read_csv
from hil.core.files import MIB, read_text
from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths import quat
from hil.maths.chi_square import upper_quantile
from hil.params.bench_budget import parameter_covariance
from hil.parts.geometry.model import MachineModel
from hil.parts.geometry.observations import PoseObservations, write_table

ALARM: Final = 1e-3
"""Probability of a chance result below which the bench has drifted."""
_CHART: Final = (
    "date", "poses", "chi_square", "dof", "limit", "verdict",
    "mean_x_m", "mean_y_m", "mean_z_m", "mean_x_rad", "mean_y_rad", "mean_z_rad",
)  # fmt: skip
_SIGMAS: Final = 3.0
_LEAST_CHECKS: Final = 5
_AXIS_STEP: Final = 1e-6  # m, rad
_FREE: Final = 0.1  # m, rad, 1 sigma of an error that is sought


@dataclass(frozen=True)
class GeometryDrift:
    """Result. mean: (6,), mean residual, m and rad. cause: what explains a drift best, with its size."""

    poses: int
    chi_square: float
    dof: int
    mean: Array
    cause: str

    @property
    def limit(self) -> float:
        """Value that chi-square exceeds with the probability ALARM if nothing has changed."""
        return upper_quantile(ALARM, self.dof)

    @property
    def passed(self) -> bool:
        return self.chi_square <= self.limit

    @property
    def verdict(self) -> str:
        return "no drift" if self.passed else self.cause


def check(model: MachineModel, observations: PoseObservations) -> GeometryDrift:
    """Return the result of the check. Raises BadInput without a geometry file."""
    rig = model.rig
    geometry = geometry_of(rig)
    if geometry is None:
        raise BadInput.single(rig.name, "rig.bench.geometry_file", "is missing: a file of hil geometry fit")
    vector = geometry.parameters.vector
    predicted = model.predict(vector, observations.axes, observations.source)
    off = predicted.residuals(observations.value)
    n = off.size
    slopes = predicted.slopes.reshape(n, -1)
    drift = [rig.bench.thermal_sigma_m] * 3 + [np.radians(rig.bench.thermal_sigma_deg)] * 3
    covariance = slopes @ parameter_covariance(rig) @ slopes.T + np.diag(observations.sigma.ravel() ** 2)
    covariance += np.kron(np.ones((len(observations), len(observations))), np.diag(np.square(drift)))
    chi_square = _weighted(covariance, off)
    poses = len(np.unique(observations.pose))
    result = GeometryDrift(poses, chi_square, n, off.mean(axis=0), "")
    if result.passed:
        return result
    return GeometryDrift(poses, chi_square, n, off.mean(axis=0), _cause(model, vector, observations, off, covariance))


def _weighted(covariance: Array, off: Array) -> float:
    return float(off.ravel() @ np.linalg.solve(covariance, off.ravel()))


def _cause(model: MachineModel, vector: Array, observations: PoseObservations, off: Array, covariance: Array) -> str:
    """Return the cause whose free parameters leave the least chi-square, with a penalty for each of them."""
    weight = np.asarray(np.linalg.inv(covariance), dtype=float)
    n = off.size
    nominal = model.predict(vector, observations.axes, observations.source)
    slopes: Array = nominal.slopes.reshape(n, -1)
    causes = [(_weighted(covariance, nominal.residuals(_swapped(observations).value)), "bodies swapped")]
    for name in ("base", "camera"):
        of_body = slopes[:, [k for k, each in enumerate(NAMES) if each.startswith(name)]]
        if of_body.any():
            causes.append(_explained(weight, of_body, off, partial(_pose_text, name)))
    for axis, name in enumerate(BENCH_AXES):
        moved = observations.axes.copy()
        moved[:, axis] += _AXIS_STEP
        shifted = model.predict(vector, moved, observations.source)
        value = np.hstack([shifted.r, [quat.to_rotation_vector(q) for q in shifted.q]])
        slope = nominal.residuals(value).reshape(n, 1) / _AXIS_STEP
        causes.append(_explained(weight, slope, off, partial(_axis_text, name)))
    cost, text = min(causes)
    return f"geometry changed, nearest cause: {text}" if cost > 2.0 * upper_quantile(ALARM, n) else text


def _axis_text(name: str, size: Array) -> str:
    if name.startswith("rails"):
        return f"{name} is off by {1e3 * size[0]:.2f} mm, or the base has moved along it"
    return f"{name} is off by {np.degrees(size[0]):.3f} deg"


def _pose_text(name: str, size: Array) -> str:
    moved, turned = 1e3 * np.linalg.norm(size[:3]), np.degrees(np.linalg.norm(size[3:]))
    return f"{name} moved by {moved:.2f} mm, {turned:.3f} deg"


def _explained(weight: Array, slopes: Array, off: Array, text: Callable[[Array], str]) -> tuple[float, str]:
    """Return chi-square and penalty after the errors with ``slopes`` (n, k) have been estimated, and their text."""
    normal = slopes.T @ weight @ slopes + np.eye(slopes.shape[1]) / _FREE**2
    y = off.ravel()
    size = np.asarray(np.linalg.solve(normal, slopes.T @ weight @ y), dtype=float)
    rest = y - slopes @ size
    return float(rest @ weight @ rest + slopes.shape[1] * np.log(len(y))), text(size)


def _swapped(observations: PoseObservations) -> PoseObservations:
    """Return the observations with chaser and target in place of each other."""
    value = observations.value.copy()
    for k in np.flatnonzero(observations.source == "tracker"):
        q = quat.from_rotation_vector(value[k, 3:])
        value[k] = [*-quat.transform(q, value[k, :3]), *-value[k, 3:]]
    return PoseObservations(observations.pose, observations.axes, value, observations.sigma, observations.source)


@dataclass(frozen=True)
class ChartRow:
    """Earlier check. mean: (6,)."""

    date: str
    mean: tuple[float, ...]


def read_chart(path: Path) -> list[ChartRow]:
    """Return the earlier checks, none without a file; raise BadInput."""
    if not path.exists():
        return []
    table = read_csv(path, MIB, _CHART, what="check")
    means = [tuple(table.number(line, name, row[name]) for name in _CHART[6:]) for line, row in table.rows]
    table.check()
    return [ChartRow(row["date"], mean) for (_, row), mean in zip(table.rows, means, strict=True)]


def append_to_chart(path: Path, date: str, result: GeometryDrift) -> str:
    """Append ``result``; return its place in the chart, "" while it has too few checks. Raises BadInput."""
    earlier = read_chart(path)
    numbers = (f"{result.chi_square:.4g}", result.dof, f"{result.limit:.4g}")
    row = [date, result.poses, *numbers, result.verdict, *(f"{x:.4g}" for x in result.mean)]
    write_table(str(path), _CHART, [row], read_text(path, MIB) if earlier else "")
    if len(earlier) < _LEAST_CHECKS:
        return ""
    means = np.array([each.mean for each in earlier])
    spread = np.maximum(means.std(axis=0, ddof=1), 1e-9)
    off = np.abs(result.mean - means.mean(axis=0)) / spread
    k = int(off.argmax())
    if off[k] <= _SIGMAS:
        return f"within {_SIGMAS:g} sigma of {len(earlier)} earlier checks"
    return f"{_CHART[6 + k]}: {off[k]:.1f} sigma off {len(earlier)} earlier checks, allowed {_SIGMAS:g}"
