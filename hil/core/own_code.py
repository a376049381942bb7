"""Code of a user's own: the module of a file, and why it cannot be imported or its kernels not compiled.

What a recording or the folder of a campaign names is data, not code: it is loaded only if the user names it as well, or
trusts such names (``trusting``); a relative one never.
"""

from __future__ import annotations

import difflib
import hashlib
import importlib.util
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from hil.errors import BadInput, one_line

_of_data: dict[str, tuple[str, str]] = {}
"""Texts of what was read as data in this process, any of which may name code: path -> text, file that has it."""
_of_user: set[str] = set()
"""Those in files, settings and arguments of the user."""
_trusts: ContextVar[bool] = ContextVar("trusts", default=False)
_REASONS: Final = r"Unknown attribute|Invalid use|No implementation|Cannot|Use of"


def note_data(source: str, content: Any) -> None:
    """Note the names of code in ``content``, texts in lists and tables, which the file ``source`` has as data."""
    for name in _texts_of(content):
        _of_data.setdefault(_path_of(name), (name, source))


def note_users(content: Any) -> None:
    """Note the names of code in ``content``, texts in lists and tables, which the user gives."""
    _of_user.update(_texts_of(content))


@contextmanager
def trusting(trusts: bool) -> Iterator[None]:
    """Load, within ``with``, what data names, if ``trusts``."""
    token = _trusts.set(trusts)
    try:
        yield
    finally:
        _trusts.reset(token)


def require_trust(name: str, refuse: Callable[[str], Exception]) -> None:
    """Raise what ``refuse`` makes if only data names this code and the user does not trust it; print it if so.

    name: of a file, or a module and a member, ``package:name``.
    """
    path = _path_of(name)
    if path not in _of_data or path in map(_path_of, _of_user):
        return
    given, source = _of_data[path]
    if not Path(given).is_absolute():
        raise refuse(f"is code that {source} names, not by an absolute path: never loaded, name it yourself")
    digest = hashlib.sha256(Path(path).read_bytes()).hexdigest() if Path(path).is_file() else "none: no such file"
    if not _trusts.get():
        way = "if you trust it, --trust-code (Python: trust_code=True), or name it yourself"
        raise refuse(f"is code that {source} names (sha256 {digest[:16]}): not loaded; {way}")
    print(f"loads {name}, named by {source}, sha256 {digest}", file=sys.stderr)  # noqa: T201


def _path_of(name: str) -> str:
    """Return the path that ``name`` leads to, through links and however it is written; of a module one as unique."""
    return os.path.realpath(name) if "\0" not in name else name


def _texts_of(content: Any) -> Iterator[str]:
    """Yield each text in ``content``, and what it has before its last colon, the file of ``file.py:name``."""
    if isinstance(content, Mapping):
        content = content.values()
    elif isinstance(content, str):
        yield content
        if before := content.rpartition(":")[0]:
            yield before
        return
    elif not isinstance(content, list | tuple):
        return
    for each in content:
        yield from _texts_of(each)


def module_of_file(path: str, refuse: Callable[[str], BadInput]) -> ModuleType:
    """Return the module of the file at ``path``. Raises BadInput, by ``refuse``, if it cannot be imported."""
    require_trust(path, refuse)
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
    spec = importlib.util.spec_from_file_location(f"hil_own_{digest}", file)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
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


def compile_error(error: Exception, function: Callable[..., Any], *records: np.dtype) -> str:
    """Return the reason of a failed compilation of ``function`` as one line: numba's own has dozens.

    records: its arguments that are records, whose fields a wrong name is compared with.
    """
    if isinstance(error, KeyError):  # numba's for a field that a record does not have
        names = [name for record in records for name in record.names or ()]
        close = difflib.get_close_matches(str(error.args[0]), names, 1, 0.75)
        hint = f", did you mean {close[0]}?" if close else ""
        return f"a record has no field {error}{hint}{_line_with(function, f'.{error.args[0]}')}"
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    reasons = [k for k, line in enumerate(lines) if re.match(_REASONS, line)]
    reason = lines[reasons[-1]] if reasons else next((line for line in lines if not line.startswith("Failed")), "")
    if reasons and reason.endswith("signature:"):  # it follows
        reason = f"numba has no {lines[reasons[-1] + 1].removeprefix('>>> ')}"
    reason = re.sub(r"(of type )?Record\(.*", "of a record", reason)
    places = re.findall(r'File "[^"]*", line (\d+)', text) or re.findall(r"\((\d+)\)", text)
    return one_line(reason, 200) + (f" (line {places[0]})" if places else "")


def _line_with(function: Callable[..., Any], text: str) -> str:
    """Return the number of the first line of ``function`` with ``text`` as an addition to a message."""
    try:
        lines, first = inspect.getsourcelines(function)
    except (OSError, TypeError):
        return ""
    return next((f" (line {first + i})" for i, line in enumerate(lines) if text in line), "")
