"""Plan of poses that make the parameters of the bench's geometry observable, within travel and guard volume."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hil.config.tables.machine import NAMES, PARAMETERS
from hil.core.csv_table import read_csv
from hil.core.files import MIB
from hil.core.messages import Array
from hil.errors import BadInput
from hil.parts.geometry.fit import UNIT
from hil.parts.geometry.model import MachineModel
from hil.parts.geometry.observations import AXIS_COLUMNS, write_table
from hil.parts.vision.view_plan import IsClear, short_way

_CANDIDATES: Final = 5  # per pose
_TRIES: Final = 40  # per candidate
_TRAVEL_MARGIN: Final = 0.01  # fraction of the travel
_POLE: Final = 1.31  # rad, largest angle of the middle gimbal
_ENDS: Final = 0.35  # fraction of the numbers of a candidate that are at an end of the travel
_COLUMNS: Final = ("pose", *AXIS_COLUMNS, "reason")

Shown = Callable[[Array, str], np.ndarray]
"""Whether a source has a pose at axes (n, 6): mask (n,)."""
Proposal = Callable[[np.random.Generator], Array]
"""Returns axes, (6,), m and rad, at random, which may be beyond the travel."""


@dataclass(frozen=True)
class GeometryPlan:
    """Poses in the order of clear ways. axes: (n, 6), m and rad. reasons: what each is for. worst: largest standard
    deviation of a position, m, and of an attitude, rad, over the candidates after the fit. not_observable: names."""

    axes: Array
    reasons: tuple[str, ...]
    worst: tuple[float, float]
    not_observable: tuple[str, ...]


def plan_poses(
    model: MachineModel,
    bench: np.record,
    count: int,
    sigmas: dict[str, Array],
    shown: Shown,
    proposals: Sequence[Proposal],
    is_clear: IsClear,
    rng: np.random.Generator,
) -> GeometryPlan:
    """Return ``count`` poses, chosen one after the other for the largest determinant of the information matrix.

    bench: BENCH_PARAMS. sigmas: (6,) of each source. proposals: of candidates, in turn. Raises BadInput if too few can
    be reached.
    """
    candidates = _candidates(bench, _CANDIDATES * count, proposals, is_clear, rng)
    if len(candidates) < count:
        text = f"{len(candidates)} poses within travel and guard volume, {count} are required"
        raise BadInput.single("--poses", "", text)
    slopes = _whitened(model, candidates, sigmas, shown)
    chosen, reasons = _most_informative(slopes, count)
    order = short_way(candidates[chosen], bench, is_clear)
    chosen, reasons = [chosen[k] for k in order], [reasons[k] for k in order]
    fitted = [chosen[k] for k in range(len(chosen)) if k % 3 != 2]  # a third is held out
    information = np.einsum("nij,nik->jk", slopes[fitted], slopes[fitted])
    values, vectors = np.linalg.eigh(information)
    known = values > 1.0
    covariance = (vectors[:, known] / values[known]) @ vectors[:, known].T
    hidden = (vectors[:, ~known] ** 2).sum(axis=1)
    pose = model.predict(np.zeros(PARAMETERS), candidates, np.full(len(candidates), "tracker")).slopes * UNIT
    pose[:, :, hidden > 1e-5] = 0.0
    sigma = np.sqrt(np.einsum("nij,jk,nik->ni", pose, covariance, pose))
    names = tuple(name for name, part in zip(NAMES, hidden, strict=True) if part > 1e-5)
    return GeometryPlan(candidates[chosen], tuple(reasons), (sigma[:, :3].max(), sigma[:, 3:].max()), names)


def within_travel(bench: np.record, rng: np.random.Generator) -> Array:
    """Return axes, (6,), m and rad, within the travel of BENCH_PARAMS, each often at an end of it."""
    low, high = _travel(bench)
    axes = rng.uniform(low, high)
    ends: Array = np.where(rng.uniform(size=6) < 0.5, low, high)
    return np.where(rng.uniform(size=6) < _ENDS, ends, axes)


def _travel(bench: np.record) -> tuple[Array, Array]:
    low, high = np.array(bench.low), np.array(bench.high)
    margin = _TRAVEL_MARGIN * (high - low)
    low, high, middle = low + margin, high - margin, 3 + int(bench.order[1])
    low[middle], high[middle] = max(low[middle], -_POLE), min(high[middle], _POLE)
    return low, high


def _candidates(
    bench: np.record, count: int, proposals: Sequence[Proposal], is_clear: IsClear, rng: np.random.Generator
) -> Array:
    low, high = _travel(bench)
    candidates: list[Array] = []
    for k in range(_TRIES * count):
        axes = proposals[k % len(proposals)](rng)
        if (axes >= low).all() and (axes <= high).all() and is_clear(axes, axes):
            candidates.append(axes)
            if len(candidates) == count:
                break
    return np.array(candidates).reshape(-1, 6)


def _whitened(model: MachineModel, axes: Array, sigmas: dict[str, Array], shown: Shown) -> Array:
    """Return the slopes (n, 6 per source, PARAMETERS) in units of sigma, zero for a source without a pose."""
    blocks = []
    for source, sigma in sigmas.items():
        slopes = model.predict(np.zeros(PARAMETERS), axes, np.full(len(axes), source)).slopes
        block = UNIT * slopes / sigma[:, None]
        block[~shown(axes, source)] = 0.0
        blocks.append(block)
    return np.concatenate(blocks, axis=1)


def _most_informative(slopes: Array, count: int) -> tuple[list[int], list[str]]:
    inverse = np.eye(PARAMETERS)  # the prior: UNIT of each parameter
    remaining = list(range(len(slopes)))
    chosen, reasons = [], []
    for _ in range(count):
        rows = slopes[remaining]
        projected = rows @ inverse
        gram = projected @ rows.transpose(0, 2, 1) + np.eye(rows.shape[1])
        best = int(np.linalg.slogdet(gram)[1].argmax())
        chosen.append(remaining.pop(best))
        gain = projected[best].T @ np.linalg.solve(gram[best], projected[best])
        share = np.diag(gain) / np.diag(inverse)
        name = NAMES[int(share.argmax())]
        reasons.append(f"{name}: variance less by {100.0 * share.max():.0f} %")
        inverse = inverse - gain
    return chosen, reasons


def write_plan(plan: GeometryPlan, path: str) -> None:
    """Write a CSV file. Raises BadInput if it cannot be written."""
    rows = enumerate(zip(plan.axes, plan.reasons, strict=True), start=1)
    write_table(path, _COLUMNS, ([k, *(f"{x:.9g}" for x in axes), reason] for k, (axes, reason) in rows))


def read_plan(path: str) -> Array:
    """Return the axes, (n, 6), m and rad, of a plan; raise BadInput."""
    table = read_csv(Path(path), MIB, AXIS_COLUMNS, what="pose")
    axes = np.array([[table.number(line, name, row[name]) for name in AXIS_COLUMNS] for line, row in table.rows])
    table.check()
    return axes
