"""Sobol' indices of a function with known ones, and the points of a campaign."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.core.messages import Array
from hil.parts.campaigns.rare_campaign import halving_factor
from hil.parts.campaigns.sobol_indices import index_rows, sobol_indices, sobol_point


def ishigami(unit: Array) -> Array:
    """Return Ishigami's function, (n,), of points in the unit cube, (n, 3)."""
    x = math.pi * (2.0 * unit - 1.0)
    return np.asarray(np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]))


def outcomes(function: Callable[[Array], Array], n: int, d: int, seed: int) -> tuple[Array, Array, Array]:
    """Return the outcomes of a function at the points of a campaign; its noise is not used."""
    points = np.array([[sobol_point(seed, row * (d + 3) + j, d)[0] for j in range(d + 3)] for row in range(n)])
    values = np.array([function(points[:, j]) for j in range(d + 3)])
    return values[0], values[1], values[2:]


def test_indices_of_ishigami() -> None:
    """Saltelli et al., Global Sensitivity Analysis (2008), with a = 7, b = 0.1."""
    found = sobol_indices(*outcomes(ishigami, 4000, 3, 1))
    for kind, known in (("first", (0.3139, 0.4424, 0.0, 0.0)), ("total", (0.5576, 0.4424, 0.2437, 0.0))):
        for (index, low, high), value in zip(found[kind], known, strict=True):
            assert index == pytest.approx(value, abs=0.05)
            assert low - 1e-12 <= value <= high + 1e-12 or abs(index - value) < 0.02
            assert high - low < 0.12
    rows = index_rows(found, ["a", "b", "c", "noise"])
    assert [row["dispersion"] for row in rows] == ["a", "b", "c", "noise"]
    assert rows[3]["total"]["index"] == 0.0


@pytest.mark.slow
def test_intervals_hold_the_indices_in_19_of_20_repetitions() -> None:
    known = np.array([[0.3139, 0.4424, 0.0], [0.5576, 0.4424, 0.2437]])
    held = []
    for seed in range(40):
        found = sobol_indices(*outcomes(ishigami, 500, 3, seed))
        for kind, values in zip(("first", "total"), known, strict=True):
            held += [low <= value <= high for (_, low, high), value in zip(found[kind], values, strict=False)]
    assert np.mean(held) == pytest.approx(0.95, abs=0.05)


def test_outcome_without_variance_or_value_has_no_index() -> None:
    a, b, mixed = outcomes(lambda unit: np.ones(len(unit)), 20, 2, 0)
    assert np.isnan(sobol_indices(a, b, mixed)["total"]).all()
    rows: list[dict[str, Any]] = index_rows(sobol_indices(np.full(20, np.nan), b, mixed), ["a", "b", "noise"])
    assert rows[0]["first"] == {"index": None, "low": None, "high": None}


def test_each_case_of_a_row_takes_one_number_or_the_noise_from_the_second_point() -> None:
    d = 4
    row = [sobol_point(7, 3 * (d + 3) + j, d) for j in range(d + 3)]
    (a, noise_a), (b, noise_b) = row[:2]
    assert noise_a != noise_b
    for i, (unit, noise) in enumerate(row[2:]):
        from_b = unit == b
        assert from_b.tolist() == [k == i for k in range(d)]
        assert (unit == a).tolist() == [k != i for k in range(d)]
        assert noise == (noise_b if i == d else noise_a)


def test_factor_that_halves_an_event_is_that_of_the_normal_tail() -> None:
    """P(x > 3) = 1.35e-3 with sigma 1; half of it needs 3 / sigma = isf(0.675e-3) = 3.2051."""
    normals = np.random.default_rng(0).standard_normal(3_000_000)
    event = normals[normals > 3.0]
    weights = np.full(len(event), 1.0 / len(event))
    assert halving_factor(event, weights, uniform=False) == pytest.approx(3.0 / 3.2051, abs=0.011)
    ends = normals[np.abs(normals) > 1.6449]  # the outer tenth of a uniform number: 0.9 + 0.1 * f of it is left
    weights = np.full(len(ends), 1.0 / len(ends))
    assert halving_factor(ends, weights, uniform=True) == pytest.approx(0.95, abs=0.011)
    assert halving_factor(normals[:1000], np.full(1000, 1e-3), uniform=False) is None


def test_figure_of_the_largest_indices(tmp_path: Path) -> None:
    from hil.parts.campaigns.figure import draw_indices

    rows = index_rows(sobol_indices(*outcomes(ishigami, 50, 3, 1)), ["a", "b", "c", "noise"])
    draw_indices({"sobol": {"control_margin": rows, "propellant_kg": []}}, tmp_path / "sobol.png")
    assert (tmp_path / "sobol.png").stat().st_size > 5_000
