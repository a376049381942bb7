"""``hil init`` and ``hil ci``: a repository that works, the verdict of a pipeline, and invalid input."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import chdir
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.api.runs import run
from hil.cli.main import execute
from hil.config.load import load_geometry, load_rig
from hil.parts.campaigns.cli import ci as command
from hil.vmu.geometry import nominal_geometry
from tests.support.pytest_runs import pytest_run
from tests.support.run_settings import without_figures

pytestmark = pytest.mark.xdist_group("test campaigns")

RUN = ("--runs", "50")  # enough for the requirements
SHORT = 'extends = "approach.toml"\nduration_s = 40.0\nrequirements.required_ready_s = 1.0\n'
PARKED_NEAR = {"rig.rails.x.park_m": 0.7}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the repository that ``hil init`` writes."""
    folder = tmp_path_factory.mktemp("labs") / "lab"
    assert execute(["init", str(folder)]) == 0
    return folder


@pytest.fixture
def in_lab(lab: Path) -> Iterator[Path]:
    """Return the repository, as working directory."""
    with chdir(lab):
        yield lab


def test_repository_has_its_files_and_its_mock_campaign_passes(lab: Path) -> None:
    names = {path.relative_to(lab).as_posix() for path in lab.rglob("*") if path.is_file()}
    assert {".github/workflows/bench.yml", ".gitlab-ci.yml", ".pre-commit-config.yaml", "Containerfile"} <= names
    assert {"gnc/law.py", "gnc/observer.c", "rigs/lab.toml", "scenarios/approach.toml"} <= names
    geometry = load_geometry(str(lab / "cameras" / "vmu.toml")).value
    nominal = nominal_geometry(load_rig("mock").value.vmu)
    assert geometry.print == "official"
    np.testing.assert_allclose(geometry.leds_m, nominal.leds_m, atol=1e-15)
    assert (geometry.left, geometry.right, geometry.baseline_m) == (nominal.left, nominal.right, nominal.baseline_m)
    assert "HIL_VERSION" not in (lab / "requirements.txt").read_text()
    done = pytest_run(lab, "--rig", "mock")
    assert done.returncode == 0, done.stdout
    assert "3 passed, 1 skipped" in done.stdout  # the library is not built


def test_pipelines_call_commands_that_exist_and_rig_needs_a_person_and_no_fork(lab: Path) -> None:
    github, gitlab = ((lab / name).read_text() for name in (".github/workflows/bench.yml", ".gitlab-ci.yml"))
    for text in (github, gitlab):
        assert "hil ci scenarios/approach.toml --out results/ci --tests tests" in text
        rig = text[re.search(r"^ *rig:$", text, re.MULTILINE).start() :]  # type: ignore[union-attr]
        assert "flock" in rig
        assert "--operator-terminal=" in rig
    assert "if: github.event_name == 'workflow_dispatch'" in github
    assert "when: manual" in gitlab
    assert all(re.search(r"@[0-9a-f]{40}( |$)", line) for line in github.splitlines() if "uses:" in line)


def test_folder_that_is_not_empty_is_refused_and_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "notes.txt").touch()
    for folder in (tmp_path, tmp_path / "notes.txt"):
        assert execute(["init", str(folder)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert re.search(r"hil init: .*(is not empty \(notes.txt\)|is a file), give a new or an empty folder", line)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_change_that_loses_cases_is_red_and_an_equal_one_green(
    in_lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def run_from_near(*arguments: Any, overrides: dict[str, Any], **more: Any) -> Any:
        return run(*arguments, duration_s=22.0, overrides=overrides | PARKED_NEAR, **more)  # ready after 17 s

    monkeypatch.setattr("hil.api.runs.run", run_from_near)
    (in_lab / "scenarios" / "short.toml").write_text(SHORT)
    arguments = ["ci", "scenarios/short.toml", *RUN]
    with without_figures():
        assert execute([*arguments, "--out", str(tmp_path / "base")]) == 0
    assert "## PASS approach" in (tmp_path / "base" / "summary.md").read_text()
    law = in_lab / "gnc" / "law.py"
    before = law.read_text()
    law.write_text(before.replace("to_rate = math.sqrt(2.0) * bandwidth", "to_rate = 0.1 * bandwidth"))
    compared = ("--out", str(tmp_path / "new"), "--base", str(tmp_path / "base"), "--json", "-")
    try:
        with without_figures():
            found = execute([*arguments, *compared])
    finally:
        law.write_text(before)
    assert found == 1
    out = capsys.readouterr().out
    content = json.loads(out[out.index("\n{") :])
    verdicts = {step["name"]: step["verdict"] for step in content["steps"]}
    assert verdicts["comparison with the base"] == "fail"
    assert content["accepted_rate"]["first_alone"] > 5
    assert (tmp_path / "new" / "requirements.html").is_file()


def test_base_without_numbers_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for options, words in (
        (("--base", str(tmp_path)), "--base: .*: has no numbers, the campaign of a hil ci on the base branch"),
        (("--tests", str(tmp_path / "none")), "--tests: .*: does not exist"),
        (("--runs", "0"), "--runs: 0: must be at least 1"),
    ):
        assert execute(["ci", "scheme-1", "--out", str(tmp_path / "out"), *options]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert re.search(words, line)
    assert not (tmp_path / "out").exists()


def test_losses_by_chance_are_no_failure() -> None:
    def step(lost: int, won: int) -> str:
        rates = {"first_alone": lost, "second_alone": won}
        return command._comparison_step({"accepted_rate": rates, "confidence": 0.95}).verdict

    assert [step(0, 0), step(4, 0), step(5, 0), step(6, 5), step(12, 2)] == ["pass", "pass", "fail", "pass", "fail"]


@pytest.mark.skipif(shutil.which("make") is None or shutil.which("cc") is None, reason="no compiler")
def test_library_is_built_by_its_makefile(lab: Path, tmp_path: Path) -> None:
    folder = tmp_path / "gnc"
    shutil.copytree(lab / "gnc", folder)
    subprocess.run(["make", "-s", "-C", str(folder)], check=True)
    assert (folder / "observer.so").is_file()
