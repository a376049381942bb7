"""Archive of an FMU: read within bounds and unpacked into a folder, whatever the file contains."""

from __future__ import annotations

import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import Final

DESCRIPTION: Final = "modelDescription.xml"
_ENTRIES_MAX: Final = 20_000
_UNPACKED_MAX: Final = 1 << 30  # bytes, of all entries
_DESCRIPTION_MAX: Final = 64 << 20
_NAME_MAX: Final = 400
_BLOCK: Final = 1 << 20
_UNIX: Final = 3  # system that has made an entry
_EXECUTABLE: Final = stat.S_IXUSR | stat.S_IXGRP | stat.S_IXOTH
_ENCRYPTED: Final = 1  # bit of an entry's flags


class FmuError(Exception):
    """An FMU that cannot be used; the text gives the reason, and the caller the file."""


class Archive:
    """The FMU at ``path``, an open zip file. Raises FmuError if it is none."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise FmuError("no such file: give the path of an FMU")
        try:
            self._zip = zipfile.ZipFile(path)
        except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
            raise FmuError(f"is not a zip archive, or was cut off: {_text(error)}") from error
        self._entries = self._zip.infolist()
        try:
            self._check()
        except FmuError:
            self._zip.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._zip.close()

    def __enter__(self) -> Archive:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def description(self) -> bytes:
        """Return the model description. Raises FmuError."""
        entry = next((entry for entry in self._entries if entry.filename == DESCRIPTION), None)
        if entry is None:
            raise FmuError(f"has no {DESCRIPTION}")
        if entry.file_size > _DESCRIPTION_MAX:
            raise FmuError(f"{DESCRIPTION} has {entry.file_size} bytes, allowed {_DESCRIPTION_MAX}")
        return b"".join(self._blocks(entry))

    def names(self) -> list[str]:
        """Return the names of all files."""
        return [entry.filename for entry in self._entries if not entry.is_dir()]

    def unpack(self, folder: Path) -> None:
        """Write all files into ``folder``. Raises FmuError."""
        written = 0
        for entry in self._entries:
            path = folder / entry.filename
            try:
                if entry.is_dir():
                    path.mkdir(parents=True, exist_ok=True)
                    continue
                path.parent.mkdir(parents=True, exist_ok=True)
                with path.open("xb") as file:
                    for block in self._blocks(entry):
                        written += len(block)
                        if written > _UNPACKED_MAX:
                            raise FmuError(f"unpacks to more than {_UNPACKED_MAX} bytes")
                        file.write(block)
                if entry.create_system == _UNIX and entry.external_attr >> 16 & _EXECUTABLE:
                    path.chmod(stat.S_IMODE(path.stat().st_mode) | stat.S_IXUSR)  # a program in the resources
            except OSError as error:
                raise FmuError(f"{entry.filename}: cannot be unpacked: {error.strerror}") from error

    def _blocks(self, entry: zipfile.ZipInfo):  # type: ignore[no-untyped-def]
        """Yield the content of ``entry``, no more than it states."""
        remaining = entry.file_size
        try:
            with self._zip.open(entry) as file:
                while block := file.read(_BLOCK):
                    remaining -= len(block)
                    if remaining < 0:
                        raise FmuError(f"{entry.filename}: is longer than the archive states")
                    yield block
        except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError, RuntimeError) as error:
            raise FmuError(f"{entry.filename}: cannot be unpacked: {_text(error)}") from error

    def _check(self) -> None:
        if len(self._entries) > _ENTRIES_MAX:
            raise FmuError(f"has {len(self._entries)} files, allowed {_ENTRIES_MAX}")
        total = sum(entry.file_size for entry in self._entries)
        if total > _UNPACKED_MAX:
            raise FmuError(f"unpacks to {total} bytes, allowed {_UNPACKED_MAX}")
        seen: set[str] = set()
        for entry in self._entries:
            name = entry.filename
            path = PurePosixPath(name)
            outside = path.is_absolute() or ".." in path.parts or "\\" in name or ":" in name or not path.parts
            if outside or len(name) > _NAME_MAX or not name.isprintable():
                raise FmuError(f"contains the file {name[:80]!r}: allowed are relative paths inside the archive")
            mode = entry.external_attr >> 16
            if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise FmuError(f"contains {name!r}, which is no regular file")
            if entry.flag_bits & _ENCRYPTED:
                raise FmuError(f"contains {name!r}, which is encrypted")
            if str(path) in seen:
                raise FmuError(f"contains {name!r} twice")
            seen.add(str(path))


def _text(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
