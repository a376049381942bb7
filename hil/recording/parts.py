"""Recording of a long run in several files, so that neither a file nor the memory of its index grows without bound.

The first part is ``NAME.mcap``, the others ``NAME.part2.mcap`` and so on, each a complete recording with header, index
and end. Readers are given the first one and read all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import numpy as np

from hil.recording.writer import RecordingHeader, RecordingStats, RunFile

PART_CYCLES: Final = 180_000
"""Cycles of a part: an hour at 50 Hz, 0.4 GB before compression."""
PART, CONTINUED = "part", "continued"
"""Key of the header with the number of a later part; ``stop`` of a part that has a next one."""


def part_path(path: Path, number: int) -> Path:
    """Return the path of a part of the recording whose first part is ``path``."""
    return path if number == 1 else path.with_name(f"{path.stem}.part{number}{path.suffix}")


def later_parts(path: Path) -> Iterator[Path]:
    """Yield the parts after the first one, ``path``, as far as they exist without a gap."""
    number = 2
    while (part := part_path(path, number)).exists():
        yield part
        number += 1


class PartedFile:
    """File of a run that is being recorded, with the interface of ``RunFile``; a new part follows when one is full."""

    def __init__(self, path: Path, header: RecordingHeader, part_cycles: int | None = None) -> None:
        self.path = path
        self._header = header
        self._part_cycles = part_cycles or PART_CYCLES
        self._number = 1
        self._file = RunFile(path, header)
        self._before: list[RecordingStats] = []

    @property
    def writers(self) -> dict[str, Callable[[np.ndarray], None]]:
        """Method that writes the rows of each sink in ``RecordingSinks``."""

        def write(name: str) -> Callable[[np.ndarray], None]:
            return lambda rows: self._file.writers[name](rows)

        return {name: write(name) for name in self._file.writers} | {"cycles": self._write_cycles}

    def _write_cycles(self, rows: np.ndarray) -> None:
        while len(rows):
            room = self._part_cycles - (self._file.stats().cycles or 0)
            if room <= 0:
                self._next_part()
                continue
            self._file.write_cycles(rows[:room])
            rows = rows[room:]

    def _next_part(self) -> None:
        """Close the present part and begin the next; on an error of the disk the present one counts what is lost."""
        if self._file.disk_error:
            self._part_cycles = np.iinfo(np.int64).max
            return
        header = RecordingHeader(
            {**self._header.run, PART: str(self._number + 1)}, self._header.files, self._header.started_ns
        )
        try:
            following = RunFile(part_path(self.path, self._number + 1), header)
        except OSError:
            self._part_cycles = np.iinfo(np.int64).max  # the file continues while the disk accepts it
            return
        following.continue_from(self._file)
        self._before.append(self._file.finish({"stop": CONTINUED}))
        self._file, self._number = following, self._number + 1

    @property
    def disk_error(self) -> str:
        """Error after which nothing more is written, "" without one."""
        return self._file.disk_error

    def stats(self) -> RecordingStats:
        """Return the statistics of all parts so far."""
        return self._sum(self._file.stats())

    def _sum(self, last: RecordingStats) -> RecordingStats:
        parts = [*self._before, last]
        return RecordingStats(
            sum(part.cycles or 0 for part in parts),
            sum(part.dropped for part in parts),
            sum(part.size_bytes for part in parts),
            next((part.problem for part in parts if part.problem), ""),
        )

    def count_lost(self, messages: int) -> None:
        """Count messages that did not arrive here."""
        self._file.count_lost(messages)

    def flush(self) -> None:
        """Write the buffered messages."""
        self._file.flush()

    def finish(self, end: Mapping[str, str], summary: str = "") -> RecordingStats:
        """Write the end and the summary into the last part, and close it."""
        return self._sum(self._file.finish(end, summary))
