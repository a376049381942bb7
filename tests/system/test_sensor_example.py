"""The sensor of another package, examples/sensor_python, as a user installs it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import example_driver

LINES_MAX, FILES_MAX = 150, 4


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """Environment in which the package of the example is installed."""
    site = example_driver.install(tmp_path / "site", example_driver.SENSOR)
    return {**os.environ, "PYTHONPATH": os.pathsep.join((str(site), *sys.path))}


def hil(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "hil", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=200, check=False, env=environment)


def test_sensor_of_a_package_is_listed_checked_and_flown(tmp_path: Path, environment: dict[str, str]) -> None:
    assert "bearing_camera" in hil(environment, "sensors", "list").stdout
    assert hil(environment, "sensors", "check", "bearing_camera").returncode == 0
    result_file = tmp_path / "run.json"
    scenario = str(example_driver.SENSOR / "bearing.toml")
    done = hil(environment, "run", scenario, "--duration", "20", "--json", str(result_file))
    assert done.returncode == 1, done.stdout + done.stderr  # too short for the ready phase
    result = json.loads(result_file.read_text())
    assert result["sensors"]["beacon"]["accepted"] == 101
    assert result["sensors"]["beacon"]["suspected"] == 0


def test_example_is_as_short_as_the_how_to_promises() -> None:
    files = [path for path in example_driver.SENSOR.iterdir() if path.is_file()]
    assert len(files) <= FILES_MAX
    assert sum(len(path.read_text().splitlines()) for path in files) <= LINES_MAX
