"""Text files that are written completely or not at all."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from hil.errors import BadInput


def write_text(text: str, path: str | Path, mode: int = 0o666) -> None:
    """Write ``text`` to ``path``, completely or not at all; raise BadInput if it cannot be written.

    mode: of the new file, less the process' mask.
    """
    out = Path(path)
    partial = Path(f"{path}.part")
    try:
        if out.exists() and not out.is_file():  # a device or a pipe: never replaced
            out.write_text(text, encoding="utf-8")
            return
        partial.unlink(missing_ok=True)
        with open(partial, "x", encoding="utf-8", opener=lambda name, flags: os.open(name, flags, mode)) as file:
            file.write(text)
        os.replace(partial, out)
    except OSError as error:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise BadInput.single(str(path), "", f"cannot be written: {error.strerror or error}") from error
