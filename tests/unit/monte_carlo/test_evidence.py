"""Evidence for requirements: verdict, tolerance bound, page and JUnit XML."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from hil.cli.recordings import verify_recordings
from hil.config.load import load_rig, load_scenario
from hil.config.scenario import ProbabilisticRequirement
from hil.errors import BadInput
from hil.maths.order_statistics import cases_needed
from hil.parts.campaigns.campaign import CampaignJob, scenario_digest
from hil.parts.campaigns.placement import RecordedRun, evidence_of_runs
from hil.parts.campaigns.requirements_page import (
    campaign_rows,
    evidence_files,
    junit,
    requirements_page,
    run_row,
    with_open_steps,
)
from hil.parts.campaigns.statistics import judge_requirement, tolerance_bound
from hil.report import html

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs" / "how-to" / "run-a-campaign.md"
EXAMPLE = ROOT / "examples" / "requirements.toml"
REQUIREMENT = ProbabilisticRequirement(id="R-1", text="x is small", column="position_m_x", at_most=0.006)


def judged(values: list[float] | np.ndarray, **changes: Any) -> dict[str, Any]:
    return judge_requirement(REQUIREMENT.model_copy(update=changes), np.asarray(values, dtype=float))


def test_as_many_failures_as_allowed_are_verified_and_one_more_is_not() -> None:
    values = np.full(1970, 0.005)
    values[:2] = 0.007
    found = judged(values)
    assert (found["verdict"], found["failures"], found["allowed_failures"]) == ("verified", 2, 2)
    assert (found["bound"], found["margin"]) == (0.005, pytest.approx(0.001))
    assert found["risk"] <= 0.1
    values[2] = 0.007
    found = judged(values)
    assert (found["verdict"], found["bound"], found["cases_needed"]) == ("not verified", 0.007, 2473)


def test_case_without_the_outcome_is_a_failure() -> None:
    values = np.full(852, 0.005)
    assert judged(values)["verdict"] == "verified"
    values[5] = np.nan
    found = judged(values)
    assert (found["verdict"], found["failures"], found["bound"]) == ("not verified", 1, None)


def test_too_few_cases_name_the_number_that_is_needed() -> None:
    found = judged(np.full(851, 0.005))
    assert (found["verdict"], found["cases_needed"], found["bound"]) == ("too few cases", 852, None)


def test_lower_limit_is_judged_at_the_other_end() -> None:
    values = np.linspace(-1.0, 1.0, 1000)
    found = judged(values, at_most=None, at_least=-0.999)
    assert (found["side"], found["failures"], found["verdict"]) == ("at least", 1, "not verified")
    assert judged(values, at_most=None, at_least=-1.0)["margin"] == pytest.approx(0.0)


def test_tolerance_bound_is_exceeded_by_the_stated_fraction_in_nine_of_ten_campaigns() -> None:
    generator = np.random.default_rng(1)
    bounds = [tolerance_bound(generator.random(1500), 1.0, 0.99, 0.1) for _ in range(1000)]
    assert np.mean([bound is not None and bound >= 0.99 for bound in bounds]) == pytest.approx(0.925, abs=0.035)


SOURCES = {"seed": 3, "digest": "abc"}


def test_page_and_junit_have_each_requirement() -> None:
    found = [judged(np.full(852, 0.005)), judged(np.full(852, 0.007), id="R-2", text="<b>x</b>")]
    rows = campaign_rows(found, SOURCES)
    page = requirements_page("scheme-1", SOURCES, rows)
    assert "mock: 1 verified, 1 not verified; emulated: 2 open; hardware: 2 open" in page
    assert ">FAIL<" in page
    assert "852 cases, seed 3, digest abc" in page
    assert "<b>x</b>" not in page
    suite = ElementTree.fromstring(junit("scheme-1", rows))
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("2", "1", "0")
    assert [len(case) for case in suite] == [0, 1]


def test_recorded_run_is_evidence_of_its_step_with_its_margin() -> None:
    found = judged(np.full(852, 0.005))
    rows = campaign_rows([found], SOURCES)
    shown = with_open_steps([*rows, run_row(found, "emulated", "a.mcap", 0.004)])
    assert [(row.step, row.method, row.status) for row in shown] == [
        ("mock", "analysis", "verified"), ("emulated", "test", "verified"), ("hardware", "-", "open"),
    ]  # fmt: skip
    assert shown[1].margin == pytest.approx(0.002)
    for value in (0.0061, None):
        bad = run_row(found, "hardware", "b.mcap", value)
        assert bad.status == "not verified"
        page = requirements_page("scheme-1", {}, [*rows, bad])
        assert ">FAIL<" in page
        assert "hardware: 1 not verified" in page
    at_least = run_row(found | {"side": "at least"}, "mock", "c.mcap", 0.0061)
    assert (at_least.status, at_least.margin) == ("verified", pytest.approx(0.0001))


@pytest.mark.parametrize(
    ("values", "verdict"),
    [
        ({}, "open"),
        ({"emulated": 0.004}, "open"),
        ({"emulated": 0.004, "hardware": 0.005}, "pass"),
        ({"emulated": 0.0061}, "fail"),  # also with a step that is open
        ({"emulated": 0.004, "hardware": 0.0061}, "fail"),
    ],
)
def test_page_is_open_until_each_step_has_evidence(values: dict[str, float], verdict: str) -> None:
    found = judged(np.full(852, 0.005))
    rows = campaign_rows([found], SOURCES) + [run_row(found, step, "a.mcap", v) for step, v in values.items()]
    files = evidence_files("scheme-1", SOURCES, rows)
    assert f'<p class="verdict {verdict}">{verdict.upper()}</p>' in files["requirements.html"]
    assert json.loads(files["requirements.json"])["verdict"] == verdict


def test_each_verdict_of_the_page_has_a_colour_of_its_own() -> None:
    colours = [re.search(rf"\.{verdict} {{ color: (#\w+)", html.STYLE) for verdict in ("pass", "open", "fail")]
    assert len({colour[1] for colour in colours if colour}) == 3


def test_page_without_a_requirement_is_open() -> None:
    assert '<p class="verdict open">OPEN</p>' in requirements_page("scheme-1", SOURCES, [])


@pytest.mark.parametrize(("ready_m", "code", "word"), [(0.003, 0, "OPEN"), (0.0061, 1, "FAIL")])
def test_command_ends_with_the_verdict_of_the_page(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    ready_m: float,
    code: int,
    word: str,
) -> None:
    scenario = load_scenario("scheme-1").value
    identity = {"scenario": "scheme-1", "scenario_digest": scenario_digest(scenario), "seed": 3, "duration_s": 400.0}
    (tmp_path / "campaign.json").write_text(json.dumps(identity | {"digest": "abc"}))
    (tmp_path / "summary.json").write_text(json.dumps({"requirements": [judged(np.full(852, 0.005))]}))
    summary = {"scenario": "scheme-1", "rig": "emulated", "seed": 1, "ready_phase": {"position_m": [ready_m, 0, 0]}}
    run = SimpleNamespace(rig=SimpleNamespace(kind="emulated"), scenario=scenario, summary=summary)
    monkeypatch.setattr("hil.api.recordings.open_recording", lambda _: run)
    monkeypatch.setattr("hil.cli.recordings._audit", lambda path, _: {"recording": str(path), "problems": []})
    assert verify_recordings(["a.mcap"], campaign=str(tmp_path)) == code
    last = capsys.readouterr().out.splitlines()[-1]
    assert last.startswith(f"{word} requirements of scheme-1: mock: 1 verified; emulated: 1 ")
    assert f">{word}<" in (tmp_path / "requirements.html").read_text()


def test_evidence_of_runs_is_listed_with_the_campaign_s(tmp_path: Path) -> None:
    identity = {"scenario": "scheme-1", "digest": "abc", "scenario_digest": "def", "seed": 3, "duration_s": 400.0}
    (tmp_path / "campaign.json").write_text(json.dumps(identity))
    requirements = [judged(np.full(852, 0.005)), judged(np.full(852, 0.005), id="R-2", column="limited_cycles")]
    (tmp_path / "summary.json").write_text(json.dumps({"requirements": requirements}))
    run = {"scenario": "scheme-1", "rig": "emulated", "seed": 1, "stop": "completed"}
    run |= {"ready_phase": {"position_m": [0.003, 0.0, 0.0]}}
    scenario, sources, rows = evidence_of_runs({"a.mcap": RecordedRun("emulated", run, "def")}, tmp_path)
    assert scenario == "scheme-1"
    assert "emulated, seed 1, completed" in sources["a.mcap"]
    assert [(row.id, row.step, row.margin) for row in rows] == [
        ("R-1", "mock", pytest.approx(0.001)), ("R-2", "mock", pytest.approx(0.001)),
        ("R-1", "emulated", pytest.approx(0.003)),
    ]  # fmt: skip
    files = evidence_files(scenario, sources, rows)
    assert [each["step"] for each in json.loads(files["requirements.json"])["evidence"]].count("hardware") == 2
    with pytest.raises(BadInput, match=r"b\.mcap: scenario scheme-2, that of the campaign is scheme-1"):
        evidence_of_runs({"b.mcap": RecordedRun("mock", run | {"scenario": "scheme-2"}, "def")}, tmp_path)
    with pytest.raises(BadInput, match=r"c\.mcap: scenario digest 123, that of the campaign is def"):
        evidence_of_runs({"c.mcap": RecordedRun("mock", run, "123")}, tmp_path)
    (tmp_path / "summary.json").write_text("{}")
    with pytest.raises(BadInput, match="no requirements"):
        evidence_of_runs({}, tmp_path)


def test_requirements_are_read_as_a_list_that_extends_the_table(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    entry = '[[requirements]]\nid = "R"\ntext = "t"\ncolumn = "{}"\nat_least = 1\n'
    path.write_text('extends = "scheme-1"\n' + entry.format("passed"))
    scenario = load_scenario(str(path))
    assert [each.id for each in scenario.value.requirements.probabilistic] == ["R"]
    assert scenario.value.requirements.dwell_s == load_scenario("scheme-1").value.requirements.dwell_s
    path.write_text('extends = "scheme-1"\n' + entry.format("nearest"))
    with pytest.raises(BadInput) as raised:
        CampaignJob(load_scenario(str(path)), load_rig("mock"), 0)
    assert re.search(r"mine\.toml.*probabilistic.*nearest.*nearest_m", str(raised.value))
    for wrong in (entry.format("passed") * 2, entry.format("passed") + "at_most = 2\n"):
        path.write_text('extends = "scheme-1"\n' + wrong)
        with pytest.raises(BadInput):
            load_scenario(str(path))


def test_table_of_the_page_is_the_binomial_one() -> None:
    rows = re.findall(r"^\| (failures allowed|cases for ([\d.]+) %.*?) \| (.+) \|$", PAGE.read_text(), re.MULTILINE)
    failures, *others = [(row[1], [int(cell.replace(",", "")) for cell in row[2].split(" | ")]) for row in rows]
    assert len(others) == 2
    for percent, cases in others:
        assert cases == [cases_needed(k, float(percent) / 100.0, 0.1) for k in failures[1]]


def test_200_cases_are_enough_for_the_requirements_of_the_example() -> None:
    found = load_scenario(str(EXAMPLE)).value.requirements.probabilistic
    assert [each.id for each in found] == ["RVD-010", "RVD-020", "RVD-030", "RVD-040"]
    assert all(cases_needed(0, each.probability, each.consumer_risk) <= 200 for each in found)
