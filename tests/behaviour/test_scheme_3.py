"""Vision alone: the sentence of the README about scheme 3, and that its settings are those of the search."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from scipy.stats import binom

from sims.scheme3_search import Flights

ROOT = Path(__file__).resolve().parents[2]


def of_readme() -> tuple[int, int, float]:
    """Return passed runs, all runs and median propellant, kg, that the README gives for scheme 3."""
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    found = re.search(r"scheme 3, vision alone, passes in (\d+) of (\d+) seeds and needs ([\d.]+) kg", text)
    assert found, "the README has no sentence about scheme 3"
    return int(found[1]), int(found[2]), float(found[3])


def test_scheme_3_passes_as_often_as_the_readme_states() -> None:
    passed, of, propellant_kg = of_readme()
    rows = Flights().rows((), 0, 20)
    low, high = binom.interval(0.999, len(rows), passed / of)
    assert low <= sum(row["passed"] for row in rows) <= high
    used = sorted(row["propellant_kg"] for row in rows)
    assert used[len(used) // 2] == pytest.approx(propellant_kg, rel=0.15)


@pytest.mark.slow
def test_readme_has_the_numbers_of_all_its_seeds() -> None:
    """As ``python sims/scheme3_search.py --generations 0`` prints them."""
    passed, of, propellant_kg = of_readme()
    rows = Flights().rows((), 0, of)
    assert sum(row["passed"] for row in rows) == passed
    assert sorted(row["propellant_kg"] for row in rows)[of // 2] == pytest.approx(propellant_kg, abs=0.01)
