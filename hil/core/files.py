"""Files that a user names: inputs are regular, of bounded size and depth, texts are written completely or not at all.

An input may be a device without end, a pipe without a writer, or of another kind than its name. Every reader takes its
bytes from here, so that each of them ends in one line, in bounded time and memory.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from hil.errors import BadInput

KIB: Final = 1 << 10
MIB: Final = 1 << 20
CONFIG_BYTES: Final = MIB
"""Size of a configuration file at most."""
_DIGESTED_BYTES: Final = 256 * MIB
_DEPTH_MAX: Final = 32
_INTEGER_MAX: Final = 1 << 63
_LONG_KEY: Final = re.compile(rf"""(?:\.[ \t]*(?:[\w-]+|"[^"\n]*"|'[^'\n]*')[ \t]*){{{_DEPTH_MAX}}}""")
_UNUSABLE: Final = re.compile("[\0\ud800-\udfff]")  # no path, terminal or encoding takes them


def check_regular(path: Path, at_most: int) -> None:
    """Raise BadInput unless ``path`` is a regular file, at most ``at_most`` bytes long."""
    os.close(_opened(path, at_most))


def read_bytes(path: Path, at_most: int) -> bytes:
    """Return the content of the regular file at ``path``; raise BadInput for anything else, and above ``at_most``."""
    with os.fdopen(_opened(path, at_most), "rb") as file:
        try:
            content = file.read(at_most + 1)
        except OSError as error:
            raise _unreadable(path, error.strerror or str(error)) from error
    if len(content) > at_most:
        raise _too_large(path, at_most)
    return content


def read_text(path: Path, at_most: int, encoding: str = "utf-8-sig") -> str:
    """Return the text of the regular file at ``path``, with ``\\n`` for each end of line; raise BadInput."""
    try:
        text = read_bytes(path, at_most).decode(encoding)
    except UnicodeDecodeError as error:
        name = encoding.removesuffix("-sig").upper()
        raise _unreadable(path, f"not a text file: byte {error.start} is not {name}") from error
    return text.replace("\r\n", "\n")


def read_private_text(path: Path, at_most: int) -> str:
    """Return the text of a file with a secret; raise BadInput, also for one that other users can read."""
    text = read_text(path, at_most)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & 0o077:
        raise BadInput.single(str(path), "", f"readable by other users, mode {mode:o}: chmod 600 {path}")
    return text


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of the regular file at ``path``, hexadecimal; raise BadInput."""
    return hashlib.sha256(read_bytes(path, _DIGESTED_BYTES)).hexdigest()


def parse_toml(text: str) -> dict[str, Any]:
    """Return the table in ``text``; raise ValueError, also for one that is nested too deeply."""
    if _LONG_KEY.search(text):
        raise _too_deep()
    try:
        table: dict[str, Any] = _bounded(tomllib.loads(text))
        return table
    except RecursionError as error:
        raise _too_deep() from error


def parse_json(text: str | bytes) -> Any:
    """Return the value in ``text``; raise ValueError, also for one that is nested too deeply."""
    try:
        return _bounded(json.loads(text))
    except RecursionError as error:
        raise _too_deep() from error


def _bounded(value: Any) -> Any:
    """Return ``value``; raise ValueError if its depth, an integer or a text exceeds what every user of it can take."""
    pending = [(value, 0)]
    while pending:
        node, depth = pending.pop()
        if depth > _DEPTH_MAX:
            raise _too_deep()
        if isinstance(node, dict):
            pending += [(inner, depth + 1) for pair in node.items() for inner in pair]
        elif isinstance(node, list):
            pending += [(inner, depth + 1) for inner in node]
        elif isinstance(node, str) and _UNUSABLE.search(node):
            raise ValueError("a text contains a zero or half a surrogate pair")
        elif isinstance(node, int) and abs(node) > _INTEGER_MAX:
            raise ValueError("an integer has more than 64 bits")
    return value


def _too_deep() -> ValueError:
    return ValueError(f"nested too deeply: allowed are {_DEPTH_MAX} levels")


def _opened(path: Path, at_most: int) -> int:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY)
    except (OSError, ValueError) as error:
        raise _unreadable(path, getattr(error, "strerror", None) or str(error)) from error
    status = os.fstat(descriptor)
    if not stat.S_ISREG(status.st_mode):
        os.close(descriptor)
        raise _unreadable(path, "is a folder" if stat.S_ISDIR(status.st_mode) else "is not a regular file")
    if status.st_size > at_most:
        os.close(descriptor)
        raise _too_large(path, at_most)
    return descriptor


def _unreadable(path: Path, why: str) -> BadInput:
    return BadInput.single(str(path), "", f"cannot be read: {why}")


def _too_large(path: Path, at_most: int) -> BadInput:
    limit = f"{at_most / MIB:g} MiB" if at_most >= MIB else f"{at_most / KIB:g} KiB"
    return _unreadable(path, f"is longer than {limit}")


def create(path: Path, mode: int = 0o666) -> None:
    """Create the empty file ``path``, in place of whatever has the name: a link is removed, never written through.

    mode: of the new file, less the process' mask. Raises OSError.
    """
    path.unlink(missing_ok=True)
    os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode))


@contextmanager
def replaced(path: str | Path, mode: int = 0o666) -> Iterator[Path]:
    """Yield the path of a new file in the folder of ``path`` that replaces it at the end, complete and on the disk.

    On an error it is removed and ``path`` stays as it was. A device or a pipe is written itself. mode: of the new
    file, less the process' mask. Raises OSError.
    """
    out = Path(path)
    if out.exists() and not out.is_file():
        yield out
        return
    partial = out.with_name(f"{out.name}.part")
    try:
        create(partial, mode)
        yield partial
        with partial.open("rb") as written:
            os.fsync(written.fileno())
        os.replace(partial, out)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def write_text(text: str, path: str | Path, mode: int = 0o666) -> None:
    """Write ``text`` to ``path``, completely or not at all; raise BadInput if it cannot be written.

    mode: of the new file, less the process' mask.
    """
    try:
        with replaced(path, mode) as partial:
            partial.write_text(text, encoding="utf-8")
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise BadInput.single(str(path), "", f"cannot be written: {why}") from error
