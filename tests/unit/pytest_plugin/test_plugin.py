"""The pytest plugin: fixtures, evidence, results of the day, its resumption, and other projects' runs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from tests.support.pytest_runs import pytest_run

SCENARIO = """
import hil
import pytest

pytestmark = pytest.mark.scenario("scheme-1", overrides={"duration_s": 3.0})
BESIDE = hil.RunRequirement("RVD-021", "beside the axis", "|truth.r_CT_H[1]|", at_most=LIMIT)
"""
TESTS = """
@pytest.mark.requirement("RVD-001")
def test_whole_run(run):
    "The run is complete."
    assert run.stop == "completed"

@pytest.mark.requirement(BESIDE)
def test_stays_beside(run):
    assert run.t_s[-1] == 3.0

def test_hold(bench):
    bench.home()
    bench.arm()
    assert bench.start(until=1.0).stop == "on hold"

def test_rig(rig):
    assert rig.kind == "mock"
"""
FAULT = """
lost = pytest.mark.scenario("scheme-1", overrides={"duration_s": 8.0}, faults=[
    {"device": "rails.y", "kind": "offset", "at_s": 1.0, "value": 0.02}])

@lost
@pytest.mark.requirement("RVD-040")
def test_trip(bench):
    bench.arm()
    bench.start()

@lost
def test_trip_that_is_expected(bench):
    bench.arm()
    with pytest.raises(hil.errors.BenchError, match="rails.y"):
        bench.start()

@lost
def test_trip_of_a_run(run):
    raise AssertionError("not reached")
"""
ALARM = "rails.y: distance from the demand"


def write(folder: Path, text: str, limit: float = 0.5) -> None:
    (folder / "test_bench.py").write_text(SCENARIO.replace("LIMIT", str(limit)) + text)


def day_of(folder: Path) -> dict[str, dict[str, object]]:
    """Return the results of the day in ``folder``, by the names of the tests."""
    return {each["test"].split("::")[1]: each for each in json.loads((folder / "day.json").read_text())["tests"]}


def test_campaign_leaves_results_evidence_and_a_page(tmp_path: Path) -> None:
    write(tmp_path, TESTS)
    done = pytest_run(tmp_path, "--rig", "mock", "--results", "day")
    assert done.returncode == 0, done.stdout
    assert "mock: 4 passed" in done.stdout
    assert "OPEN requirements: mock: 2 verified; emulated: 2 open; hardware: 2 open" in done.stdout
    tests = day_of(tmp_path / "day")
    assert [each["outcome"] for each in tests.values()] == ["passed"] * 4
    shared = {tests[name]["runs"][0]["recording"] for name in ("test_whole_run", "test_stays_beside")}  # type: ignore[index]
    assert len(shared) == 1  # one run for both
    assert (tmp_path / "day" / shared.pop()).is_file()
    (suite,) = ElementTree.parse(tmp_path / "day" / "junit.xml").getroot()
    assert (suite.get("name"), suite.get("tests"), suite.get("failures")) == ("mock", "4", "0")
    rows = json.loads((tmp_path / "day" / "requirements.json").read_text())["evidence"]
    assert [(row["id"], row["status"]) for row in rows if row["step"] == "mock"] == [
        ("RVD-001", "verified"),
        ("RVD-021", "verified"),
    ]
    page = (tmp_path / "day" / "day.html").read_text()
    for words in ("4 of 4 tests passed", "The run is complete.", "No alarm.", "motion digest", "beside the axis"):
        assert words in page


def test_trip_ends_a_test_with_the_alarm_and_the_next_test_runs(tmp_path: Path) -> None:
    write(tmp_path, FAULT)
    done = pytest_run(tmp_path, "--rig", "mock", "--results", "day")
    assert done.returncode == 1
    assert "Traceback" not in done.stdout
    tests = day_of(tmp_path / "day")
    assert {name: each["outcome"] for name, each in tests.items()} == {
        "test_trip": "failed",
        "test_trip_that_is_expected": "passed",
        "test_trip_of_a_run": "failed",
    }
    for name in ("test_trip", "test_trip_of_a_run"):
        assert str(tests[name]["message"]).startswith(ALARM)
    (row,) = tests["test_trip"]["evidence"]  # type: ignore[misc]
    assert (row["id"], row["status"]) == ("RVD-040", "not verified")  # type: ignore[index]


def test_requirement_that_a_run_violates_fails_its_test(tmp_path: Path) -> None:
    write(tmp_path, TESTS, limit=1e-6)
    done = pytest_run(tmp_path, "--rig", "mock", "--results", "day")
    assert done.returncode == 1
    assert "RVD-021: beside the axis" in done.stdout
    assert [n for n, each in day_of(tmp_path / "day").items() if each["outcome"] == "failed"] == ["test_stays_beside"]


def test_resumed_day_omits_what_has_passed_and_is_unchanged(tmp_path: Path) -> None:
    write(tmp_path, TESTS, limit=1e-6)
    pytest_run(tmp_path, "--rig", "mock")
    done = pytest_run(tmp_path, "--rig", "mock", "--resume")
    assert "1 failed, 3 deselected" in done.stdout
    assert "mock: 3 passed, 1 failed" in done.stdout  # those of the earlier run are in the day
    write(tmp_path, TESTS)
    done = pytest_run(tmp_path, "--rig", "mock", "--resume")
    assert "4 passed" in done.stdout.splitlines()[-1]


def test_invalid_input_is_one_line(tmp_path: Path) -> None:
    write(tmp_path, TESTS)
    (tmp_path / "test_marker.py").write_text("import pytest\n\n@pytest.mark.requirement(7)\ndef test_a():\n    pass\n")
    (tmp_path / "lab.toml").write_text('extends = "emulated"\nname = "lab"\nkind = "hardware"\n')
    (tmp_path / "day.json").write_text("{}")
    for options, words in (
        (("--rig", "nowhere.toml"), "nowhere.toml"),
        (("--rig", "mock", "--resume"), "--resume: .*holds no day"),
        (("--resume",), "--resume: needs --rig"),
        (("--rig", "mock", "--results", "."), "day.json: is no day of a campaign"),
        (("--rig", "mock", "--results", "new"), "test_marker.py::test_a: requirement: 7: must be an identifier"),
    ):
        done = pytest_run(tmp_path, *options)
        errors = [line for line in done.stderr.splitlines() if line]
        assert done.returncode == pytest.ExitCode.USAGE_ERROR, (options, done.stdout)
        assert len(errors) == 1, done.stderr
        assert re.search(words, errors[0]), errors


def test_other_projects_keep_their_options_fixtures_and_speed(tmp_path: Path) -> None:
    (tmp_path / "conftest.py").write_text(
        "import pytest\n\n"
        "def pytest_addoption(parser):\n    parser.addoption('--rig', default='crane')\n\n"
        "@pytest.fixture\ndef run():\n    return 42\n"
    )
    (tmp_path / "test_other.py").write_text(
        "import sys\n\n"
        "def test_own(pytestconfig, run):\n"
        "    assert (pytestconfig.getoption('--rig'), run) == ('ship', 42)\n"
        "    assert not {'numpy', 'numba', 'pydantic', 'hil.api', 'hil.core'} & set(sys.modules)\n"
    )
    done = pytest_run(tmp_path, "--rig", "ship", fresh=True)
    assert done.returncode == 0, done.stdout
    assert sorted(path.name for path in tmp_path.iterdir() if path.name != "__pycache__") == [
        "conftest.py",
        "test_other.py",
    ]
