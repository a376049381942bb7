"""Writer of one run into one MCAP file, in the recorder process or, on a mock rig, in the run's own process."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Final, cast

from mcap.writer import CompressionType, Writer

from hil.core.messages import CYCLE
from hil.recording.block_file import BlockFile
from hil.recording.run_messages import SLACK_S, MessageSchema, RunMessages

FLUSH_S: Final = 0.1
"""Longest time of the run that a row is buffered; what is in the file survives this process."""

RUN, END, SUMMARY = "hil.run", "hil.end", "summary.json"
"""Names of the metadata at the start and at the end, and of the attachment with the run's numbers."""

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
        self._writer = Writer(cast(IO[bytes], self._file), compression=CompressionType.ZSTD)
        self._writer.start("hil", f"hil {header.run.get('hil', '')}")
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

    def continue_from(self, before: RunFile) -> None:
        """Take over what rows refer to from the part before, the times and counts of their sources."""
        self._last_s = self._flushed_s = before._last_s
        self._json_s = before._json_s
        self._source_dropped = before._source_dropped

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
            self._writer.add_metadata(END, end)
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
        self._unflushed += 1

    def _time_ns(self, t_s: float, bench_s: float = math.nan) -> int:
        return self._started_ns + (round(t_s * 1e9) if t_s > 0.0 else 0)


assert CYCLE.itemsize % 8 == 0  # rows are contiguous in files and rings
