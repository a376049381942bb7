"""Results of a run: read back from their JSON, also of earlier versions, and described key by key."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from docs import generate
from hil.report.results import Results, RunResults
from hil.report.summary import summarise
from hil.session import build
from tests.support.run_settings import make_job


@pytest.fixture(scope="module")
def summary() -> dict[str, Any]:
    """Return the JSON of a run that is aborted."""
    job = make_job(5.0, ("gnc.abort.at_s=3.0",), seed=2)
    with build.runner(job) as runner:
        made = summarise(runner.run(), job.scenario.value, job.rig.value, "mock", 2, 50.0)[0]
    content: dict[str, Any] = json.loads(json.dumps(made))
    return content


def unset(results: Results, at: str = "") -> Iterator[str]:
    """Yield each row that is None although its type does not allow it."""
    for each, inner in results.rows():
        value, where = getattr(results, each.name), f"{at}{each.name}"
        if value is None and "None" not in str(each.type):
            yield where
        if isinstance(value, Results) and inner is not None:
            yield from unset(value, f"{where}.")


def test_each_row_with_a_label_has_a_meaning_and_a_text() -> None:
    rows = [row for table in Results._tables.values() for row, inner in table.rows() if inner is None]
    assert [row.name for row in rows if row.metadata["label"] and not row.metadata["meaning"]] == []


def test_each_row_that_cannot_be_absent_is_set_in_a_run(summary: dict[str, Any]) -> None:
    assert list(unset(RunResults.of(summary))) == []
    assert next(unset(RunResults.of(summary | {"thrusters": {}}))).startswith("thrusters.")


def test_results_are_read_back_as_they_were_written(summary: dict[str, Any]) -> None:
    run = RunResults.of(summary)
    assert run.as_json() == summary
    assert run.verdict.security.abort is not None
    assert run.verdict.security.abort.cause == "ordered"
    assert run.timing.devices.rails.exchange_hz is None


def test_key_numbers_are_rows_with_a_label_and_what_was_not_reached_is_a_dash(summary: dict[str, Any]) -> None:
    found = dict(RunResults.of(summary).key_numbers())
    assert found["stop"] == "completed"
    assert found["propellant, kg"] == f"{summary['thrusters']['propellant_kg']:.4f}"
    assert found["firings"] == str(sum(summary["thrusters"]["thruster_firings"]))
    assert found["least margin to Table III"] == found["ready, s"] == "-"
    run = RunResults.of({})
    run.latency = RunResults.of({"latency": {"pose_to_command_ms": {"p50": 1.234, "p99": None}}}).latency
    assert dict(run.key_numbers())["pose to command p50 p99, ms"] == "1.23 -"
    assert list(dict(run.key_numbers())) == list(found)


def test_recordings_of_earlier_versions_lack_rows(summary: dict[str, Any]) -> None:
    earlier = {name: value for name, value in summary.items() if name not in ("decision", "alarms")}
    earlier["navigation"] = {"position_rmse_m": [1.0, 2.0, 3.0], "position_bound_m": [0.1, 0.1, 0.1]}
    run = RunResults.of(earlier | {"of_a_later_version": 1})
    assert "decision" not in run.parts()
    assert run.alarms is None
    assert run.navigation.position_rmse_m == [1.0, 2.0, 3.0]
    assert run.navigation.position_bound_m is None  # without the filters' sigmas it was another bound


def test_each_key_of_the_json_is_described(summary: dict[str, Any]) -> None:
    page = generate.PAGES["run-results"]()
    for name, content in summary.items():
        assert f"`{name}`" in page
        for inner in content if isinstance(content, dict) and name in ("verdict", "bench", "timing", "latency") else ():
            assert f"`{name}.{inner}`" in page
    assert "| **`thrusters.propellant_kg`** | propellant used |" in page
    assert "`timing.devices.rails.limit_ms`" in page
