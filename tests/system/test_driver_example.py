"""The driver of another package, examples/driver_python: a run in closed loop on its emulator."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support import example_driver
from tests.support.run_settings import NEAR, UNHURRIED, typed


def run(tmp_path: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run hil with the package of the example installed."""
    path = os.pathsep.join((str(example_driver.install(tmp_path / "site")), *sys.path))
    command = [sys.executable, "-m", "hil", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=200, check=False, env={**os.environ, "PYTHONPATH": path}
    )


def test_loop_is_closed_through_a_driver_that_an_entry_point_provides(tmp_path: Path) -> None:
    result_file = tmp_path / "run.json"
    options = ("--rig", example_driver.RIG, "--duration", "5", "--lock-step", "--json", str(result_file))
    done = run(tmp_path, "run", "scheme-1", *options, *typed(*NEAR, *UNHURRIED))
    assert done.returncode == 1, done.stdout + done.stderr  # too short for the ready phase
    result = json.loads(result_file.read_text())
    assert result["stop"] == "completed"
    assert result["vision"]["frames"] > 25
    assert max(result["bench"]["rail_error_max_m"]) < 0.005


@pytest.mark.parametrize(
    ("rig", "text"),
    [("none.toml", "none.toml: "), ("mock", "--driver-rig: mock: has no axes on wires"), ("lab", "lab: unknown rig")],
)
def test_contract_tests_refuse_a_rig_without_a_driver(rig: str, text: str) -> None:
    suite = Path(__file__).resolve().parents[1] / "contract" / "test_axis_group.py"
    options = ("-n", "0", "-p", "no:cacheprovider", "--collect-only", "--driver-rig", rig)
    command = [sys.executable, "-m", "pytest", str(suite), *options]
    done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False, cwd=suite.parents[2])
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert text in done.stderr
