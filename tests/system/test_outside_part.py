"""A part in a package of its own, as ``hil init --part`` writes it: with it, and then without it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

import hil
from hil.cli.main import execute
from hil.config.load import load_rig
from hil.config.motion_digest import motion_digest
from tests.support import commands, example_driver
from tests.support.commands import Done

WRONG = {
    "[ranging]\nrate_hz = 0.0\n": "ranging.rate_hz: 0.0: must be greater than 0",
    '[ranging]\nrate_hz = "5"\n': 'ranging.rate_hz: "5": must be a valid number',
    "[ranging]\nrate = 5.0\n": "ranging.rate: unknown key: the unit is part of the name, here it is rate_hz",
    "ranging = 5\n": "ranging: 5: must be an object",
}
"""Text of a scenario -> the line that refuses it, after the name of the file."""
TABLE = "[ranging]\nrate_hz = 5.0\n"
SHORT = ("--runs", "2", "--duration", "4", "--workers", "1")


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the package that ``hil init --part`` writes."""
    folder = tmp_path_factory.mktemp("packages") / "ranging"
    assert execute(["init", "--part", "ranging", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def site(package: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder in which the package is installed."""
    return example_driver.install(tmp_path_factory.mktemp("site"), package)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with scenarios, for what runs of the part leave."""
    made = tmp_path_factory.mktemp("runs")
    for number, text in enumerate([TABLE, *WRONG]):
        (made / f"own{number}.toml").write_text(f'extends = "scheme-1"\n{text}')
    return made


@pytest.fixture(scope="module")
def flown(site: Path, folder: Path) -> list[Done]:
    """Return the outcomes of a program with the part; its runs are in ``folder``."""
    own, out = folder / "own0.toml", folder / "run.json"
    return commands.run(
        site,
        [
            ("list", "parts", "--json", "-"),
            ("keys", "ranging", "--json", "-"),
            ("run", own, "--duration", "4", "--record", folder, "--json", out),
            ("campaign", own, *SHORT, "--out", folder / "campaign"),
            ("campaign", "scheme-1", *SHORT, "--out", folder / "plain"),
            *(("run", folder / f"own{number}.toml") for number in range(1, 1 + len(WRONG))),
        ],
    )


@pytest.fixture(scope="module")
def without(flown: Sequence[Done], folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Done]:
    """Return the outcomes of a program without the part, on what the runs with it left."""
    (recording,) = folder.glob("*.mcap")
    own = folder / "own0.toml"
    asked = {
        "run": ("run", own),
        "preflight": ("preflight", "--scenario", own),
        "new campaign": ("campaign", own, *SHORT, "--out", folder / "other"),
        "resumed campaign": ("campaign", own, *SHORT, "--out", folder / "campaign"),
        "replay": ("replay", recording),
        "report": ("report", recording, "--out", folder / "run.html"),
        "export": ("export", recording, "--format", "csv", "--out", folder / "run.csv"),
        "bag": ("export", recording, "--format", "ros2", "--out", folder / "run.bag"),
        "verify": ("recordings", "verify", recording),
        "report of the campaign": ("report", folder / "campaign", "--out", folder / "campaign.html"),
        "explain": ("explain", folder / "campaign"),
        "campaign without a table": ("campaign", "scheme-1", *SHORT, "--out", folder / "plain"),
    }
    return dict(zip(asked, commands.run(tmp_path_factory.mktemp("empty"), [*asked.values()]), strict=True))


def test_test_of_the_written_package_passes_unchanged(package: Path, site: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join((str(site), *sys.path, str(commands.ROOT)))}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment, cwd=package)
    assert done.returncode == 0, done.stdout
    assert "4 passed" in done.stdout


def test_part_is_listed_with_its_command_and_its_keys(flown: Sequence[Done]) -> None:
    parts = {each["name"]: each for each in json.loads(flown[0].out)["parts"]}
    assert parts["ranging"] == {
        "name": "ranging",
        "version": "0.1.0",
        "origin": "hil-ranging",
        "commands": ["ranging"],
        "tables": ["ranging"],
    }
    rate, longest, alarm = json.loads(flown[1].out)["keys"]
    assert (rate["key"], rate["unit"], rate["allowed"], rate["default"]) == (
        "ranging.rate_hz",
        "Hz",
        "above 0 to 1000",
        "`10.0`",
    )
    assert rate["meaning"] == "Samples per second, at most one per cycle."
    assert (longest["key"], alarm["key"]) == ("ranging.range_max_m", "ranging.alarm_below_m")


def test_run_has_section_numbers_and_rows(flown: Sequence[Done], folder: Path) -> None:
    assert flown[2].code == 1, flown[2].err  # too short for the ready phase
    assert "Ranging     samples  last, m" in flown[2].out
    assert json.loads((folder / "run.json").read_text())["ranging"]["samples"] == 21


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_wrong_table_is_one_line_with_file_key_value_and_what_is_allowed(
    number: int, flown: Sequence[Done], folder: Path
) -> None:
    done = flown[len(flown) - len(WRONG) + number]
    line = [*WRONG.values()][number]
    assert (done.code, done.err.strip()) == (2, f"{folder / f'own{number + 1}.toml'}: {line}")


@pytest.mark.parametrize("command", ["run", "preflight", "new campaign", "resumed campaign"])
def test_scenario_with_a_table_of_an_absent_part_is_not_run(
    command: str, without: dict[str, Done], folder: Path
) -> None:
    done = without[command]
    (line,) = done.err.splitlines()
    assert done.code == 2
    assert line.startswith(f"{folder / 'own0.toml'}: ranging: unknown key: ")
    assert "or the table of a part that is not installed, see hil list parts" in line


@pytest.mark.parametrize("command", ["replay", "report", "bag"])
def test_recording_of_an_absent_part_is_read_with_one_line(command: str, without: dict[str, Done]) -> None:
    done = without[command]
    (line,) = done.err.splitlines()
    assert done.code == 0
    assert line.endswith("part ranging of package hil-ranging 0.1.0 is not installed: its rows and tables are not read")


def test_rows_of_an_absent_part_are_exported_by_their_schema(without: dict[str, Done], folder: Path) -> None:
    assert (without["export"].code, without["export"].err) == (0, "")
    head, *rows = (folder / "run-ranging.csv").read_text().splitlines()
    assert (head, len(rows)) == ("t_s,range_m", 21)
    assert (without["verify"].code, without["verify"].err) == (0, "")


def test_campaign_with_a_table_of_an_absent_part_is_reported_and_explained(without: dict[str, Done]) -> None:
    assert (without["report of the campaign"].code, without["report of the campaign"].err) == (0, "")
    assert without["explain"].code in (0, 1)


def test_part_changes_neither_a_campaign_that_does_not_use_it_nor_the_digest_of_a_rig(
    flown: Sequence[Done], without: dict[str, Done], folder: Path
) -> None:
    resumed = without["campaign without a table"]
    assert (flown[4].code, resumed.code, resumed.err) == (0, 0, "")
    assert flown[4].out == resumed.out
    (recording,) = folder.glob("*.mcap")
    assert hil.open(recording).recorded.run["calibration_motion"] == motion_digest(load_rig("mock").value)


def test_recording_of_an_earlier_version_of_the_part_is_read(
    package: Path, flown: Sequence[Done], folder: Path, tmp_path: Path
) -> None:
    later = shutil.copytree(package, tmp_path / "later")
    session = later / "hil_ranging" / "session.py"
    added = 'Field("speed_mps", "f8", (), "m/s", "", "of the distance", math.nan),\n)\nSAMPLE = '
    session.write_text(session.read_text().replace(")\nSAMPLE = ", added, 1))
    site = example_driver.install(tmp_path / "site", later)
    (recording,) = folder.glob("*.mcap")
    (done,) = commands.run(site, [("ranging", recording)])
    assert done.code == 0, done.err
    assert len(done.out.splitlines()) == 21
