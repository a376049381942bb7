"""Messages of a run: rows of the loop's sinks become messages of topics, in a file or for viewers."""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np

from hil.core.camera_images import overlay_shapes
from hil.core.part import part_sinks
from hil.recording import foxglove, foxglove_images, foxglove_scene, schema

SLACK_S: Final = 1e-9
_JSON_EACH_S: Final = 0.1  # period of the JSON messages for viewers, unless the rig has another


class MessageSchema(NamedTuple):
    """Schema of a channel: its name, and its text in an encoding."""

    name: str
    encoding: str
    data: bytes


def json_schema(content: Mapping[str, Any]) -> MessageSchema:
    """Return the JSON schema ``content``, named by its title."""
    return MessageSchema(content["title"], "jsonschema", json.dumps(content).encode())


def record_channel(topic: str) -> tuple[str, str, MessageSchema]:
    """Return topic, encoding and schema of a channel of packed records."""
    name, fields = schema.records()[topic]
    return topic, schema.RECORD_ENCODING, MessageSchema(name, schema.FIELDS_ENCODING, schema.describe(name, fields))


def fixed_channels() -> Iterator[tuple[str, str, MessageSchema]]:
    """Yield topic, encoding and schema of each channel that every run has; those of images come with their images.

    Those of a rotary manipulator, of held axes, of further sensors and of parts are opened for a run with them.
    """
    for topic in schema.RECORDS:
        if topic not in schema.OPTIONAL:
            yield record_channel(topic)
    for topic, table in (*foxglove.SCHEMAS.items(), (foxglove.SCENE_TOPIC, foxglove_scene.SCENE_SCHEMA)):
        yield topic, "json", json_schema(table)


class RunMessages(ABC):
    """Messages of one run. Subclasses write them to a file or send them to viewers."""

    def __init__(self) -> None:
        for topic, encoding, content in fixed_channels():
            self._open_channel(topic, encoding, content)
        self._image_topics: set[str] = set()
        self._source_dropped: dict[str, int] = {}
        self._cycles = 0
        self._last_s = 0.0
        self._json_s, self._json_each_s = -math.inf, _JSON_EACH_S

    @abstractmethod
    def _open_channel(self, topic: str, encoding: str, content: MessageSchema) -> None:
        """Open the channel of ``topic``."""

    @abstractmethod
    def _add(self, topic: str, message: bytes, time_ns: int, sequence: int = 0) -> None:
        """Write or send one message."""

    @abstractmethod
    def _time_ns(self, t_s: float, bench_s: float = math.nan) -> int:
        """Return the UTC of ``t_s`` of the run, or of ``bench_s`` if the run has no time."""

    @abstractmethod
    def count_lost(self, messages: int) -> None:
        """Count messages that did not arrive here."""

    def _after_message(self) -> None:  # noqa: B027 - a hook
        """Do what is due after a cycle or an image."""

    @property
    def writers(self) -> dict[str, Callable[[np.ndarray], None]]:
        """Method that writes the rows of each sink in ``RecordingSinks``."""
        return {
            "cycles": self.write_cycles,
            "arrivals": self.write_arrivals,
            "log": self.write_log,
            "images": self.write_images,
            "imu_samples": lambda rows: self._write_samples("/imu", rows),
            "axes_samples": lambda rows: self._write_samples("/axes", rows),
            "sensor_samples": self.write_sensor_samples,
            "manipulator_samples": lambda rows: self._write_samples(schema.MANIPULATOR, rows),
            "held_samples": lambda rows: self._write_samples(schema.HELD, rows),
            **{name: self._writer_of(sink.topic) for name, sink in part_sinks().items()},
        }

    def _writer_of(self, topic: str) -> Callable[[np.ndarray], None]:
        return (lambda rows: self._write_samples(topic, rows)) if topic else self.write_images

    def begin(self, files: Mapping[str, str]) -> None:
        """Take over the rig's rate for viewers and its manipulator; write target, chaser and corridor for a 3-D view.

        files: attachments of the recording, name -> text.
        """
        rig = json.loads(files.get("rig.json", "{}"))
        self._json_each_s = _telemetry_period_s(rig)
        if (rig.get("rotary_manipulator") or {}).get("driver", "none") != "none":
            self._open_channel(*record_channel(schema.MANIPULATOR))
        for name, topic in ((schema.HELD_FILE, schema.HELD), (schema.SENSORS_FILE, schema.SENSORS)):
            if name in files:
                self._open_channel(*record_channel(topic))
        for used in json.loads(files.get(schema.PARTS_FILE, "{}")).values():
            for topic in used["topics"]:
                if topic in schema.records():
                    self._open_channel(*record_channel(topic))
        time_ns = self._time_ns(0.0)
        if (scene := foxglove_scene.scene_of(files, time_ns)) is not None:
            self._add(foxglove.SCENE_TOPIC, foxglove.encoded(scene), time_ns)

    def write_cycles(self, rows: np.ndarray) -> None:
        """Write rows (n,) of CYCLE."""
        for row in rows:
            self._cycle(row)
            self._after_message()

    def _cycle(self, row: np.void) -> None:
        t_s = self._last_s = float(row["t_s"])
        time_ns = self._time_ns(t_s)
        self._add("/cycle", row.tobytes(), time_ns, self._cycles)
        self._cycles += 1
        if t_s - self._json_s >= self._json_each_s - SLACK_S:
            self._json_s = t_s
            self._add(foxglove.STATE_TOPIC, foxglove.encoded(foxglove.state(row)), time_ns)
            self._add(foxglove.TRANSFORM_TOPIC, foxglove.encoded(foxglove.transform(row, time_ns)), time_ns)

    def write_arrivals(self, rows: np.ndarray) -> None:
        """Write frames of the vision unit, (n,) of ARRIVAL."""
        for row in rows:
            t_s = float(row["pose"]["t_s"]) if row["cycle"] >= 0 else self._last_s
            self._add("/vmu/frames", row.tobytes(), self._time_ns(t_s))

    def write_log(self, rows: np.ndarray) -> None:
        """Write entries of the log, (n,) of LOG_ENTRY."""
        for row in rows:
            time_ns = self._time_ns(float(row["t_s"]), float(row["bench_s"]))
            self._add(foxglove.LOG_TOPIC, foxglove.encoded(foxglove.log(row, time_ns)), time_ns)

    def write_images(self, rows: np.ndarray) -> None:
        """Write images, (n,) of IMAGE, and their overlays; count those that their source dropped."""
        for row in rows:
            camera = row["camera"].decode(errors="replace")
            if row["size"]:
                self._image(camera, row)
            dropped = int(row["dropped"])
            self.count_lost(dropped - self._source_dropped.get(camera, 0))
            self._source_dropped[camera] = dropped
            self._after_message()

    def _image(self, camera: str, row: np.void) -> None:
        t_s = float(row["t_s"])
        time_ns = self._time_ns(self._last_s if math.isnan(t_s) else t_s, float(row["bench_s"]))
        topic = self._image_channel(camera, "", foxglove_images.PICTURE_SCHEMA)
        self._add(topic, foxglove_images.image(row, time_ns), time_ns)
        topic = self._image_channel(camera, foxglove_images.ANNOTATIONS, foxglove_images.ANNOTATION_SCHEMA)
        self._add(topic, foxglove.encoded(foxglove_images.overlay(overlay_shapes(row), time_ns)), time_ns)

    def _image_channel(self, camera: str, ending: str, content: Mapping[str, Any]) -> str:
        topic = f"{foxglove_images.PICTURE_TOPICS}{camera}{ending}"
        if topic not in self._image_topics:
            self._image_topics.add(topic)
            self._open_channel(topic, "json", json_schema(content))
        return topic

    def write_sensor_samples(self, rows: np.ndarray) -> None:
        """Write samples of further sensors, (n,) of SENSOR_ARRIVAL, each at its arrival."""
        for row in rows:
            self._add(schema.SENSORS, row.tobytes(), self._time_ns(float(row["sample"]["received_s"])))

    def _write_samples(self, topic: str, rows: np.ndarray) -> None:
        """Write samples, each at its time of the run."""
        for row in rows:
            self._add(topic, row.tobytes(), self._time_ns(float(row["t_s"])))


def _telemetry_period_s(rig: Mapping[str, Any]) -> float:
    """Return the period of the messages for viewers, s, of the table of a rig."""
    rate_hz = rig.get("telemetry", {}).get("rate_hz")
    return _JSON_EACH_S if rate_hz is None else 1.0 / rate_hz
