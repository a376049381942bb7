"""Acceptance of a run: what it requires, and how it is printed."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from hil.config.load import load_scenario, shipped
from hil.config.scenario import Scenario
from hil.config.tables.verdict import PART_COLUMNS, required_parts
from hil.errors import BadInput
from hil.parts.campaigns.outcome import FLAGS
from hil.report.results import RunResults
from hil.report.table import PART_TEXTS
from hil.report.verdict import acceptance, is_accepted

ROOT = Path(__file__).resolve().parents[3]
ALL = ", ".join(PART_COLUMNS)
ALL_PASSED = dict.fromkeys(PART_COLUMNS, True)
WITHOUT_ENERGY = ("control_precision", "security", "field_of_view", "integrity", "decision")


def with_parts(scheme_1: Scenario, *names: str) -> Any:
    """Return requirements of these parts, those of the scenario without any."""
    return scheme_1.requirements.model_copy(update={"required_parts": names or None})


def summary_of(failed: str = "", stop: str = "completed", abort: dict[str, Any] | None = None) -> RunResults:
    """Return the results of a run that the verdict needs."""
    parts: dict[str, dict[str, Any]] = {name: {"passed": name != failed} for name in PART_COLUMNS}
    parts["security"]["abort"] = abort
    return RunResults.of({"stop": stop, "integrity": parts.pop("integrity"), "verdict": parts} | parts)


@pytest.mark.parametrize("failed", PART_COLUMNS)
def test_each_part_is_required_unless_the_scenario_omits_it(failed: str, scheme_1: Scenario) -> None:
    parts = ALL_PASSED | {failed: False}
    others = [name for name in PART_COLUMNS if name != failed]
    assert is_accepted(True, False, ALL_PASSED, with_parts(scheme_1))
    assert not is_accepted(True, False, parts, with_parts(scheme_1))
    assert not is_accepted(True, False, parts, with_parts(scheme_1, failed))
    assert is_accepted(True, False, parts, with_parts(scheme_1, *others))


def test_run_that_was_stopped_or_aborted_is_not_accepted_whatever_is_required(scheme_1: Scenario) -> None:
    assert not is_accepted(False, False, ALL_PASSED, with_parts(scheme_1, "security"))
    assert not is_accepted(True, True, ALL_PASSED, with_parts(scheme_1, "security"))
    for summary in (summary_of(stop="vmu: silent"), summary_of(abort={"at_s": 5.0})):
        assert not acceptance(summary, with_parts(scheme_1, "security"))[0]


def test_required_part_that_was_not_judged_is_missed(scheme_1: Scenario) -> None:
    parts = {name: True for name in PART_COLUMNS if name != "integrity"}
    assert is_accepted(True, False, parts, with_parts(scheme_1))  # as in recordings of versions without the part
    assert not is_accepted(True, False, parts, with_parts(scheme_1, "integrity"))
    assert not is_accepted(True, False, {}, with_parts(scheme_1))


def test_omitted_parts_are_named_with_their_outcomes(scheme_1: Scenario) -> None:
    run = summary_of("energy")
    run.accepted, run.required_parts = acceptance(run, with_parts(scheme_1, *WITHOUT_ENERGY))
    assert (run.accepted, run.required_parts) == (True, list(WITHOUT_ENERGY))
    assert run.not_required_text() == "(not required: energy fail)"
    run.accepted, run.required_parts = acceptance(run, with_parts(scheme_1, "security", "control_precision"))
    assert run.required_parts == ["control_precision", "security"]  # in the order of the table
    assert run.not_required_text() == "(not required: energy fail, field of view ok, integrity ok, decision ok)"
    run.accepted, run.required_parts = acceptance(run, with_parts(scheme_1))
    assert (run.accepted, run.not_required_text(), run.missed_parts()) == (False, "", ["energy"])


def test_shipped_scenarios_require_all_parts() -> None:
    left_out = {
        name: set(PART_COLUMNS) - set(required_parts(chosen, PART_COLUMNS))
        for name in shipped("scenarios")
        if (chosen := load_scenario(name).value.requirements.required_parts) is not None
    }
    assert left_out == {}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ('["enrgy"]', f'required_parts: "enrgy": must be one of {ALL}'),
        ("[]", f"required_parts: []: must have at least one of {ALL}"),
        ('["energy", "security", "energy"]', 'required_parts: "energy": given more than once'),
        ('"energy"', 'required_parts: "energy": must be a valid array'),
    ],
)
def test_unknown_part_is_one_line_with_file_key_value_and_what_is_allowed(
    value: str, message: str, tmp_path: Path
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(f'extends = "scheme-1"\n[requirements]\nrequired_parts = {value}\n')
    with pytest.raises(BadInput) as raised:
        load_scenario(str(path))
    assert str(raised.value) == f"{path}: requirements.{message}"


def test_each_part_has_a_flag_and_is_described() -> None:
    """A part that is added to the table is judged, printed, a column of campaigns, and on the page of the verdict."""
    assert set(PART_COLUMNS.values()) < set(FLAGS)
    assert list(PART_TEXTS) == list(PART_COLUMNS)
    assert FLAGS[:3] == ("accepted", "passed", "passed_all_parts")
    page = (ROOT / "docs" / "explanation" / "approach.md").read_text(encoding="utf-8").split("## Verdict")[1]
    assert re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE) == list(PART_COLUMNS)
