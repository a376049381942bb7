"""Writer of one run into one MCAP file, in the recorder process or, on a mock rig, in the run's own process."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, cast

import numpy as np
from mcap.writer import CompressionType, Writer

from hil.core.camera_images import overlay_shapes
from hil.core.messages import CYCLE
from hil.recording import foxglove, foxglove_images, schema
from hil.recording.block_file import BlockFile

FLUSH_S: Final = 0.1
"""Longest time of the run that a row is buffered; what is in the file survives this process."""

RUN, END, SUMMARY = "hil.run", "hil.end", "summary.json"
"""Names of the metadata at the start and at the end, and of the attachment with the run's numbers."""

_JSON_EACH_S: Final = 0.1  # period of the JSON messages for viewers
_SLACK_S: Final = 1e-9
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


class RunFile:
    """File of a run that is being recorded. Raises OSError if it cannot be created; later errors are counted."""

    def __init__(self, path: Path, header: RecordingHeader) -> None:
        self.path = path
        self._file = BlockFile(path)
        self._started_ns = header.started_ns
        self._writer = Writer(cast(IO[bytes], self._file), compression=CompressionType.ZSTD)
        self._writer.start("hil", f"hil {header.run.get('hil', '')}")
        self._json_schemas: dict[str, int] = {}
        self._channels = {topic: self._record_channel(topic) for topic in schema.RECORDS}
        self._channels |= {topic: self._json_channel(topic, content) for topic, content in foxglove.SCHEMAS.items()}
        self._source_dropped: dict[str, int] = {}
        self._cycles = self._dropped = self._unflushed = 0
        self._last_s = 0.0
        self._flushed_s = self._json_s = -np.inf
        self._writer.add_metadata(RUN, dict(header.run))
        for name, text in header.files.items():
            self._writer.add_attachment(self._started_ns, self._started_ns, name, "application/json", text.encode())
        self.flush()
        if self._file.problem:
            self._file.close()
            path.unlink()
            raise OSError(0, self._file.problem)

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

    def continue_from(self, before: RunFile) -> None:
        """Take over what rows refer to from the part before, the times and counts of their sources."""
        self._last_s = self._flushed_s = before._last_s
        self._json_s = before._json_s
        self._source_dropped = before._source_dropped

    @property
    def writers(self) -> dict[str, Callable[[np.ndarray], None]]:
        """Method that writes the rows of each sink in ``RecordingSinks``."""
        return {
            "cycles": self.write_cycles,
            "arrivals": self.write_arrivals,
            "log": self.write_log,
            "images": self.write_images,
            "monitor_images": self.write_images,
            "portions": self.write_portions,
            "imu_samples": lambda rows: self._write_samples("/imu", rows),
            "axes_samples": lambda rows: self._write_samples("/axes", rows),
        }

    def write_cycles(self, rows: np.ndarray) -> None:
        """Write rows (n,) of CYCLE."""
        for row in rows:
            self._cycle(row)

    def _cycle(self, row: np.void) -> None:
        t_s = self._last_s = float(row["t_s"])
        self._add("/cycle", row.tobytes(), t_s, self._cycles)
        self._cycles += 1
        if t_s - self._json_s >= _JSON_EACH_S - _SLACK_S:
            self._json_s = t_s
            self._add(foxglove.STATE_TOPIC, foxglove.encoded(foxglove.state(row)), t_s)
            self._add(foxglove.TRANSFORM_TOPIC, foxglove.encoded(foxglove.transform(row, self._time_ns(t_s))), t_s)
        if t_s - self._flushed_s >= FLUSH_S - _SLACK_S:
            self.flush()

    def write_arrivals(self, rows: np.ndarray) -> None:
        """Write frames of the vision unit, (n,) of ARRIVAL."""
        for row in rows:
            t_s = float(row["pose"]["t_s"]) if row["cycle"] >= 0 else self._last_s
            self._add("/vmu/frames", row.tobytes(), t_s)

    def write_log(self, rows: np.ndarray) -> None:
        """Write entries of the log, (n,) of LOG_ENTRY."""
        for row in rows:
            t_s = float(row["t_s"])
            self._add(foxglove.LOG_TOPIC, foxglove.encoded(foxglove.log(row, self._time_ns(t_s))), t_s)

    def write_images(self, rows: np.ndarray) -> None:
        """Write images, (n,) of IMAGE, and their overlays; count those that their source dropped."""
        for row in rows:
            camera = row["camera"].decode(errors="replace")
            if row["size"]:
                self._image(camera, row)
            dropped = int(row["dropped"])
            self.count_lost(dropped - self._source_dropped.get(camera, 0))
            self._source_dropped[camera] = dropped
            if self._file.buffered >= _BUFFERED_MAX:
                self.flush()

    def _image(self, camera: str, row: np.void) -> None:
        t_s = float(row["t_s"])
        t_s = self._last_s if math.isnan(t_s) else t_s
        time_ns = self._time_ns(t_s)
        topic = self._image_channel(camera, "", foxglove_images.PICTURE_SCHEMA)
        self._add(topic, foxglove_images.image(row, time_ns), t_s)
        topic = self._image_channel(camera, foxglove_images.ANNOTATIONS, foxglove_images.ANNOTATION_SCHEMA)
        self._add(topic, foxglove.encoded(foxglove_images.overlay(overlay_shapes(row), time_ns)), t_s)

    def write_portions(self, rows: np.ndarray) -> None:
        """Write results of the docking monitor, (n,) of PORTION."""
        for row in rows:
            self._add("/monitor/portions", row.tobytes(), float(row["t_s"]))

    def _write_samples(self, topic: str, rows: np.ndarray) -> None:
        """Write samples of IMU or axes that are faster than the cycle."""
        for row in rows:
            self._add(topic, row.tobytes(), float(row["t_s"]))

    def _image_channel(self, camera: str, ending: str, content: Mapping[str, Any]) -> str:
        topic = f"{foxglove_images.PICTURE_TOPICS}{camera}{ending}"
        if topic not in self._channels:
            self._channels[topic] = self._json_channel(topic, content)
        return topic

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

    def _add(self, topic: str, message: bytes, t_s: float, sequence: int = 0) -> None:
        if self._file.problem:
            self._dropped += 1
            return
        time_ns = self._time_ns(t_s)
        self._writer.add_message(self._channels[topic], time_ns, message, time_ns, sequence)
        self._unflushed += 1

    def _time_ns(self, t_s: float) -> int:
        """Return the log time of ``t_s`` of the run; times before the run become its start."""
        return self._started_ns + (round(t_s * 1e9) if t_s > 0.0 else 0)


assert CYCLE.itemsize % 8 == 0  # rows are contiguous in files and rings
