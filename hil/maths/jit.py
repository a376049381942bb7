"""The one way a kernel is compiled, and where the compiled code is kept.

numba's own cache looks only at the file of the function that is called; a change in a kernel that
it calls from another file goes unseen. A bench must never run yesterday's formula, so the cache
folder carries a digest of every kernel source: a change anywhere compiles everything anew.
"""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
from numba import njit

_PACKAGE = Path(__file__).resolve().parent.parent
_KERNEL_FOLDERS = ("maths", "dynamics", "gnc", "bench", "vmu/kernels", "monitor")
_KERNEL_FILES = (
    "gnc_interface.py",
    "messages.py",
    "campaign/fusion_kernel.py",
    "campaign/library_kernel.py",
    "campaign/loop_kernel.py",
    "campaign/tally_kernel.py",
    "console/columns.py",
)
_INLINED = ("hil.maths", "hil.dynamics", "hil.gnc", "hil.bench", "hil.campaign")
_KEPT_CACHES = 6

_Function = TypeVar("_Function", bound=Callable[..., Any])


def _source_digest() -> str:
    digest = hashlib.sha256(f"numba {numba.__version__}".encode())
    files = [path for folder in _KERNEL_FOLDERS for path in sorted((_PACKAGE / folder).rglob("*.py"))]
    for path in [*files, *(_PACKAGE / name for name in _KERNEL_FILES)]:
        digest.update(path.name.encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_root() -> Path:
    given = os.environ.get("HIL_CACHE_DIR")
    if given:
        return Path(given)
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "hil"


def _prepare_cache() -> Path:
    root = _cache_root() / "kernels"
    folder = root / _source_digest()
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder)
    others = sorted((entry for entry in root.iterdir() if entry.is_dir()), key=lambda e: e.stat().st_mtime)
    for old in others[:-_KEPT_CACHES]:
        shutil.rmtree(old, ignore_errors=True)
    return folder


CACHE_FOLDER = _prepare_cache()
numba.config.CACHE_DIR = str(CACHE_FOLDER)  # type: ignore[attr-defined]


def kernels_are_cached() -> bool:
    """Return whether an earlier start left compiled kernels for these very sources."""
    return (CACHE_FOLDER / "complete").exists()


def mark_kernels_cached() -> None:
    """Say that every kernel has been compiled once for these sources."""
    (CACHE_FOLDER / "complete").touch()


def kernel(function: _Function) -> _Function:
    """Compile ``function`` for the loop: no Python inside, no fast-math, cached on disk.

    Those of the loop are inlined where they are called, which makes it a third faster; those of the pictures are
    large, called once a picture, and would compile for minutes.

    Division by zero gives inf or nan as in numpy, so that a bad number is caught by the
    supervisor's check for finite values and not by an exception in mid-cycle.
    """
    inlined = function.__module__.startswith(_INLINED)
    return cast(_Function, njit(cache=True, error_model="numpy", nogil=True, forceinline=inlined)(function))
