"""pytest in a process of its own, with the plugin of test campaigns."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

PLUGIN = "hil.pytest_plugin.plugin"
ROOT = Path(__file__).resolve().parents[2]


def pytest_command(*options: str) -> list[str]:
    """Return the command of a pytest run that loads no other plugin."""
    return [sys.executable, "-m", "pytest", "-p", PLUGIN, "-p", "no:cacheprovider", *options]


def environment() -> dict[str, str]:
    """Return the environment of such a run."""
    return os.environ | {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTHONPATH": str(ROOT), "COLUMNS": "200"}


def pytest_run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    """Return the result of pytest in ``folder``."""
    command = pytest_command(*options)
    return subprocess.run(command, cwd=folder, env=environment(), capture_output=True, text=True, check=False)
