"""``hil benchmark``: rows, numbers, page, and two GNCs case by case."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from hil.api.jobs import job_of
from hil.cli.main import execute
from hil.config.load import load_scenario
from hil.errors import BadInput
from hil.parts.campaigns.api import benchmark

pytestmark = pytest.mark.xdist_group("campaign")
LQR = Path(__file__).parents[2] / "examples/backends/lqr.py"


def test_every_row_names_a_shipped_scenario_and_its_own_folder() -> None:
    rows = benchmark.rows_of("*")
    assert len({row.name for row in rows}) == len(rows)
    assert {row.scenario for row in rows} == set(benchmark.SCENARIOS)
    for name in benchmark.SCENARIOS:
        assert load_scenario(name).value.name == name


@pytest.mark.parametrize("row", [row for row in benchmark.ROWS if row.faults], ids=lambda row: row.name)
def test_single_fault_can_be_injected(row: benchmark.Row) -> None:
    (fault,) = job_of(row.scenario, "mock", {"faults": list(row.faults)}, 0, None).scenario.value.faults
    assert (fault.device, fault.kind) == (row.faults[0]["device"], row.faults[0]["kind"])


def test_pattern_without_a_row_is_refused() -> None:
    with pytest.raises(BadInput, match="--only: 'scheme-9': matches no row, allowed: a pattern for scheme-1, "):
        benchmark.rows_of("scheme-9")


def test_two_laws_are_compared_case_by_case(tmp_path: Path) -> None:
    mine, other = tmp_path / "mine", tmp_path / "other"
    rows = ["--only", "scheme-1", "--runs", "2", "--workers", "1"]
    assert execute(["benchmark", "--out", str(other), *rows]) == 0
    assert execute(["benchmark", f"{LQR}:lqr", "--out", str(mine), *rows, "--against", str(other)]) == 0
    found = json.loads((mine / benchmark.RESULT).read_text())
    assert found["gnc"] == {"gnc.control.backend": f"{LQR}:lqr"}
    (row,), (pair,) = found["rows"], found["against"]["rows"]
    assert (row["accepted"]["runs"], pair["cases"]) == (2, 2)
    theirs = json.loads((other / benchmark.RESULT).read_text())["rows"][0]
    assert row["propellant_kg"]["median"] != theirs["propellant_kg"]["median"]
    assert pair["only_first"] - pair["only_second"] == row["accepted"]["passed"] - theirs["accepted"]["passed"]
    page = (mine / "benchmark.html").read_text()
    assert "Case by case against" in page
    assert f"{row['propellant_kg']['median']:.3f}" in page
    assert execute(["benchmark", "--out", str(tmp_path / "c"), "--seed", "1", *rows, "--against", str(other)]) == 2


def test_row_with_misses_is_flown_again_without_errors_of_sensors_and_actuators(tmp_path: Path) -> None:
    rows, asked = benchmark.rows_of("scheme-1"), {"requirements.propellant_factor": 0.5}  # less than the least
    (row,) = benchmark.fly(rows, 1, tmp_path, overrides=asked, workers=1, ideal=True)["rows"]
    assert list(row["ideal"]) == ["sensors", "actuators", "both"]
    dispersed = {"vmu.sigma_position_m", "chaser.mass_kg", "initial.position_m[0]"}
    folders = ("scheme-1", *(f"scheme-1-ideal-{name}" for name in row["ideal"]))
    found = [dispersed & set(pq.read_schema(tmp_path / folder / "cases.parquet").names) for folder in folders]
    start = {"initial.position_m[0]"}
    assert found == [dispersed, {"chaser.mass_kg"} | start, {"vmu.sigma_position_m"} | start, start]


def test_folder_of_another_kind_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="holds no row of this benchmark"):
        benchmark.compare(tmp_path, tmp_path, benchmark.rows_of("*"))
