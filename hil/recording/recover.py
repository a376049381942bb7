"""Recovery of a recording that broke off: copies its readable part into a new file with an end and an index."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import IO, cast

from mcap.records import Attachment, Message, Metadata
from mcap.writer import CompressionType, Writer

from hil.errors import BadInput
from hil.recording.read import directory
from hil.recording.scan import Scan
from hil.recording.writer import BlockFile


@dataclass(frozen=True)
class Recovered:
    """Result of a recovery. out: the new file, None if the old one is intact. length_s: first to last message.

    problem: what of the old file is not in it, and why. damaged: places of it, without a cut end.
    """

    out: Path | None
    messages: int
    problem: str
    length_s: float
    damaged: int = 0


def recover(path: Path, out: Path | None = None) -> Recovered:
    """Write the intact part of the file at ``path`` to ``out``, by default ``NAME.recovered.mcap`` next to it.

    The file itself is not changed; an intact one is only counted. Raises BadInput if it is not an MCAP file, or
    ``out`` exists or cannot be written.
    """
    scan = Scan(path)
    counted = _count(scan)
    if scan.intact:
        return counted
    if scan.unsupported:
        raise BadInput.single(str(path), "", scan.problem)
    out = out or path.with_name(f"{path.stem}.recovered.mcap")
    try:
        file = BlockFile(out)
    except OSError as error:
        raise BadInput.single("--out", "", f"{out}: {error.strerror}") from error
    _copy(path, file)
    if file.problem:
        out.unlink()
        raise BadInput.single("--out", "", f"{out}: {file.problem}")
    return Recovered(out, counted.messages, counted.problem, counted.length_s, counted.damaged)


def _count(scan: Scan) -> Recovered:
    times = [record.log_time for record in scan.records() if isinstance(record, Message)]
    length_s = (max(times) - min(times)) * 1e-9 if times else 0.0
    return Recovered(None, len(times), scan.problem, length_s, scan.damaged)


def _copy(path: Path, file: BlockFile) -> None:
    writer = Writer(cast(IO[bytes], file), compression=CompressionType.ZSTD)
    writer.start("hil", "hil recover")
    channels = _register(path, writer)
    for record in Scan(path).records():
        match record:
            case Message() if record.channel_id in channels:
                channel = channels[record.channel_id]
                writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
            case Attachment():
                writer.add_attachment(record.create_time, record.log_time, record.name, record.media_type, record.data)
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
            case _:
                pass
    writer.finish()
    file.close()


def _register(path: Path, writer: Writer) -> dict[int, int]:
    """Register schemas and channels of the old file in ``writer``; return old -> new number of each channel."""
    schemas, channels = directory(path)
    numbers = {0: 0}
    for number, schema in schemas.items():
        numbers[number] = writer.register_schema(schema.name, schema.encoding, schema.data)
    return {
        number: writer.register_channel(
            channel.topic, channel.message_encoding, numbers.get(channel.schema_id, 0), channel.metadata
        )
        for number, channel in channels.items()
    }
