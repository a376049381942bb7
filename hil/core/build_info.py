"""Build of the program: version, and commit of the sources."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

VERSION = "0.3.0"
COMMIT_FILE: Final = "commit.txt"
"""File next to this module in an installed package; the build of the wheel writes it."""
UNKNOWN: Final = "unknown"

_PACKAGE: Final = Path(__file__).parent.parent
_GIT_WALL_S: Final = 5.0


class BuildInfo(NamedTuple):
    """commit: output of ``git describe``, with ``-dirty`` if files had been changed; "unknown" without git."""

    version: str
    commit: str


def version_text() -> str:
    """Return version and commit: what ``hil --version`` prints."""
    return f"{VERSION} ({build_info().commit})"


@cache
def build_info() -> BuildInfo:
    """Return the build of this program: of the wheel, or of the checkout that the package is in."""
    installed = Path(__file__).with_name(COMMIT_FILE)
    commit = installed.read_text(encoding="utf-8").strip() if installed.is_file() else _described(_PACKAGE.parent)
    return BuildInfo(VERSION, commit or UNKNOWN)


def _described(folder: Path) -> str:
    """Return the commit of the checkout in ``folder``, "" if it is none: not that of a repository around it."""
    if not (folder / ".git").exists():
        return ""
    import subprocess  # slow import; not needed by an installed package

    command = ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_GIT_WALL_S, check=True)
    except (OSError, subprocess.SubprocessError):
        return ""
    return done.stdout.strip()
