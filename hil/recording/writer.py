"""Writes one run into one MCAP file; the same code in the recorder process and, on a mock rig, in the run's own."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.core.camera_images import shapes_of
from hil.core.messages import CYCLE
from hil.recording import schema, show, show_images
from hil.recording.sink import Sink

FLUSH_S: Final = 0.1
"""Time of the run after which what came is in the file, and would survive this process."""

RUN, END, SUMMARY = "hil.run", "hil.end", "summary.json"
"""Names of the metadata at the begin and at the end, and of the attachment with the run's numbers."""

_SHOWN_EACH_S: Final = 0.1  # the JSON group is for the eye
_SLACK_S: Final = 1e-9
_WAITING_MOST: Final = 8 * 1024 * 1024  # bytes of pictures that come while no cycle does


@dataclass(frozen=True)
class RecordingHeader:
    """What is known before a run. run: names, versions, calibration. files: name of an attachment -> its text."""

    run: Mapping[str, str]
    files: Mapping[str, str]
    started_ns: int
    """UTC; a message's log time is this plus the time of the run."""


@dataclass(frozen=True)
class RecordingStats:
    """What became of a recording.

    cycles: in the file, None where that is not known. dropped: messages that are not in the file; problem: why, ""
    where none is missing.
    """

    cycles: int | None = 0
    dropped: int = 0
    size_bytes: int = 0
    problem: str = ""


class RunFile:
    """A recording under way. Raises OSError where the file cannot be made; later trouble is counted, not raised."""

    def __init__(self, path: Path, header: RecordingHeader) -> None:
        self.path = path
        self._sink = Sink(path)
        self._started_ns = header.started_ns
        self._writer = Writer(cast(IO[bytes], self._sink), compression=CompressionType.ZSTD)
        self._writer.start("hil", f"hil {header.run.get('hil', '')}")
        self._json_schemas: dict[str, int] = {}
        self._channels = {topic: self._record_channel(topic) for topic in schema.RECORDS}
        self._channels |= {topic: self._json_channel(topic, content) for topic, content in show.SCHEMAS.items()}
        self._left_out: dict[str, int] = {}
        self._cycles = self._dropped = self._unflushed = 0
        self._last_s = 0.0
        self._flushed_s = self._shown_s = -np.inf
        self._writer.add_metadata(RUN, dict(header.run))
        for name, text in header.files.items():
            self._writer.add_attachment(self._started_ns, self._started_ns, name, "application/json", text.encode())
        self.flush()
        if self._sink.problem:
            self._sink.close()
            path.unlink()
            raise OSError(0, self._sink.problem)

    def _record_channel(self, topic: str) -> int:
        name, fields = schema.RECORDS[topic]
        number = self._writer.register_schema(name, schema.FIELDS_ENCODING, schema.describe(name, fields))
        return self._writer.register_channel(topic, schema.RECORD_ENCODING, number)

    def _json_channel(self, topic: str, content: Mapping[str, Any]) -> int:
        title = content["title"]
        if title not in self._json_schemas:
            text = json.dumps(content).encode()
            self._json_schemas[title] = self._writer.register_schema(title, "jsonschema", text)
        return self._writer.register_channel(topic, "json", self._json_schemas[title])

    @property
    def takers(self) -> dict[str, Callable[[np.ndarray], None]]:
        """Who takes the rows of each name in ``Taps``."""
        return {
            "cycles": self.cycles,
            "arrivals": self.arrivals,
            "notes": self.notes,
            "pictures": self.pictures,
            "monitor_pictures": self.pictures,
            "portions": self.portions,
        }

    def cycles(self, rows: np.ndarray) -> None:
        """Write rows (n,) of CYCLE."""
        for row in rows:
            self._cycle(row)

    def _cycle(self, row: np.void) -> None:
        t_s = self._last_s = float(row["t_s"])
        self._add("/cycle", row.tobytes(), t_s, self._cycles)
        self._cycles += 1
        if t_s - self._shown_s >= _SHOWN_EACH_S - _SLACK_S:
            self._shown_s = t_s
            self._add(show.STATE_TOPIC, show.encoded(show.state(row)), t_s)
            self._add(show.TRANSFORM_TOPIC, show.encoded(show.transform(row, self._time_ns(t_s))), t_s)
        if t_s - self._flushed_s >= FLUSH_S - _SLACK_S:
            self.flush()

    def arrivals(self, rows: np.ndarray) -> None:
        """Write frames of the vision unit, (n,) of ARRIVAL."""
        for row in rows:
            t_s = float(row["pose"]["t_s"]) if row["cycle"] >= 0 else self._last_s
            self._add("/vmu/frames", row.tobytes(), t_s)

    def notes(self, rows: np.ndarray) -> None:
        """Write what was noted, (n,) of NOTE."""
        for row in rows:
            t_s = float(row["t_s"])
            self._add(show.LOG_TOPIC, show.encoded(show.log(row, self._time_ns(t_s))), t_s)

    def pictures(self, rows: np.ndarray) -> None:
        """Write pictures, (n,) of PICTURE, and what is drawn over them; count those that their maker left out."""
        for row in rows:
            camera = row["camera"].decode(errors="replace")
            if row["size"]:
                self._picture(camera, row)
            left_out = int(row["left_out"])
            self.lost(left_out - self._left_out.get(camera, 0))
            self._left_out[camera] = left_out
            if self._sink.waiting >= _WAITING_MOST:
                self.flush()

    def _picture(self, camera: str, row: np.void) -> None:
        t_s = float(row["t_s"])
        t_s = self._last_s if math.isnan(t_s) else t_s
        time_ns = self._time_ns(t_s)
        topic = self._picture_channel(camera, "", show_images.PICTURE_SCHEMA)
        self._add(topic, show_images.picture(row, time_ns), t_s)
        topic = self._picture_channel(camera, show_images.ANNOTATIONS, show_images.ANNOTATION_SCHEMA)
        self._add(topic, show.encoded(show_images.drawn(shapes_of(row), time_ns)), t_s)

    def portions(self, rows: np.ndarray) -> None:
        """Write what the docking monitor said, (n,) of PORTION."""
        for row in rows:
            self._add("/monitor/portions", row.tobytes(), float(row["t_s"]))

    def _picture_channel(self, camera: str, ending: str, content: Mapping[str, Any]) -> str:
        topic = f"{show_images.PICTURE_TOPICS}{camera}{ending}"
        if topic not in self._channels:
            self._channels[topic] = self._json_channel(topic, content)
        return topic

    @property
    def trouble(self) -> str:
        """Why the disk takes nothing any more; "" while it does."""
        return self._sink.problem

    def account(self) -> RecordingStats:
        """Return how the recording stands."""
        return RecordingStats(self._cycles, self._dropped, self._sink.size, self._problem())

    def lost(self, messages: int) -> None:
        """Count messages that never came here."""
        self._dropped += messages

    def flush(self) -> None:
        """Bring what came into the file."""
        self._flushed_s = self._last_s
        if not self._sink.problem:
            self._writer.flush()
            if self._sink.problem:
                self._dropped += self._unflushed
        self._unflushed = 0

    def finish(self, end: Mapping[str, str], summary: str = "") -> RecordingStats:
        """Write how it ended, the summary (JSON) and the index; close the file."""
        self.flush()
        if not self._sink.problem:
            end = {**end, "cycles": str(self._cycles), "dropped": str(self._dropped)}
            if summary:
                time_ns = self._time_ns(self._last_s)
                self._writer.add_attachment(time_ns, time_ns, SUMMARY, "application/json", summary.encode())
            self._writer.add_metadata(END, end)
            self._writer.finish()
        self._sink.close()
        return self.account()

    def _problem(self) -> str:
        if self._sink.problem:
            return (
                f"{self.path}: {self._sink.problem}: {self._dropped} messages are not recorded; "
                f"what was written before stands, make it whole with hil recover"
            )
        if not self._dropped:
            return ""
        return f"{self.path}: {self._dropped} messages came too fast, or are pictures too large, and are not recorded"

    def _add(self, topic: str, message: bytes, t_s: float, sequence: int = 0) -> None:
        if self._sink.problem:
            self._dropped += 1
            return
        time_ns = self._time_ns(t_s)
        self._writer.add_message(self._channels[topic], time_ns, message, time_ns, sequence)
        self._unflushed += 1

    def _time_ns(self, t_s: float) -> int:
        """Return the log time of what happened at ``t_s`` of the run; what was before the run is put to its begin."""
        return self._started_ns + (round(t_s * 1e9) if t_s > 0.0 else 0)


assert CYCLE.itemsize % 8 == 0  # rows follow each other in files and rings without a gap
