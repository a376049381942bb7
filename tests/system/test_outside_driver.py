"""A driver in a package of its own, as ``hil init --driver`` writes it: its tests pass unchanged."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from hil.cli.main import execute
from tests.support import example_driver


def test_tests_of_the_written_package_pass_unchanged(tmp_path: Path) -> None:
    package = tmp_path / "tug"
    assert execute(["init", "--driver", "tug_axis", str(package)]) == 0
    assert not [path for path in package.rglob("*") if "acme" in path.name.lower()]
    assert not [path for path in package.rglob("*.*") if path.is_file() and "acme" in path.read_text().lower()]
    path = os.pathsep.join((str(example_driver.install(tmp_path / "site", package)), *sys.path))
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", str(package)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=250, check=False, env={**os.environ, "PYTHONPATH": path},
        cwd=package,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("--driver", "Bad Name"), "--driver: 'Bad Name': allowed are lower-case letters, digits and _, at most 30, "),
        (("--driver", "modbus"), "--driver: modbus: is the name of a driver of rails, give another"),
        (("--driver", "tug", "--part", "tug"), "--driver: does not go with --part, give one of them"),
    ],
)
def test_wrong_name_is_refused(
    arguments: tuple[str, ...], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["init", *arguments, str(tmp_path / "made")]) == 2
    assert capsys.readouterr().err.startswith(line)
    assert not (tmp_path / "made").exists()
