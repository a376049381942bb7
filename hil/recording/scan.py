"""Sequential scan of an MCAP file: all that the standard allows, within bounds of memory, and what cannot be read.

``unsupported``: a block in a compression or of a size that this program does not read. ``damaged``: bytes that
contradict a checksum, the index or the standard. Not ``ended``: the file was cut. ``rewritten``: by another program,
which may have kept the whole content.
"""

from __future__ import annotations

import os
import struct
import zlib
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import IO, Final

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from hil.core.files import MIB, check_regular
from hil.errors import BadInput
from hil.recording import lz4_frame

OWN_LIBRARY: Final = "hil "
"""Beginning of the library in the header of a file that this program has written."""

_BROKEN: Final = (
    McapError,
    ValueError,
    LookupError,
    struct.error,
    EOFError,
    zstandard.ZstdError,
    RuntimeError,  # of lz4
    MemoryError,
    OverflowError,
)
"""Exceptions for invalid bytes."""
_MAGIC: Final = b"\x89MCAP0\r\n"
_HEAD, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
_FOOTER_BYTES: Final = _HEAD.size + 20
_FILE_BYTES_MAX: Final = 1 << 40
_RECORD_BYTES_MAX: Final = 64 * MIB
_BLOCK_BYTES_MAX: Final = 256 * MIB
"""Longest block, packed and unpacked; this program closes its own after 1 MiB, images make them longer."""
_WINDOW_BYTES_MAX: Final = 128 * MIB  # of zstd, at its highest level
_UNPACKED_FREE: Final = 8 * MIB
_UNPACKED_RATIO: Final = 50  # of a file's blocks together, beyond _UNPACKED_FREE; recorded cycles have 3 to 10
_PRIVATE: Final = 0x80  # first type of the records that programs may add, which readers skip
_INDEXED: Final = {
    ChunkIndex: Opcode.CHUNK,
    AttachmentIndex: Opcode.ATTACHMENT,
    MetadataIndex: Opcode.METADATA,
}
_READERS: Final = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
    Opcode.DATA_END: DataEnd.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}


class UnsupportedBlock(Exception):
    """A block that this program does not read; the text gives the reason."""


@dataclass
class Index:
    """End of a file. data_end: where its data end. opcodes: of indexed records by their positions.

    whole: the summary was read and has no error.
    """

    data_end: int
    opcodes: dict[int, int] = field(default_factory=dict)
    statistics: Statistics | None = None
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    whole: bool = False

    @property
    def has_channels(self) -> bool:
        """Return whether it has all channels of the file, with their schemas."""
        stated = self.statistics
        return (
            self.whole
            and stated is not None
            and (len(self.channels), len(self.schemas)) == (stated.channel_count, stated.schema_count)
        )


@dataclass
class Scan:
    """Scan of the file at ``path``; the other fields are those of the last one, complete after ``records``."""

    path: Path
    damaged: int = 0
    """Damaged blocks, records and places, which are skipped."""
    unsupported: str = ""
    """Reason why blocks are not read, "" if there are none."""
    ended: bool = False
    """The file has its end."""
    library: str = ""
    """Program that has written the file."""
    messages: int = 0
    positions: dict[str, int] = field(default_factory=dict)
    """Position in the file of each metadata record by its name."""
    index: Index | None = None
    _unpacked: int = 0

    @property
    def intact(self) -> bool:
        return self.ended and not self.damaged and not self.unsupported

    @property
    def problem(self) -> str:
        """Return what of the file is not read, and why; "" for an intact one."""
        stated = self.index.statistics if self.index is not None else None
        of = f" of {stated.message_count}" if stated is not None else ""
        rest = f"{self.messages}{of} messages are read"
        if self.unsupported:
            return f"not supported: {self.unsupported}: {rest}"
        if self.damaged:
            places = "1 place" if self.damaged == 1 else f"{self.damaged} places"
            return f"damaged in {places}{'' if self.ended else ', and cut'}: {rest}"
        return "" if self.ended else f"cut: it has no end, the recorder was killed or the file shortened: {rest}"

    def records(self) -> Iterator[McapRecord]:
        """Yield schemas, channels, messages, attachments and metadata. Raises BadInput if the file is not MCAP."""
        check_regular(self.path, _FILE_BYTES_MAX)
        self.damaged, self.unsupported, self.ended, self.messages, self._unpacked = 0, "", False, 0, 0
        try:
            with self.path.open("rb") as file:
                if file.read(len(_MAGIC)) != _MAGIC:
                    text = "not a recording: it does not start like an MCAP file"
                    raise BadInput.single(str(self.path), "", text)
                self.index = _index_of(file)
                yield from self._records(file)
        except OSError as error:
            raise BadInput.single(str(self.path), "", f"cannot be read: {error.strerror}") from error

    def _records(self, file: IO[bytes]) -> Iterator[McapRecord]:
        size = os.fstat(file.fileno()).st_size
        end = size if self.index is None else self.index.data_end
        known = [] if self.index is None else sorted(self.index.opcodes)
        at = checksum_to = len(_MAGIC)
        checksum = zlib.crc32(_MAGIC)
        counts = {Opcode.ATTACHMENT: 0, Opcode.METADATA: 0}
        file.seek(at)
        while at < end:
            head = file.read(_HEAD.size)
            opcode, length = _HEAD.unpack(head) if len(head) == _HEAD.size else (0, size)
            place = bisect_right(known, at)
            limit = known[place] if place < len(known) else end
            expected = None if self.index is None else self.index.opcodes.get(at)
            if at + _HEAD.size + length > limit or expected not in (None, opcode):
                if self.index is None and limit == size:
                    break  # in the middle of a record
                self.damaged += 1
                at = limit
                file.seek(at)
                continue
            too_long = length > (_BLOCK_BYTES_MAX if opcode == Opcode.CHUNK else _RECORD_BYTES_MAX)
            if too_long:
                self.unsupported = f"a record of {length} bytes"
                at += _HEAD.size + length
                file.seek(at)
                continue
            content = file.read(length)
            if opcode == Opcode.DATA_END:
                stated = int.from_bytes(content, "little")
                if checksum_to == at and stated not in (0, checksum) and not self.damaged:
                    self.damaged += 1
                break
            if checksum_to == at:
                checksum = zlib.crc32(content, zlib.crc32(head, checksum))
                checksum_to += len(head) + len(content)
            before = self.damaged
            for record in self._parsed(opcode, content):
                if isinstance(record, Metadata):
                    self.positions[record.name] = at
                yield record
            if opcode in counts and self.damaged == before:
                counts[Opcode(opcode)] += 1
            at += _HEAD.size + length
        self.ended = self.index is not None
        self._compare(counts)

    def _compare(self, counts: dict[Opcode, int]) -> None:
        """Count a damage if the file has not all that its statistics state."""
        stated = self.index.statistics if self.index is not None else None
        if stated is None or self.damaged or self.unsupported:
            return
        actual = (self.messages, counts[Opcode.ATTACHMENT], counts[Opcode.METADATA])
        if actual != (stated.message_count, stated.attachment_count, stated.metadata_count):
            self.damaged += 1

    def _parsed(self, opcode: int, content: bytes) -> list[McapRecord]:
        """Return what a record holds; nothing, and the reason in this scan, if it cannot be read."""
        try:
            if opcode == Opcode.CHUNK:
                records = records_of(self._unpack(_parse(opcode, content)))
                self.messages += sum(isinstance(record, Message) for record in records)
                return records
            if opcode == Opcode.MESSAGE:
                self.messages += 1
                return [_message(content, 0, len(content))]
            if opcode == Opcode.ATTACHMENT:
                return [_attachment(content)]
            if opcode == Opcode.MESSAGE_INDEX:
                _check_message_index(content)
                return []
            if opcode >= _PRIVATE:
                return []
            if opcode not in _READERS:
                raise UnsupportedBlock(f"a record of the unknown type {opcode}")
            record = _parse(opcode, content)
            if isinstance(record, Header):
                self.library = record.library
            return [record] if isinstance(record, (Schema, Channel, Metadata)) else []
        except UnsupportedBlock as reason:
            self.unsupported = str(reason)
        except _BROKEN:
            self.damaged += 1
        return []

    def _unpack(self, record: McapRecord) -> bytes:
        """Return the content of a block; raise UnsupportedBlock, or ValueError for what it should not be."""
        assert isinstance(record, Chunk)
        size = record.uncompressed_size
        if record.compression not in ("", "zstd", "lz4"):
            raise UnsupportedBlock(f"blocks compressed by {record.compression[:20]!r}, only by zstd, lz4 or not at all")
        if size > _BLOCK_BYTES_MAX:
            raise UnsupportedBlock(f"a block of {size} bytes unpacked, allowed {_BLOCK_BYTES_MAX}")
        self._unpacked += size
        if self._unpacked > _UNPACKED_FREE + _UNPACKED_RATIO * self.path.stat().st_size:
            raise UnsupportedBlock(f"blocks that unpack to more than {_UNPACKED_RATIO} times the file")
        data = record.data
        if record.compression == "zstd":
            stated = zstandard.frame_content_size(data)  # allocated at once, whatever the limit is
            if stated not in (-1, size):
                raise ValueError(f"{stated} bytes, the block has {size}")
            unpacker = zstandard.ZstdDecompressor(max_window_size=_WINDOW_BYTES_MAX)
            data = unpacker.decompress(data, max_output_size=max(1, size))
        elif record.compression == "lz4":
            data = lz4_frame.unpacked(data, size, record.uncompressed_crc != 0)
        if len(data) != size or record.uncompressed_crc not in (0, zlib.crc32(data)):
            raise ValueError("checksum")
        return data


def records_of(data: bytes) -> list[McapRecord]:
    """Return the records in the content of a block. Raises one of _BROKEN."""
    records: list[McapRecord] = []
    at, end = 0, len(data)
    while at < end:
        opcode, length = _HEAD.unpack_from(data, at)
        start, at = at + _HEAD.size, at + _HEAD.size + length
        if at > end:
            raise EOFError
        if opcode == Opcode.MESSAGE:
            records.append(_message(data, start, at))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            records.append(_parse(opcode, data[start:at]))
    return records


def _message(data: bytes, start: int, end: int) -> Message:
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(data, start)
    content = data[start + _MESSAGE.size : end]
    return Message(channel, log_time=log_time, data=content, publish_time=publish_time, sequence=sequence)


def _parse(opcode: int, content: bytes) -> McapRecord:
    """Return the record with ``content``. Raises one of _BROKEN."""
    record: McapRecord = _READERS[Opcode(opcode)](ReadDataStream(BytesIO(content)))
    return record


def _attachment(content: bytes) -> Attachment:
    checksum = int.from_bytes(content[-4:], "little")
    if checksum not in (0, zlib.crc32(content[:-4])):
        raise ValueError("checksum")
    attachment: Attachment = Attachment.read(ReadDataStream(BytesIO(content)))
    return attachment


def _check_message_index(content: bytes) -> None:
    (size,) = struct.unpack_from("<I", content, 2)
    if size != len(content) - 6 or size % 16:
        raise ValueError("not an index")


def _index_of(file: IO[bytes]) -> Index | None:
    """Return the end of a file, None if it has none."""
    size = file.seek(0, os.SEEK_END)
    if size < 2 * len(_MAGIC) + _FOOTER_BYTES:
        return None
    footer_at = size - len(_MAGIC) - _FOOTER_BYTES
    file.seek(footer_at)
    footer, magic = file.read(_FOOTER_BYTES), file.read(len(_MAGIC))
    if _HEAD.unpack_from(footer) != (Opcode.FOOTER, 20):
        return None
    stated = Footer.read(ReadDataStream(BytesIO(footer[_HEAD.size :])))
    start = stated.summary_start
    if start == 0:
        return Index(footer_at) if magic == _MAGIC else None
    if not len(_MAGIC) <= start <= footer_at or footer_at - start > _BLOCK_BYTES_MAX:
        return Index(footer_at)
    file.seek(start)
    summary = file.read(footer_at - start)
    if stated.summary_crc not in (0, zlib.crc32(footer[:-4], zlib.crc32(summary))):
        return Index(footer_at)
    index = Index(start)
    try:
        _read_summary(index, summary)
    except _BROKEN:
        return Index(footer_at)
    return index


def _read_summary(index: Index, summary: bytes) -> None:
    """Enter the records of ``summary`` into ``index``. Raises one of _BROKEN."""
    at = 0
    while at < len(summary):
        opcode, length = _HEAD.unpack_from(summary, at)
        content = summary[at + _HEAD.size : at + _HEAD.size + length]
        at += _HEAD.size + length
        if opcode not in _READERS:
            continue
        record = _parse(opcode, content)
        match record:
            case Schema():
                index.schemas[record.id] = record
            case Channel():
                index.channels[record.id] = record
            case Statistics():
                index.statistics = record
            case ChunkIndex():
                index.opcodes[record.chunk_start_offset] = Opcode.CHUNK
            case AttachmentIndex() | MetadataIndex():
                index.opcodes[record.offset] = _INDEXED[type(record)]
            case _:
                pass
    index.whole = True
