"""Makes a recording that broke off whole again: copies what can be read into a new file with an end and an index."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.writer import CompressionType, Writer

from hil.errors import BadInput
from hil.recording.read import Scan
from hil.recording.sink import Sink


@dataclass(frozen=True)
class Recovered:
    """What was found. out: the new file, None where the old one is intact. length_s: from first to last message."""

    out: Path | None
    messages: int
    lost_chunks: int
    length_s: float


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Write what is whole in the file at ``path`` into ``out``, by default ``NAME.recovered.mcap`` beside it.

    The file itself stays as it is; an intact one is only counted. Raises BadInput where it is no MCAP file, or
    ``out`` exists already or cannot be written.
    """
    scan = Scan(path)
    counted = _count(scan)
    if scan.intact:
        return counted
    out = out or path.with_name(f"{path.stem}.recovered.mcap")
    try:
        sink = Sink(out)
    except OSError as error:
        raise BadInput.single("--out", "", f"{out}: {error.strerror}") from error
    _copy(Scan(path), sink)
    if sink.problem:
        out.unlink()
        raise BadInput.single("--out", "", f"{out}: {sink.problem}")
    return Recovered(out, counted.messages, counted.lost_chunks, counted.length_s)


def _count(scan: Scan) -> Recovered:
    times = [record.log_time for record in scan.records() if isinstance(record, Message)]
    length_s = (max(times) - min(times)) * 1e-9 if times else 0.0
    return Recovered(None, len(times), scan.lost_chunks, length_s)


def _copy(scan: Scan, sink: Sink) -> None:
    copier = _Copier(Writer(cast(IO[bytes], sink), compression=CompressionType.ZSTD))
    for record in scan.records():
        copier.take(record)
    copier.finish()
    sink.close()


class _Copier:
    """Writes records anew; schemas and channels get the numbers of the new file."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._schemas: dict[int, int] = {0: 0}
        self._channels: dict[int, int] = {}
        writer.start("hil", "hil recover")

    def take(self, record: McapRecord) -> None:
        writer = self._writer
        match record:
            case Schema():
                if record.id not in self._schemas:
                    self._schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            case Channel():
                if record.id not in self._channels:
                    schema = self._schemas.get(record.schema_id, 0)
                    self._channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schema, record.metadata
                    )
            case Message():
                if record.channel_id in self._channels:
                    channel = self._channels[record.channel_id]
                    writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
            case _:
                pass

    def finish(self) -> None:
        self._writer.finish()
