"""File of a recording: blocks are written completely or not at all, and synchronised to the disk each second."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Final

_SYNC_EVERY_S: Final = 1.0


class BlockFile:
    """Stream for the MCAP writer, which buffers all bytes until ``flush``.

    If a block cannot be written, the file is truncated to the blocks before it, which stay readable. From then on
    nothing is written, and ``problem`` gives the reason. Raises OSError if the file cannot be created or exists.
    """

    def __init__(self, path: Path) -> None:
        self.problem = ""
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._buffer: list[bytes] = []
        self._position = 0
        self._size = 0
        self._dirty = False
        self._ended = threading.Event()
        self._syncing = threading.Thread(target=self._sync_each_second, name="recording", daemon=True)
        self._syncing.start()

    @property
    def size(self) -> int:
        """Bytes in the file."""
        return self._size

    @property
    def buffered(self) -> int:
        """Bytes that the next flush writes."""
        return sum(map(len, self._buffer))

    def write(self, data: bytes | bytearray | memoryview) -> int:
        """Buffer ``data`` for the next flush."""
        self._buffer.append(bytes(data))
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._position

    def flush(self) -> None:
        """Write the buffered bytes: all of them, or none, and then ``problem`` is set."""
        block = memoryview(b"".join(self._buffer))
        self._buffer.clear()
        if self.problem or not block:
            return
        try:
            written = 0
            while written < len(block):
                written += os.write(self._descriptor, block[written:])
        except OSError as error:
            self.problem = str(error.strerror or error)
            os.ftruncate(self._descriptor, self._size)
            return
        self._size += len(block)
        self._dirty = True

    def close(self) -> None:
        """Flush, synchronise to the disk and close the file. Idempotent."""
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
        except OSError as error:  # a disk with delayed allocation can report here that it is full
            self.problem = self.problem or str(error.strerror or error)
