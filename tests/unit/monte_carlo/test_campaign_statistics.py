"""Intervals, worst cases and rankings against numbers that are known otherwise."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.parts.campaigns.outcome import failed_row
from hil.parts.campaigns.statistics import compare, mean_interval, summarise, wilson
from hil.parts.campaigns.store import Store


def finished(folder: Path, rows: list[dict[str, Any]], names: list[str]) -> Store:
    """Return the store of a campaign whose cases have these columns, all else as of a case that was not flown."""
    store = Store(folder, {"made": "up"}, names)
    for case, row in enumerate(rows):
        row |= {"case": case, "seed": case}
    whole = [failed_row("completed") | row for row in rows]
    for first, _ in store.missing(len(rows)):
        store.put(first, whole[first : first + 50])
    store.finish(len(rows))
    return store


def test_wilson_interval_is_the_published_one() -> None:
    found = wilson(81, 263)  # Newcombe, Statistics in Medicine 17 (1998), table I: 0.2553, 0.3662
    assert found["rate"] == pytest.approx(81 / 263)
    assert found["low"] == pytest.approx(0.2553, abs=5e-5)
    assert found["high"] == pytest.approx(0.3662, abs=5e-5)
    assert wilson(10, 10)["low"] == pytest.approx(0.7225, abs=5e-5)


def test_interval_of_a_mean_has_its_coverage(rng: np.random.Generator) -> None:
    found = [mean_interval(rng.normal(3.0, 2.0, 12)) for _ in range(1000)]
    covered = sum(f["low"] <= 3.0 <= f["high"] for f in found)  # type: ignore[operator]
    assert 925 <= covered <= 972
    assert mean_interval(np.array([np.nan, 2.0])) == {"n": 1, "mean": 2.0, "low": None, "high": None}


def test_summary_finds_worst_cases_and_failures(tmp_path: Path, rng: np.random.Generator) -> None:
    drawn = rng.normal(size=(120, 2))
    rows = [
        {"passed": True, "a": x, "b": y, "propellant_kg": 1.0 + 0.1 * x**3, "position_m_x": 0.001 * (k % 7)}
        for k, (x, y) in enumerate(drawn)
    ]
    rows[33] |= {"passed": False, "position_m_x": 0.5, "control_margin": -1.0}
    rows[70] |= failed_row("not flown: no fuel")
    found = summarise(finished(tmp_path / "x", rows, ["a", "b"]), "scheme-1")
    assert found["pass_rate"]["passed"]["passed"] == 118
    assert found["worst"]["position_m"][0] == {"value": 0.5, "case": 33, "table_v": 0.0053}
    assert found["worst"]["rate_degps"][2]["value"] is None
    assert found["stops"] == [{"reason": "not flown: no fuel", "cases": 1, "first_case": 70}]
    assert found["percentiles"]["propellant_kg"]["n"] == 119


def test_comparison_is_made_case_by_case(tmp_path: Path, rng: np.random.Generator) -> None:
    common = rng.normal(5.0, 3.0, 60)
    one = [{"passed": True, "propellant_kg": c} for c in common]
    two = [
        {"passed": k > 2, "accepted": k == 5, "propellant_kg": c + 0.25 + 0.01 * rng.normal()}
        for k, c in enumerate(common)
    ]
    two[9]["propellant_kg"] = None
    stores = [finished(tmp_path / name, rows, []) for name, rows in (("one", one), ("two", two))]
    found = compare(stores[0], stores[1], ("one", "two"))
    difference = found["difference"]["propellant_kg"]
    assert difference["n"] == 59
    assert difference["mean"] == pytest.approx(0.25, abs=0.005)
    assert difference["high"] - difference["low"] < 0.01  # the common part cancels
    assert found["pass_rate"]["first_alone"] == 3
    assert found["pass_rate"]["second_alone"] == 0
    assert (found["accepted_rate"]["first_alone"], found["accepted_rate"]["second_alone"]) == (0, 1)
