"""Input files that were read in part: each is named by a warning, and the command ends with an exit code of its own."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Final

INCOMPLETE: Final = 5
"""Exit code of a command that was done with what could be read of a recording."""

log = logging.getLogger("hil")
_noted: list[Path] = []


def note_incomplete(path: Path, problem: str) -> None:
    """Warn that the file at ``path`` is read in part; problem: what of it is not read, and why."""
    log.warning("%s: %s", path, problem)
    _noted.append(path)


def take_incomplete() -> list[Path]:
    """Return the files noted since the last call."""
    noted = _noted.copy()
    _noted.clear()
    return noted
