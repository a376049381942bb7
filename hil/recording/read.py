"""Reader of recordings: complete ones, those that broke off, were rewritten, or are of earlier versions.

The file is read from start to end, so that one without an end can be read, too: its intact part is used, with a warning
that names what is not.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import NoneType
from typing import Any, Final, NamedTuple, TypeVar

import numpy as np
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from pydantic import ValidationError

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.model import ConfigModel
from hil.config.tables.open_table import FileTable
from hil.core.fields import leaf_fields, record_dtype
from hil.core.files import parse_json
from hil.core.incomplete import note_incomplete
from hil.core.messages import AXES_SAMPLE, HELD_SAMPLE, IMU_SAMPLE, MANIPULATOR_SAMPLE
from hil.core.own_code import note_data
from hil.core.part import part_sinks
from hil.core.part import parts as parts_of_program
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.errors import BadInput
from hil.recording import foxglove, parts, schema, writer
from hil.recording.scan import OWN_LIBRARY, Scan
from hil.recording.schema import present_key, with_present_names

_Model = TypeVar("_Model", bound=ConfigModel)

log = logging.getLogger("hil")

_BATCH_ROWS: Final = 5000
_AHEAD_ROWS: Final = 6000  # read beyond a batch: rows of other topics may be written that much later, 5 s of the rings
_REPLAYED: Final = ("/cycle", "/vmu/frames", "/imu", schema.SENSORS)
_NOTE_TEXTS: Final = ("message", "name", "kind")
_NOTE_NUMBERS: Final = ("t_s", "bench_s", "cycle")


@dataclass
class Contents:
    """Content of a recording, not interpreted.

    records: topic -> its flat layout and its messages' bytes, in the order of writing. lines: topic -> JSON messages.
    """

    path: Path
    run: dict[str, str] = field(default_factory=dict)
    end: dict[str, str] | None = None
    files: dict[str, str] = field(default_factory=dict)
    layouts: dict[str, np.dtype] = field(default_factory=dict)
    schemas: dict[str, bytes] = field(default_factory=dict)
    records: dict[str, list[bytes]] = field(default_factory=dict)
    lines: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    problem: str = ""
    """What of the file is not read, and why: see ``Scan.problem``."""
    rewritten: bool = False
    """By another program, or by ``hil recover``."""
    log_times: list[int] = field(default_factory=list)
    """Times in the file of the lines of the log."""

    @property
    def intact(self) -> bool:
        return not self.problem

    @property
    def version(self) -> str:
        return self.run.get("schema_version", "")

    def flat(self, topic: str) -> np.ndarray:
        """Return the messages of ``topic``, (n,), with dotted names of fields."""
        return np.frombuffer(b"".join(self.records[topic]), self.layouts[topic])


def contents(path: Path, topics: frozenset[str] | None = None) -> Contents:
    """Return the content of the recording at ``path`` with its later parts; topics: the selected ones, None for all.

    A warning names what of the file is not read. Raises BadInput, also for a later part alone.
    """
    recording = _contents_of_part(path, topics)
    if number := recording.run.get(parts.PART):
        text = f"part {number} of a recording: open its first part, the file without .part{number} in its name"
        raise BadInput.single(str(path), "", text)
    for later in parts.later_parts(path):
        _append(recording, _contents_of_part(later, topics))
    if recording.problem:
        note_incomplete(path, recording.problem)
    return recording


def _append(recording: Contents, later: Contents) -> None:
    """Add the rows, lines, end and attachments of a later part."""
    if later.run.get("run") != recording.run.get("run") or later.layouts != recording.layouts:
        raise BadInput.single(str(later.path), "", f"is no part of {recording.path}")
    for topic, records in later.records.items():
        recording.records.setdefault(topic, []).extend(records)
    for topic, lines in later.lines.items():
        recording.lines.setdefault(topic, []).extend(lines)
    recording.end, recording.problem = later.end, recording.problem or later.problem
    recording.rewritten, recording.log_times = (
        recording.rewritten or later.rewritten,
        recording.log_times + later.log_times,
    )
    recording.files |= later.files


def _contents_of_part(path: Path, topics: frozenset[str] | None) -> Contents:
    recording = Contents(path)
    schemas, channels = directory(path)
    for declared in channels.values():
        _add_channel(recording, declared, schemas)
    scan = Scan(path)
    selected = {number: channel for number, channel in channels.items() if topics is None or channel.topic in topics}
    for record in scan.records():
        match record:
            case Message():
                if (channel := selected.get(record.channel_id)) is not None:
                    _add_message(recording, channel, record)
                elif record.channel_id not in channels:
                    scan.damaged += 1
            case Metadata(name=writer.RUN):
                recording.run = dict(record.metadata)
            case Metadata(name=writer.END):
                recording.end = dict(record.metadata)
            case Attachment():
                recording.files[record.name] = record.data.decode(errors="replace")
            case _:
                pass
    if not recording.version:
        raise BadInput.single(str(path), "", f"not a recording of hil: an MCAP file without the metadata {writer.RUN}")
    recording.problem = scan.problem
    end_at = (recording.end or {}).get(writer.POSITION)
    moved = end_at is not None and scan.positions[writer.END] != int(end_at)
    recording.rewritten = moved or not scan.library.startswith(OWN_LIBRARY)
    return recording


def directory(path: Path) -> tuple[dict[int, Schema], dict[int, Channel]]:
    """Return schemas and channels by their numbers, also if the block that first defined them is damaged."""
    scan = Scan(path)
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    for record in scan.records():
        if scan.index is not None and scan.index.has_channels:
            return scan.index.schemas, scan.index.channels
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
    return schemas, channels


def _add_channel(recording: Contents, channel: Channel, schemas: dict[int, Schema]) -> None:
    if channel.message_encoding == schema.RECORD_ENCODING and channel.schema_id in schemas:
        text = schemas[channel.schema_id].data
        recording.layouts[channel.topic] = schema.layout_of(text, f"{recording.path}: {channel.topic}")
        recording.schemas[channel.topic] = text
        recording.records.setdefault(channel.topic, [])
    else:
        recording.lines.setdefault(channel.topic, [])


def _add_message(recording: Contents, channel: Channel, message: Message) -> None:
    if channel.topic in recording.layouts:
        size = recording.layouts[channel.topic].itemsize
        if len(message.data) != size:
            text = f"a record of {channel.topic} has {len(message.data)} bytes, its schema {size}"
            raise BadInput.single(str(recording.path), "", text)
        recording.records[channel.topic].append(message.data)
    elif channel.message_encoding == "json":
        recording.lines[channel.topic].append(_table(recording.path, channel.topic, message.data))
        if channel.topic == foxglove.LOG_TOPIC:
            recording.log_times.append(message.log_time)


def _table(path: Path, what: str, text: str | bytes) -> dict[str, Any]:
    """Return the JSON table in ``text``; raise BadInput."""
    try:
        table = parse_json(text)
    except ValueError as error:
        raise BadInput.single(str(path), what, f"not JSON: {error}") from error
    if not isinstance(table, dict):
        raise BadInput.single(str(path), what, "must be a table of keys and values")
    return table


class RowBatch(NamedTuple):
    """Rows of successive cycles, (n,) of CYCLE, with the arrivals and the samples of the IMU that these used.

    sensor_arrivals: those of further sensors, of SENSOR_ARRIVAL.
    """

    cycles: np.ndarray
    arrivals: np.ndarray
    imu_samples: np.ndarray
    sensor_arrivals: np.ndarray


@dataclass(frozen=True)
class Recorded:
    """A recorded run.

    cycles: (n,) of CYCLE. arrivals: (m,) of ARRIVAL. imu_samples, axes_samples: of
    IMU_SAMPLE and AXES_SAMPLE, empty unless these were faster than the cycle. manipulator_samples: of
    MANIPULATOR_SAMPLE, empty without a rotary manipulator. held_samples: of HELD_SAMPLE, empty without axes that are
    held. sensor_arrivals: of SENSOR_ARRIVAL, empty without further
    sensors. log: entries of the log as recorded. summary: as in
    ``hil run --json``, None for a run that broke off. intact: the file has its end and no damage.
    """

    path: Path
    run: dict[str, str]
    end: dict[str, str] | None
    scenario: Scenario
    rig: Rig
    cycles: np.ndarray
    arrivals: np.ndarray
    log: list[dict[str, Any]]
    summary: dict[str, Any] | None
    intact: bool
    files: dict[str, str]
    """Attachments: name -> text."""
    imu_samples: np.ndarray = field(default_factory=lambda: np.zeros(0, IMU_SAMPLE))
    axes_samples: np.ndarray = field(default_factory=lambda: np.zeros(0, AXES_SAMPLE))
    manipulator_samples: np.ndarray = field(default_factory=lambda: np.zeros(0, MANIPULATOR_SAMPLE))
    held_samples: np.ndarray = field(default_factory=lambda: np.zeros(0, HELD_SAMPLE))
    sensor_arrivals: np.ndarray = field(default_factory=lambda: np.zeros(0, SENSOR_ARRIVAL))
    absent: frozenset[str] = frozenset()
    """Dotted names of the fields of CYCLE that the recording lacks."""
    of_parts: Mapping[str, np.ndarray] = field(default_factory=dict)
    """Rows that parts have recorded, (k,) of their records, by the names of their sinks; empty if they have none."""
    rewritten: bool = False
    """By another program, in any order of the topics: ``row_batches`` does not go with it."""

    def as_batch(self) -> RowBatch:
        """Return all rows as one batch."""
        return RowBatch(self.cycles, self.arrivals, self.imu_samples, self.sensor_arrivals)

    def calibration(self, name: str, model: type[_Model]) -> _Model:
        """Return the attachment ``name``: cameras and target as assumed in the run. Raises BadInput."""
        return _model(self, name, model)


def load(path: Path) -> Recorded:
    """Return the run recorded at ``path``.

    Raises BadInput for a file that is not a recording, or of another version of the schemas or configuration.
    """
    return _recorded(contents(path, frozenset({*schema.records(), foxglove.LOG_TOPIC})))


def _recorded(recording: Contents) -> Recorded:
    _check_version(recording)
    for line in _missing_parts(recording):
        log.warning(line)
    path, summary = recording.path, recording.files.get(writer.SUMMARY)
    return Recorded(
        path,
        recording.run,
        recording.end,
        _model(recording, "scenario.json", Scenario),
        _model(recording, "rig.json", Rig),
        _rows(recording, "/cycle"),
        _rows(recording, "/vmu/frames"),
        [_note(path, note) for note in ordered_log(recording)],
        _table(path, writer.SUMMARY, summary) if summary else None,
        recording.intact,
        recording.files,
        _rows(recording, "/imu"),
        _rows(recording, "/axes"),
        _rows(recording, schema.MANIPULATOR),
        _rows(recording, schema.HELD),
        _rows(recording, schema.SENSORS),
        _absent(recording, "/cycle"),
        {name: _rows(recording, sink.topic) for name, sink in part_sinks().items() if sink.topic},
        recording.rewritten,
    )


def ordered_log(recording: Contents) -> list[dict[str, Any]]:
    """Return the lines of the log in the order of their numbers, if the file has them in that of their times.

    Programs that rewrite a file sort its messages by time, and lines from before and after a run have that of its
    start. Lines that are in neither order, or whose time in the file is not that of the line, stay as they are.
    """
    lines = recording.lines.get(foxglove.LOG_TOPIC, [])
    numbers, times = [line.get("number") for line in lines], recording.log_times
    if not all(isinstance(number, int) for number in numbers):
        return lines
    begin = {time - round(max(line.get("t_s") or 0.0, 0.0) * 1e9) for time, line in zip(times, lines, strict=True)}
    keys = list(zip(times, numbers, strict=True))
    return sorted(lines, key=lambda line: line["number"]) if len(begin) == 1 and keys == sorted(keys) else lines


def _missing_parts(recording: Contents) -> Iterator[str]:
    """Yield a line for each part that the run used and that is not installed: its rows are not read."""
    if schema.PARTS_FILE not in recording.files:
        return
    for name, part in _table(recording.path, schema.PARTS_FILE, recording.files[schema.PARTS_FILE]).items():
        if name not in parts_of_program().usable:
            origin = f"{part.get('origin')} {part.get('version')}" if isinstance(part, dict) else "unknown"
            text = f"part {name} of package {origin} is not installed: its rows and tables are not read"
            yield f"{recording.path}: {text}"


def _absent_tables(path: Path, files: dict[str, str], model: type[FileTable]) -> set[str]:
    """Return the keys of the tables that parts added to a recorded file of ``model`` and that no installed part has."""
    recorded = _table(path, schema.PARTS_FILE, files.get(schema.PARTS_FILE, "{}")).values()
    keys = [key for part in recorded if isinstance(part, dict) for key in part.get("tables", ()) if model.owns(key)]
    return {key.removeprefix(model.prefix) for key in keys} - {*model.added_tables()}


def load_without_rows(path: Path) -> Recorded:
    """Return the run recorded at ``path`` without its rows, which ``row_batches`` yields. Raises BadInput."""
    return _recorded(contents(path, frozenset({foxglove.LOG_TOPIC})))


def row_batches(path: Path, rows: int = _BATCH_ROWS) -> Iterator[RowBatch]:
    """Yield the rows of the recording at ``path`` and its later parts in order, at most ``rows`` at once.

    Memory is that of a batch, whatever the length of the recording. Raises BadInput as ``load``.
    """
    pending = {topic: np.zeros(0, record_dtype(schema.records()[topic][1])) for topic in _REPLAYED}
    first = 0  # cycle of the first pending row
    for piece in _pieces(path, rows):
        for topic in _REPLAYED:
            pending[topic] = np.concatenate([pending[topic], _rows(piece, topic)])
        while len(pending["/cycle"]) >= rows + _AHEAD_ROWS:
            yield _take(pending, first, rows)
            first += rows
    while len(pending["/cycle"]):
        n = min(rows, len(pending["/cycle"]))
        yield _take(pending, first, n)
        first += n


def _take(pending: dict[str, np.ndarray], first: int, n: int) -> RowBatch:
    """Take the first ``n`` rows out of ``pending``, of which ``first`` is the cycle, and what belongs to them."""
    taken = [pending["/cycle"][:n]]
    pending["/cycle"] = pending["/cycle"][n:].copy()
    for topic in _REPLAYED[1:]:
        is_due = pending[topic]["cycle"] < first + n
        taken.append(pending[topic][is_due])
        pending[topic] = pending[topic][~is_due]
    return RowBatch(*taken)


def _pieces(path: Path, rows: int) -> Iterator[Contents]:
    """Yield the replayed topics of the recording, about ``rows`` of its cycles at once, in the order of writing."""
    for part in (path, *parts.later_parts(path)):
        piece = Contents(part)
        schemas, channels = directory(part)
        for declared in channels.values():
            _add_channel(piece, declared, schemas)
        for record in Scan(part).records():
            match record:
                case Message():
                    channel = channels.get(record.channel_id)
                    if channel and channel.topic in _REPLAYED:
                        _add_message(piece, channel, record)
                case Metadata(name=writer.RUN):
                    piece.run = dict(record.metadata)
                case _:
                    pass
            if len(piece.records["/cycle"]) >= rows:
                yield piece
                piece.records = {topic: [] for topic in piece.records}
        yield piece


def _check_version(recording: Contents) -> None:
    if recording.version not in schema.READABLE:
        hil = recording.run.get("hil", "unknown")
        text = (
            f"a recording of schema version {recording.version}, written by hil {hil}; this program reads versions "
            f"{', '.join(schema.READABLE)}: read it with hil {hil}, or extract its numbers with hil export"
        )
        raise BadInput.single(str(recording.path), "", text)


def _rows(recording: Contents, topic: str) -> np.ndarray:
    """Return the messages of ``topic`` as rows of today's record; those that it lacks have ``Field.absent``."""
    dtype = record_dtype(schema.records()[topic][1])
    if topic not in recording.layouts:
        return np.zeros(0, dtype)
    rows = _as_recorded(recording, topic, dtype)
    if recording.rewritten:
        rows = rows[np.argsort(rows["cycle" if "cycle" in (dtype.names or ()) else "t_s"], kind="stable")]
    return rows


def _as_recorded(recording: Contents, topic: str, dtype: np.dtype) -> np.ndarray:
    recorded, today = recording.layouts[topic], schema.flat_dtype(dtype)
    if recorded == today:
        return np.frombuffer(bytearray().join(recording.records[topic]), dtype)  # kernels require writable arrays
    names, current = recorded.names or (), today.names or ()
    extended = all(name in current and recorded[name] == today[name] for name in names)
    is_of_part = topic in {sink.topic for sink in part_sinks().values()}  # whose rows grow with its own versions
    if not extended or (recording.version == str(schema.VERSION) and not is_of_part):
        whose = "the installed part" if is_of_part else f"schema version {recording.version}"
        text = f"the records of {topic} do not have the layout of {whose}"
        raise BadInput.single(str(recording.path), "", text)
    rows, flat = np.zeros(len(recording.records[topic]), dtype), recording.flat(topic)
    for field_ in leaf_fields(schema.records()[topic][1]):
        rows.view(today)[field_.name] = flat[field_.name] if field_.name in names else field_.absent
    return rows


def _absent(recording: Contents, topic: str) -> frozenset[str]:
    """Return the fields of today's record that the messages of ``topic`` lack."""
    today = schema.flat_dtype(record_dtype(schema.records()[topic][1]))
    recorded = recording.layouts.get(topic, today)
    return frozenset(today.names or ()) - frozenset(recorded.names or ())


def _note(path: Path, note: dict[str, Any]) -> dict[str, Any]:
    """Return a log line with the present name of the key that it sets; raise BadInput if it is not of the log."""
    texts = all(isinstance(note.get(key), str) for key in _NOTE_TEXTS)
    if not texts or not all(isinstance(note.get(key), (int, float, NoneType)) for key in _NOTE_NUMBERS):
        raise BadInput.single(str(path), foxglove.LOG_TOPIC, "a line of the log does not have its keys")
    return present_note(note)


def present_note(note: dict[str, Any]) -> dict[str, Any]:
    """Return a log line with the present name of the key that it sets, if it sets one."""
    if note.get("kind") != "setting":
        return note
    key, equals, value = note["message"].partition("=")
    return note | {"message": f"{present_key('Scenario', key.strip())}{equals}{value}"}


def _model(recording: Contents | Recorded, name: str, model: type[_Model]) -> _Model:
    path, files = recording.path, recording.files
    if name not in files:
        raise BadInput.single(str(path), name, "is missing in this recording")
    try:
        content = _table(path, name, files[name])
        note_data(str(path), content)
        if issubclass(model, FileTable):
            content = {key: each for key, each in content.items() if key not in _absent_tables(path, files, model)}
        return model.model_validate_json(json.dumps(with_present_names(model.__name__, content)))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        text = f"{first['msg']}: not valid in this program's configuration; read it with hil {recording.run.get('hil')}"
        raise BadInput.single(str(path), f"{name}: {key}", text) from error
