"""One verdict of a run, wherever it is given: last line, exit code, JSON, report, catalogue, Python."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import hil
from hil.cli.main import execute
from hil.recording.read import load
from hil.report.comparison import key_numbers
from hil.report.page import report
from hil.report.results import RunResults
from hil.report.summary import summary_of
from tests.support.run_settings import without_figures

pytestmark = pytest.mark.xdist_group("campaign")

LEFT_OUT = "(not required: energy fail)"
PARTS = ["control_precision", "security", "field_of_view", "integrity", "decision"]
WITHOUT_ENERGY = ("--set", f"requirements.required_parts={json.dumps(PARTS)}")
STRICT = ("--set", "requirements.propellant_factor=1.0")  # no run passes energy


class RecordedCommand(NamedTuple):
    """A run of the command line, recorded."""

    code: int
    lines: list[str]
    summary: dict[str, Any]
    file: Path


@pytest.fixture(scope="module")
def recorded_command(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., RecordedCommand]:
    """Return a function that runs scheme 3, seed 1, once with the same options, and fails a limit of the propellant."""

    @cache
    def run(*more: str) -> RecordedCommand:
        folder, printed = tmp_path_factory.mktemp("recorded"), io.StringIO()
        path = folder / "run.json"
        files = ["--record", str(folder), "--json", str(path)]
        with redirect_stdout(printed):
            code = execute(["run", "scheme-3", "--seed", "1", *files, *STRICT, *more])
        (file,) = folder.glob("*.mcap")
        return RecordedCommand(code, printed.getvalue().splitlines(), json.loads(path.read_text()), file)

    return run


@pytest.mark.parametrize(
    ("more", "accepted", "beside", "listed"),
    [(WITHOUT_ENERGY, True, LEFT_OUT, "pass"), ((), False, "(failed: energy)", "fail")],
    ids=["energy not required", "all parts required"],
)
def test_every_output_of_a_run_gives_the_same_verdict(
    recorded_command: Callable[..., RecordedCommand],
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    more: Sequence[str],
    accepted: bool,
    beside: str,
    listed: str,
) -> None:
    found = recorded_command(*more)
    word = "PASS" if accepted else "FAIL"
    assert found.code == (0 if accepted else 1)
    assert found.lines[-1] == f"{word} scheme-3 on mock, seed 1 {beside}"
    (energy,) = [line for line in found.lines if line.startswith("fail energy")]
    assert energy.endswith("; not required") is accepted
    verdict = {name: found.summary[name] for name in ("accepted", "passed", "passed_all_parts")}
    assert verdict == {"accepted": accepted, "passed": True, "passed_all_parts": False}

    assert execute(["recordings", "list", str(found.file.parent)]) == 0
    assert f" {listed} " in capsys.readouterr().out.splitlines()[-1]
    run = hil.open(found.file)
    assert (run.accepted, run.passed) == (accepted, True)
    assert f": {'accepted' if accepted else 'not accepted'}, " in repr(run)
    monkeypatch.setattr("hil.report.page.figures", lambda *_: ())
    page = report([load(found.file)])
    assert f'<p class="verdict {listed}">{word}{f" {LEFT_OUT}" if accepted else ""}</p>' in page
    assert dict(key_numbers(RunResults.of(run.summary)))["verdict"] == (f"pass {LEFT_OUT}" if accepted else "fail")


def test_recording_of_an_earlier_version_is_judged_by_the_requirements_of_its_scenario(
    recorded_command: Callable[..., RecordedCommand],
) -> None:
    recorded = load(recorded_command(*WITHOUT_ENERGY).file)
    assert recorded.summary is not None
    earlier = {k: v for k, v in recorded.summary.items() if k not in ("accepted", "required_parts")}
    assert summary_of(replace(recorded, summary=earlier))["accepted"]
    requirements = recorded.scenario.requirements.model_copy(update={"required_parts": None})
    scenario = recorded.scenario.model_copy(update={"requirements": requirements})
    assert not summary_of(replace(recorded, summary=earlier, scenario=scenario))["accepted"]


def test_run_that_misses_several_parts_names_them(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ["--set", "requirements.propellant_factor=0.1", "--set", "requirements.radial_distance_m=0.0001"]
    assert execute(["run", "scheme-1", "--duration", "30", *settings]) == 1
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == "FAIL scheme-1 on mock, seed 0 (the ready phase was not reached; failed: energy)"


def test_campaign_counts_accepted_cases(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ("--runs", "4", "--workers", "1", "--out", str(tmp_path / "c"))
    with without_figures():
        assert execute(["campaign", "scheme-3", *options, *STRICT, *WITHOUT_ENERGY]) == 0
    out = capsys.readouterr().out
    summary = json.loads((tmp_path / "c" / "summary.json").read_text())
    rates = summary["pass_rate"]
    assert next(iter(rates)) == "accepted"
    assert rates["accepted"] == rates["passed"] != rates["passed_all_parts"]  # each case fails energy
    assert rates["accepted"]["low"] < rates["accepted"]["rate"] <= rates["accepted"]["high"]
    assert summary["required_parts"] == PARTS
    (line,) = [line for line in out.splitlines() if line.startswith("accepted ")]
    assert line.endswith("Wilson 95%; not required: energy")
    campaign = hil.campaign(
        "scheme-3",
        runs=4,
        out=tmp_path / "c",
        workers=1,
        overrides={"requirements.propellant_factor": 1.0, "requirements.required_parts": PARTS},
    )
    assert campaign.accepted_rate == rates["accepted"]
    assert campaign.column("accepted").sum() == rates["accepted"]["passed"]
    every = ["--out", str(tmp_path / "all"), *STRICT]
    assert execute(["campaign", "scheme-3", "--runs", "4", "--workers", "1", *every]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("accepted ")]
    assert line.split()[1:4] == ["0", "of", "4,"]
    assert "not required" not in line
