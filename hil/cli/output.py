"""Files that commands write: checked before the work begins, written whole or not at all."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

from hil.config.load import shipped
from hil.errors import Problem

PICTURES = (".png", ".pdf", ".svg")


def check_json_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem where no file can be written to ``path``, "-" for standard output."""
    if path is None or path == "-":
        return []
    if Path(path).is_dir():
        return [Problem(option, "", f"{path}: is a folder, give the name of a file")]
    if not Path(path).absolute().parent.is_dir():
        return [Problem(option, "", f"{path}: its folder does not exist")]
    return []


def check_picture_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem where no picture can be written to ``path``."""
    if path is not None and Path(path).suffix.lower() not in PICTURES:
        return [Problem(option, "", f"{path}: must end in {', '.join(PICTURES)}")]
    return check_json_path(option, path)


def write_json(content: dict[str, Any], path: str) -> None:
    """Write ``content`` to ``path``, "-" for standard output: the whole file or none of it."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    if path == "-":
        sys.stdout.write(text)
        return
    partial = Path(f"{path}.part")
    partial.write_text(text, encoding="utf-8")
    os.replace(partial, path)


def check_rig_path(option: str, path: str | None) -> list[Problem]:
    """Return a problem where no new rig file can be written to ``path``."""
    if path is not None and not path.endswith(".toml"):
        return [Problem(option, "", f"{path}: must end in .toml")]
    if path is not None and Path(path).exists():
        return [Problem(option, "", f"{path}: exists already, give a new name")]
    return check_json_path(option, path)


def base_of(rig_name: str, out_path: str) -> str:
    """Return what ``extends`` needs to find the rig from beside the file at ``out_path``."""
    if rig_name in shipped("rigs"):
        return rig_name
    return Path(os.path.relpath(Path(rig_name).resolve(), Path(out_path).resolve().parent)).as_posix()
