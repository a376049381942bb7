"""The file that a recording goes into: blocks are written whole or not at all, and brought to the disk each second."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Final

_SYNC_EVERY_S: Final = 1.0


class Sink:
    """What the MCAP writer takes for a stream. Bytes wait here until ``flush``.

    A block that the disk does not take is cut off again: what was written before it stays readable. From then on
    nothing is written, and ``problem`` says why. Raises OSError where the file cannot be made or exists already.
    """

    def __init__(self, path: Path) -> None:
        self.problem = ""
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._waiting: list[bytes] = []
        self._position = 0
        self._whole = 0
        self._dirty = False
        self._ended = threading.Event()
        self._syncing = threading.Thread(target=self._sync_each_second, name="recording", daemon=True)
        self._syncing.start()

    @property
    def size(self) -> int:
        """Bytes that stand in the file."""
        return self._whole

    @property
    def waiting(self) -> int:
        """Bytes that the next flush brings into the file."""
        return sum(map(len, self._waiting))

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Keep ``data`` for the next flush."""
        self._waiting.append(bytes(data))
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return where the next byte will stand."""
        return self._position

    def flush(self) -> None:
        """Write what waits: all of it, or none, and then ``problem`` is set."""
        block = memoryview(b"".join(self._waiting))
        self._waiting.clear()
        if self.problem or not block:
            return
        try:
            written = 0
            while written < len(block):
                written += os.write(self._descriptor, block[written:])
        except OSError as error:
            self.problem = str(error.strerror or error)
            os.ftruncate(self._descriptor, self._whole)
            return
        self._whole += len(block)
        self._dirty = True

    def close(self) -> None:
        """Flush, bring all to the disk and let go of the file. Idempotent."""
        if self._ended.is_set():
            return
        self.flush()
        self._ended.set()
        self._syncing.join()
        self._sync()
        os.close(self._descriptor)

    def _sync_each_second(self) -> None:
        while not self._ended.wait(_SYNC_EVERY_S):
            self._sync()

    def _sync(self) -> None:
        if not self._dirty:
            return
        self._dirty = False
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:  # a disk that takes blocks late may find out here that it is full
            self.problem = self.problem or str(error.strerror or error)
