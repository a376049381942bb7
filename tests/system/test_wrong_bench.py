"""A bench that is built wrong, instead of wrong cameras: no go outside of the requirements. Runs with -m slow."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.cli.main import execute
from tests.support.machine import TWELVE

CASES = 600


def wrong_bench(path: Path) -> Path:
    """Write a dispersion set with twelve errors of the bench, 1 mm or 0.05 deg, 1 sigma, and the GNC's budget of it."""
    sigmas: dict[str, list[float]] = {}
    for name, _ in TWELVE:
        key, _, index = name.partition("[")
        numbers = sigmas.setdefault(key, [0.0] * {"straightness_m": 4, "rotation_deg": 9}.get(key[2:], 3))
        numbers[int(index.rstrip("]") or 0) if index else 0] = 0.05 if key.endswith("deg") else 1e-3
    sigmas |= {"middle_m": [1e-3], "middle_deg": [0.05, 0.0]}
    lines = ['extends = "shipped"', 'name = "wrong-bench"', "[bench.errors]"]
    for key, numbers in sigmas.items():
        value = numbers[0] if key == "middle_m" else numbers
        lines.append(f'{key} = {{ kind = "normal", sigma = {value} }}')
    lines += ["[gnc.navigation.budget]"]
    lines += [f'{key} = {{ kind = "normal", mean = {mean}, sigma = 0.0 }}' for key, mean in BUDGET.items()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


BUDGET = {"vision_bias_sigma_m": [0.001, 0.0015, 0.0015], "vision_misalignment_sigma_deg": 0.07}


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_no_decision_is_wrong_on_a_wrong_bench(tmp_path: Path) -> None:
    dispersions, out = wrong_bench(tmp_path / "wrong-bench.toml"), tmp_path / "results"
    words = ["--dispersions", str(dispersions), "--runs", str(CASES), "--seed", "61", "--out", str(out)]
    assert execute(["campaign", "scheme-1", *words]) == 0
    rates = json.loads((out / "summary.json").read_text(encoding="utf-8"))["pass_rate"]
    assert rates["decision_error"] == {**rates["decision_error"], "passed": 0, "runs": CASES}
    assert rates["accepted"]["passed"] > 0.5 * CASES
