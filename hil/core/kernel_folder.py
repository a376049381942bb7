"""Folder of the compiled kernels: in an installed package, of the user, or none, and kernels stay in memory.

The files are pickles, code that this process runs: a folder or a file that another user owns or may write is refused.
"""

from __future__ import annotations

import os
import shutil
import time
import uuid
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Final

from hil.core.surroundings import lock, user_folders, users_own_folder, why_unsafe
from hil.errors import BadInput

_SHIPPED: Final = Path(__file__).parent.parent / "kernels"
_UNUSED_MAX_S: Final = 60 * 86_400.0
_FREE_BYTES: Final = 32 << 20  # free space for all kernels, with a margin
_REMEDY: Final = "set HIL_CACHE_DIR to a folder of your own"
_ENVIRONMENT: Final = ("HIL_CACHE_DIR", "XDG_CACHE_HOME", "HOME", "TMPDIR")


def kernel_folder() -> Path | None:
    """Return the folder for kernels that are compiled now; None if none can be written.

    Raises BadInput if that of HIL_CACHE_DIR cannot.
    """
    return _choice(*map(os.environ.get, _ENVIRONMENT))[0]


def kernel_folder_notice() -> str:
    """Return one line on kernels that are elsewhere than usual, and why; "" if they are not."""
    folder, reason = _choice(*map(os.environ.get, _ENVIRONMENT))
    kept = f"kept in {folder}" if folder is not None else "kept in memory, and compiled again at each start"
    return f"kernel cache: {reason}: kernels are {kept}; {_REMEDY}" if reason else ""


def read_kernel_file(name: str) -> bytes | None:
    """Return the content of the file ``name`` of a folder of kernels, None if there is none.

    Raises BadInput if another user could have written it.
    """
    for folder in _folders():
        try:
            with (folder / name).open("rb") as file:
                if reason := _why_unsafe(folder / name, os.fstat(file.fileno())):
                    raise _refusal(reason)
                with suppress(OSError):  # a file of root
                    os.utime(file.fileno())
                return file.read()
        except (FileNotFoundError, NotADirectoryError, PermissionError):
            continue
    return None


def lock_kernel_file(name: str) -> IO[bytes] | None:
    """Wait for a process that writes the file ``name``; return the lock of this one, None if there are no locks."""
    if (folder := kernel_folder()) is None:
        return None
    path = folder / f"{name}.lock"
    try:
        path.parent.mkdir(exist_ok=True, mode=0o755)
        file = path.open("wb")
    except OSError as error:
        raise _refusal(f"cannot be written ({error.strerror})") from error
    lock(file.fileno(), wait=True)
    return file


def write_kernel_file(name: str, content: bytes) -> None:
    """Write the file ``name``, completely or not at all, if a folder can be written. Raises BadInput."""
    folder = kernel_folder()
    if folder is None:
        return
    path = folder / name
    written = path.with_suffix(f".{uuid.uuid4().hex}")
    try:
        path.parent.mkdir(exist_ok=True, mode=0o755)
        written.write_bytes(content)
        written.chmod(0o644)
        written.replace(path)
        (folder / f"{name}.lock").unlink(missing_ok=True)
    except OSError as error:
        with suppress(OSError):
            written.unlink(missing_ok=True)
        raise _refusal(f"cannot be written ({error.strerror})") from error


def remove_unused_kernels() -> None:
    """Remove the kernels that no process has loaded for months."""
    oldest_s = time.time() - _UNUSED_MAX_S
    folder = kernel_folder()
    for path in folder.rglob("*-*.*") if folder is not None else ():
        with suppress(FileNotFoundError):
            if path.stat().st_mtime < oldest_s:
                path.unlink()


def _folders(create: bool = False) -> Iterator[Path]:
    """Yield the folders of kernels, best first: the package's, if it has one and no other is asked for."""
    if given := os.environ.get("HIL_CACHE_DIR"):
        yield Path(given) / "kernels"
        return
    if _SHIPPED.is_dir():
        yield _SHIPPED
    for folder in user_folders("cache", create):
        yield folder / "kernels"


@cache
def _choice(*_environment: str | None) -> tuple[Path | None, str]:
    """Return the folder to write to, and why it is another one than the user's own."""
    own = os.environ.get("HIL_CACHE_DIR") or users_own_folder("cache")
    reasons = [] if own is not None else ["this user has no home"]
    for folder in _folders(create=True):
        if not (reason := _why_not(folder)):
            return folder, "" if folder == _SHIPPED else "".join(reasons[:1])
        if os.environ.get("HIL_CACHE_DIR"):
            raise _refusal(reason)
        if folder != _SHIPPED:
            reasons.append(f"{folder.parent}: {reason}")
    return None, reasons[0]


def _why_not(folder: Path) -> str:
    """Return why kernels cannot be written to ``folder``, which is created; "" if they can."""
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o755)
        if reason := _why_unsafe(folder, os.stat(folder)):
            return reason
        TemporaryFile(dir=folder).close()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        return f"cannot be written ({error.strerror})"
    return "" if free >= _FREE_BYTES else f"has {free >> 20} MiB of free space, {_FREE_BYTES >> 20} are needed"


def _why_unsafe(path: Path, status: os.stat_result) -> str:
    reason = why_unsafe(status)
    return f"{path.name} {reason}, whose code it would run" if reason else ""


def _refusal(reason: str) -> BadInput:
    folder = os.environ.get("HIL_CACHE_DIR") or users_own_folder("cache")
    return BadInput.single("kernel cache", str(folder), f"{reason}; {_REMEDY}")
