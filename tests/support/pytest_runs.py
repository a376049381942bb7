"""pytest in a process of its own, with the plugin of test campaigns."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.support.forks import ROOT, forked

PLUGIN = "hil.parts.campaigns.pytest_plugin.plugin"
_ENVIRONMENT = {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "200"}


def pytest_command(*options: str) -> list[str]:
    """Return the command of a pytest run that loads no other plugin."""
    return [sys.executable, "-m", "pytest", *_with_plugin(options)]


def _with_plugin(options: tuple[str, ...]) -> list[str]:
    return ["-p", PLUGIN, "-p", "no:cacheprovider", *options]


def environment() -> dict[str, str]:
    """Return the environment of such a run."""
    return os.environ | _ENVIRONMENT


def pytest_run(folder: Path, *options: str, fresh: bool = False) -> subprocess.CompletedProcess[str]:
    """Return the result of pytest in ``folder``. fresh: in a process that has imported nothing before."""
    if fresh:
        command = pytest_command(*options)
        return subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
    arguments = _with_plugin(options)
    code = f"import sys, pytest\nsys.argv = ['pytest', *{arguments}]\nsys.exit(int(pytest.main({arguments})))"
    return forked(code, folder, **_ENVIRONMENT)
