"""Sobol' indices: the part of an outcome's variance that each dispersed number explains, alone and with all others.

First order: A. Saltelli et al., Computer Physics Communications 181 (2010) 259-270, table 2 (b); total: M. J. W.
Jansen, Computer Physics Communications 117 (1999) 35-43. Each of n rows has two random points A and B, and A with each
number in turn from B. The noise of a run, thruster errors and initial sensor errors included, is one number more: its
seed. A row has d + 3 cases for d dispersed numbers.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.core.messages import Array
from hil.maths.random_streams import MixedSeed

_REPETITIONS: Final = 1000  # repetitions of the bootstrap
_ROW: Final = 4  # of the spawn keys of a campaign's seed


def sobol_point(campaign_seed: int, case: int, d: int) -> tuple[Array, MixedSeed]:
    """Return the point of ``case`` in the unit cube of ``d`` dispersed numbers, (d,), and the seed of its noise."""
    row, column = divmod(case, d + 3)
    sequence = np.random.SeedSequence(campaign_seed, spawn_key=(_ROW, row))
    a, b = np.random.Generator(np.random.PCG64(sequence)).random((2, d))
    seeds = sequence.generate_state(2, np.uint64) >> np.uint64(1)
    of_b = np.full(d + 1, column == 1)
    if column >= 2:
        of_b[column - 2] = True
    return np.where(of_b[:d], b, a), MixedSeed.fresh(int(seeds[int(of_b[d])]))


def sobol_indices(a: Array, b: Array, mixed: Array, seed: int = 0) -> dict[str, Array]:
    """Return first-order and total indices with intervals of 95 %, (d, 3): index, low, high.

    a, b: (n,) outcomes of the two sets. mixed: (d, n), with one number of ``b`` in ``a``. Rows with a value that is not
    finite are left out. Indices are nan for an outcome without variance.
    """
    complete = np.isfinite(a) & np.isfinite(b) & np.isfinite(mixed).all(axis=0)
    a, b, mixed = a[complete], b[complete], mixed[:, complete]
    d, n = mixed.shape
    if n < 2 or np.ptp(np.concatenate([a, b])) == 0.0:
        return {"first": np.full((d, 3), np.nan), "total": np.full((d, 3), np.nan)}
    centre = float(np.concatenate([a, b]).mean())  # of the product b (mixed - a), whose variance it reduces
    products = np.concatenate([(b - centre) * (mixed - a), 0.5 * (a - mixed) ** 2])
    squares = 0.5 * ((a - centre) ** 2 + (b - centre) ** 2)
    index = products.mean(axis=1) / squares.mean()
    generator = np.random.default_rng(seed)
    drawn = np.empty((_REPETITIONS, 2 * d))
    for row in drawn:
        counts = np.bincount(generator.integers(n, size=n), minlength=n) / n
        row[:] = (products @ counts) / (squares @ counts)
    tail = 2.5
    low, high = np.percentile(drawn, (tail, 100.0 - tail), axis=0)
    intervals = np.stack([index, low, high], axis=1)
    return {"first": intervals[:d], "total": intervals[d:]}


def index_rows(indices: dict[str, Array], names: list[str]) -> list[dict[str, Any]]:
    """Return the indices of each dispersed number, the largest total one first."""
    order = np.argsort(-np.nan_to_num(indices["total"][:, 0], nan=-1.0), kind="stable")
    rows = []
    for i in order:
        cells: dict[str, Any] = {"dispersion": names[i]}
        for kind in ("first", "total"):
            index, low, high = (float(x) if np.isfinite(x) else None for x in indices[kind][i])
            cells[kind] = {"index": index, "low": low, "high": high}
        rows.append(cells)
    return rows
