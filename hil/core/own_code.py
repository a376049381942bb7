"""Code of a user's own: the module of a file, and why it cannot be imported or its kernels not compiled."""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from types import ModuleType

from hil.errors import BadInput, one_line


def module_of_file(path: str, refuse: Callable[[str], BadInput]) -> ModuleType:
    """Return the module of the file at ``path``. Raises BadInput, by ``refuse``, if it cannot be imported."""
    file = Path(path).absolute()
    if not file.is_file():
        raise refuse("no such file: give file.py:name")
    try:
        return _executed(file, hashlib.sha256(file.read_bytes()).hexdigest()[:16])
    except Exception as error:
        raise refuse(f"cannot be imported: {import_error(error)}") from error


@lru_cache(maxsize=32)
def _executed(file: Path, digest: str) -> ModuleType:
    """Return the module of ``file``, executed once for each of its contents."""
    found = importlib.util.spec_from_file_location(f"hil_own_{digest}", file)
    assert found is not None
    module = importlib.util.module_from_spec(found)
    sys.modules[module.__name__] = module
    sys.path.insert(0, str(file.parent))
    try:
        # without bytecode files, which hide an edit of the same size in the same second
        exec(compile(file.read_bytes(), str(file), "exec"), module.__dict__)
    finally:
        sys.path.remove(str(file.parent))
    return module


def import_error(error: Exception) -> str:
    """Return why an import failed, as one line."""
    line = f" (line {error.lineno})" if isinstance(error, SyntaxError) else ""
    return one_line(f"{type(error).__name__}: {error}", 200) + line


def compile_error(error: Exception) -> str:
    """Return the reason of a failed compilation as one line: numba's own has dozens."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    reasons = [
        line for line in lines if re.match(r"Unknown attribute|Invalid use|No implementation|Cannot|Use of", line)
    ]
    reason = re.sub(r"(of type )?Record\(.*", "of a record", (reasons or lines[-1:])[-1])
    places = re.findall(r'File "[^"]*", line (\d+)', str(error)) or re.findall(r"\((\d+)\)", str(error))
    return one_line(reason, 200) + (f" (line {places[-1]})" if places else "")
