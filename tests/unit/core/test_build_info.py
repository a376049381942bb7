"""The build of the program: the commit of its own checkout or of the wheel, never of a repository around it."""

from __future__ import annotations

import runpy
import shutil
import subprocess
from pathlib import Path

from hil.core import build_info


def build_of(package: Path) -> tuple[str, str]:
    """Return the build that a copy of the module in ``package``/hil/core reports."""
    place = package / "hil" / "core" / "build_info.py"
    place.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(build_info.__file__, place)
    return tuple(runpy.run_path(str(place))["build_info"]())


def commit(folder: Path) -> str:
    """Make ``folder`` a repository with one commit; return its name."""
    name = ("-c", "user.name=t", "-c", "user.email=t@t")
    for command in (("init", "-q"), ("add", "."), (*name, "commit", "-q", "--allow-empty", "-m", "Add all")):
        subprocess.run(["git", *command], cwd=folder, check=True)
    done = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=folder, capture_output=True, text=True)
    return done.stdout.strip()


def test_checkout_reports_its_commit_and_changes(tmp_path: Path) -> None:
    build_of(tmp_path)
    name = commit(tmp_path)
    assert build_of(tmp_path) == (build_info.VERSION, name)
    (tmp_path / "hil" / "core" / "build_info.py").write_text("", encoding="utf-8")
    assert build_info._described(tmp_path) == f"{name}-dirty"


def test_installed_package_reports_the_commit_of_its_wheel(tmp_path: Path) -> None:
    build_of(tmp_path)
    (tmp_path / "hil" / "core" / build_info.COMMIT_FILE).write_text("v1-3-gabc\n", encoding="utf-8")
    commit(tmp_path)
    assert build_of(tmp_path) == (build_info.VERSION, "v1-3-gabc")


def test_repository_around_an_installed_package_is_not_its_commit(tmp_path: Path) -> None:
    commit(tmp_path)
    assert build_of(tmp_path / "venv") == (build_info.VERSION, build_info.UNKNOWN)
