"""Compilation of the kernels and their cache on disk.

numba's own cache checks only the file of the function that is called; a change in a kernel that it calls from
another file goes unnoticed. A bench must never run yesterday's formula, so the cache folder carries a digest of every
source that a kernel is compiled from: a change in any of them compiles everything again. The entries do not depend on
where the package is installed: two checkouts of the same sources share them.
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import njit
from numba.core.caching import CacheImpl, _CacheLocator

from hil.errors import BadInput

_PACKAGE = Path(__file__).parent.parent
_COMPILED = re.compile(rb"^@(kernel|intrinsic)\b", re.MULTILINE)
_IMPORT = re.compile(rb"^\s*from (hil[\w.]*) import (\([^)]*\)|[^\n]*)", re.MULTILINE)
_NOT_INLINED = ("hil.vmu.", "hil.monitor.", "hil.console.")
_KEPT_CACHES = 6

_Function = TypeVar("_Function", bound=Callable[..., Any])


def kernel_sources(package: Path = _PACKAGE) -> dict[str, bytes]:
    """Return the sources that kernels are compiled from, by their path inside ``package``.

    These are all files that define a kernel, wherever they are, and all modules of the package that those import:
    numba compiles the constants and record layouts of a module into the kernels that use them.
    """
    sources = {path.relative_to(package).as_posix(): path.read_bytes() for path in sorted(package.rglob("*.py"))}
    pending = [name for name, text in sources.items() if _COMPILED.search(text)]
    found: set[str] = set()
    while pending:
        name = pending.pop()
        if name not in found and name in sources:
            found.add(name)
            pending += _imports(sources[name])
    return {name: sources[name] for name in sorted(found)}


def _imports(text: bytes) -> list[str]:
    """Return the files that ``text`` may import: of ``from hil.a import b`` a.py, a/__init__.py and a/b.py."""
    files = []
    for module, names in _IMPORT.findall(text):
        place = "".join(f"{part}/" for part in module.decode().split(".")[1:])
        files += [f"{place[:-1]}.py", f"{place}__init__.py"] if place else []
        files += [f"{place}{name}.py" for name in re.findall(r"\w+", names.decode())]
    return files


def source_digest(package: Path = _PACKAGE) -> str:
    """Return a digest of ``kernel_sources`` and of the compiler; the same in every process."""
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    for name, text in kernel_sources(package).items():
        digest.update(f"{name} {len(text)} ".encode())
        digest.update(text)
    return digest.hexdigest()[:16]


@cache
def kernels_digest() -> str:
    """Return the digest of the kernels that this process runs."""
    return source_digest()


def _cache_root() -> Path:
    given = os.environ.get("HIL_CACHE_DIR")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "hil"


def _cache_folder() -> Path:
    return _cache_root() / "kernels" / kernels_digest()


def prepare_kernel_cache() -> None:
    """Create the folder of the compiled kernels and remove the oldest ones. Raises BadInput if it is not writable."""
    folder = _cache_folder()
    if folder.exists() and os.access(folder, os.W_OK):
        return
    _make_writable(folder)
    others = sorted((entry for entry in folder.parent.iterdir() if entry.is_dir()), key=lambda e: e.stat().st_mtime)
    for old in others[:-_KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)


def _make_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise BadInput.single(
            "kernel cache",
            str(_cache_root()),
            f"cannot be written ({error.strerror}); set HIL_CACHE_DIR to a folder that can",
        ) from error


def kernels_are_cached() -> bool:
    """Return whether an earlier start left compiled kernels for these very sources."""
    return (_cache_folder() / "complete").exists()


def mark_kernels_cached() -> None:
    """Record that every kernel has been compiled once for these sources."""
    prepare_kernel_cache()
    (_cache_folder() / "complete").touch()


class _KernelCacheLocator(_CacheLocator):
    """Place of a kernel in the cache: by its path inside the package, created when the first one is written."""

    def __init__(self, py_func: Callable[..., Any], py_file: str) -> None:
        self._py_file = py_file  # named in numba's warning about a function that cannot be cached
        self._line = py_func.__code__.co_firstlineno
        self._place = Path(py_file).relative_to(_PACKAGE).parent

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> _KernelCacheLocator | None:
        return cls(py_func, py_file) if py_file.startswith(f"{_PACKAGE}{os.sep}") else None

    def get_cache_path(self) -> str:
        return str(_cache_folder() / self._place)

    def ensure_cache_path(self) -> None:
        _make_writable(_cache_folder() / self._place)

    def get_source_stamp(self) -> str:
        return kernels_digest()

    def get_disambiguator(self) -> str:
        return str(self._line)


CacheImpl._locator_classes.insert(0, _KernelCacheLocator)


def kernel(function: _Function) -> _Function:
    """Compile ``function`` for the loop: no Python inside, no fast-math, cached on disk.

    Those of the loop are inlined where they are called, which makes it a third faster; those of the images are
    large, called once per image, and would compile for minutes.

    Division by zero gives inf or nan as in numpy, so that a bad number is caught by the
    safety monitor's check for finite values and not by an exception in mid-cycle.
    """
    inlined = not function.__module__.startswith(_NOT_INLINED)
    return cast(_Function, njit(cache=True, error_model="numpy", nogil=True, forceinline=inlined)(function))
