"""Files that commands write: checked before the work begins, written whole or not at all."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from hil.errors import Problem


def check_json_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem where ``path`` lies in a folder that does not exist."""
    if path is None or path == "-" or Path(path).absolute().parent.is_dir():
        return []
    return [Problem(option, "", f"{path}: its folder does not exist")]


def write_json(content: dict[str, Any], path: str) -> None:
    """Write ``content`` to ``path``, "-" for standard output: the whole file or none of it."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    partial = Path(f"{path}.part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)
