"""Watch over the computer that the tests run on: how long it lets a byte on a pseudo-terminal wait."""

from __future__ import annotations

import os
import sys
import tempfile
import time
import tty
from pathlib import Path

PERIOD_S = 0.005
LONGEST_S = 0.02
"""A wait beyond this one can lose packets of emulated wires, whose cycle takes 10 to 20 ms."""


class Pauses:
    """Pauses of the computer that are longer than ``LONGEST_S``. The process starts with the first interval."""

    def __init__(self) -> None:
        self._file: Path | None = None
        self._begin_s = 0.0

    def begin(self) -> None:
        """Start a new interval."""
        if self._file is None:
            number, name = tempfile.mkstemp(prefix="pauses-")
            os.close(number)
            self._file = Path(name)
            os.posix_spawn(sys.executable, [sys.executable, "-S", __file__, name], os.environ)
        self._begin_s = time.monotonic()

    def longest_s(self) -> float:
        """Return the longest pause since ``begin``, zero if none was longer than ``LONGEST_S``."""
        assert self._file is not None
        found = (line.split() for line in self._file.read_text(encoding="ascii").splitlines(keepends=True))
        return max((float(line[1]) for line in found if len(line) == 2 and float(line[0]) > self._begin_s), default=0.0)


def _watch(file: str) -> None:
    """Append a line with time and duration for each pause until the parent has ended, then remove the file."""
    near, far = os.openpty()
    tty.setraw(far)
    parent = os.getppid()
    with open(file, "a", encoding="ascii", buffering=1) as lines:
        while os.getppid() == parent:
            start_s = time.monotonic()
            time.sleep(PERIOD_S)
            os.write(near, b".")
            os.read(far, 1)
            now_s = time.monotonic()
            if now_s - start_s - PERIOD_S > LONGEST_S:
                lines.write(f"{now_s:.6f} {now_s - start_s - PERIOD_S:.6f}\n")
    os.unlink(file)


if __name__ == "__main__":
    _watch(sys.argv[1])
