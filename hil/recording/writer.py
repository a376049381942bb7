"""Writer of one run into one MCAP file, in the recorder process or, on a mock rig, in the run's own process.

The blocks of the file are written completely or not at all, and synchronised to the disk each second.
"""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, cast

from mcap.writer import CompressionType, Writer

from hil.core.messages import CYCLE
from hil.recording.content_digest import ContentDigest
from hil.recording.run_messages import SLACK_S, MessageSchema, RunMessages
from hil.recording.scan import OWN_LIBRARY

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


FLUSH_S: Final = 0.1
"""Longest time of the run that a row is buffered; what is in the file survives this process."""

RUN, END, SUMMARY = "hil.run", "hil.end", "summary.json"
"""Names of the metadata at the start and at the end, and of the attachment with the run's numbers."""

POSITION: Final = "position"
"""Key of the end with its position in the file, which is another one in a file that was rewritten."""

_BUFFERED_MAX: Final = 8 * 1024 * 1024  # bytes of images that arrive between cycles


@dataclass(frozen=True)
class RecordingHeader:
    """Header of a recording. run: names, versions, calibration. files: name of an attachment -> its text."""

    run: Mapping[str, str]
    files: Mapping[str, str]
    started_ns: int
    """UTC; a message's log time is this plus the time of the run."""


@dataclass(frozen=True)
class RecordingStats:
    """Statistics of a recording.

    cycles: in the file, None if unknown. dropped: messages that are not in the file; problem: the reason, "" if none
    is missing.
    """

    cycles: int | None = 0
    dropped: int = 0
    size_bytes: int = 0
    problem: str = ""


class RunFile(RunMessages):
    """File of a run that is being recorded. Raises OSError if it cannot be created; later errors are counted."""

    def __init__(self, path: Path, header: RecordingHeader) -> None:
        self.path = path
        self._file = BlockFile(path)
        self._started_ns = header.started_ns
        self._writer = Writer(cast(IO[bytes], self._file), compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._writer.start("hil", f"{OWN_LIBRARY}{header.run.get('hil', '')}")
        self._content = ContentDigest()
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._dropped = self._unflushed = 0
        self._flushed_s = -math.inf
        super().__init__()
        self._writer.add_metadata(RUN, dict(header.run))
        for name, text in header.files.items():
            self._writer.add_attachment(self._started_ns, self._started_ns, name, "application/json", text.encode())
        self.begin(header.files)
        self.flush()
        if self._file.problem:
            self._file.close()
            path.unlink()
            raise OSError(0, self._file.problem)

    def continue_from(self, previous: RunFile) -> None:
        """Take over what rows refer to from the part before, the times and counts of their sources."""
        self._last_s = self._flushed_s = previous._last_s
        self._json_s = previous._json_s
        self._source_dropped = previous._source_dropped

    def _after_message(self) -> None:
        """Write what is buffered, every ``FLUSH_S`` of the run and after many images."""
        if self._last_s - self._flushed_s >= FLUSH_S - SLACK_S or self._file.buffered >= _BUFFERED_MAX:
            self.flush()

    @property
    def disk_error(self) -> str:
        """Error after which nothing more is written, "" without one."""
        return self._file.problem

    def stats(self) -> RecordingStats:
        """Return the statistics so far."""
        return RecordingStats(self._cycles, self._dropped, self._file.size, self._problem())

    def count_lost(self, messages: int) -> None:
        """Count messages that did not arrive here."""
        self._dropped += messages

    def flush(self) -> None:
        """Write the buffered messages."""
        self._flushed_s = self._last_s
        if not self._file.problem:
            self._writer.flush()
            if self._file.problem:
                self._dropped += self._unflushed
        self._unflushed = 0

    def finish(self, end: Mapping[str, str], summary: str = "") -> RecordingStats:
        """Write the metadata of the end, the summary (JSON) and the index; close the file."""
        self.flush()
        if not self._file.problem:
            end = {**end, "cycles": str(self._cycles), "dropped": str(self._dropped)}
            if summary:
                time_ns = self._time_ns(self._last_s)
                self._writer.add_attachment(time_ns, time_ns, SUMMARY, "application/json", summary.encode())
            self._writer.add_metadata(END, end | self._content.keys | {POSITION: str(self._file.tell())})
            self._writer.finish()
        self._file.close()
        return self.stats()

    def _problem(self) -> str:
        if self._file.problem:
            return (
                f"{self.path}: {self._file.problem}: {self._dropped} messages are not recorded; "
                f"the part before is intact; complete the file with hil recover"
            )
        if not self._dropped:
            return ""
        return f"{self.path}: {self._dropped} messages arrived too fast or are too large, and are not recorded"

    def _open_channel(self, topic: str, encoding: str, content: MessageSchema) -> None:
        if content.name not in self._schemas:
            self._schemas[content.name] = self._writer.register_schema(content.name, content.encoding, content.data)
        self._channels[topic] = self._writer.register_channel(topic, encoding, self._schemas[content.name])

    def _add(self, topic: str, message: bytes, time_ns: int, sequence: int = 0) -> None:
        if self._file.problem:
            self._dropped += 1
            return
        self._writer.add_message(self._channels[topic], time_ns, message, time_ns, sequence)
        self._content.add(topic, time_ns, message)
        self._unflushed += 1

    def _time_ns(self, t_s: float, bench_s: float = math.nan) -> int:
        return self._started_ns + (round(t_s * 1e9) if t_s > 0.0 else 0)


assert CYCLE.itemsize % 8 == 0  # rows are contiguous in files and rings
