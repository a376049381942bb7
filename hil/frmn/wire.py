"""Codec of the reflective memory's datagrams between hosts, without I/O (docs/reference/wire-formats.md).

Every datagram is a header of 32 bytes and a payload, little-endian, and fits into one Ethernet frame:

    offset  type  field
         0  4s    magic     "FRMN"
         4  u4    crc       CRC-32 (zlib's) of all bytes from offset 8 to the end
         8  u1    version   of the protocol, 2
         9  u1    kind      1 hello, 2 cell, 3 heartbeat, 4 ``goodbye``, 5 refused
        10  u2    cell      number of the mailbox; 0 in other kinds
        12  u2    size      of the payload, bytes
        14  u2    layout    digest of the mailbox's layout; 0: not given
        16  u4    writer    any number that differs at each start of a program
        20  u4    sequence  counts this writer's datagrams of this kind and mailbox, from 1 on
        24  f8    time_s    time of sending by the writer's own clock
        32        payload

On the wire a tag follows (``hil.parts.links.authentication``).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import Final, NamedTuple

import numpy as np

from hil.frmn.mailboxes import BY_NUMBER, MAILBOXES, MailboxSpec, Role

MAGIC: Final = b"FRMN"
VERSION: Final = 2
"""Incremented when header, handshake or a payload changes; the layouts of mailboxes have digests instead."""
VERSION_AT: Final = 8  # offset
HEADER: Final = struct.Struct("<4sIBBHHHIId")
LARGEST: Final = 1472
"""Bytes of the largest datagram that fits into one Ethernet frame."""
PORT: Final = 24500
"""Default port of ``hil dss``."""
_PROTECTED: Final = 8  # the checksum covers what follows
_MAX_CELLS: Final = 16


class DatagramKind(IntEnum):
    """Kind of a datagram."""

    HELLO = 1
    CELL = 2
    HEARTBEAT = 3
    GOODBYE = 4
    REFUSED = 5


class Fault(Enum):
    """Why a datagram is rejected; the value is the name of its counter."""

    FOREIGN = "foreign"  # too short, or another magic: not of this protocol
    VERSION = "other_version"
    CORRUPT = "corrupt"  # checksum
    SIZE = "wrong_size"  # not as in its header, or not that of its kind or mailbox
    LAYOUT = "wrong_layout"
    KIND = "unknown_kind"
    CELL = "unknown_cell"


HELLO: Final = np.dtype(
    [
        ("role", "<i4"),  # 1 DSS, 2 GNC
        ("count", "<i4"),  # of the mailboxes below
        ("name", "S32"),  # of the program, for messages
        ("cells", np.dtype([("number", "<u2"), ("size", "<u2"), ("layout", "<u2"), ("use", "<u2")]), _MAX_CELLS),
    ],
    align=True,
)
"""Identity of a side and its mailboxes. use: 1 offers (writes it), 2 wants (reads it). layout 0: not given."""
OFFERS: Final = 1
WANTS: Final = 2

HEARTBEAT: Final = np.dtype([("peer_time_s", "<f8"), ("peer_received_s", "<f8")])
"""The other side's newest heartbeat: its ``time_s``, and its arrival by this side's clock; NaN before the first.

With the header's ``time_s`` and the time of arrival these are NTP's four stamps."""

TEXT: Final = np.dtype([("code", "<i4"), ("text", "S124")])
"""Payload of ``GOODBYE`` and ``REFUSED``. code: Refusal, 0 in ``GOODBYE``."""


class Refusal(IntEnum):
    """Why a side rejects the other."""

    VERSION = 1
    MAILBOXES = 2  # size or layout of a mailbox, or a required one is not offered
    WRITER = 3  # another side writes these mailboxes; retry when it has gone
    SENDER = 4  # another address was expected


class DatagramHeader(NamedTuple):
    """Content of a valid header; ``cell`` is None in other kinds than CELL."""

    kind: DatagramKind
    cell: MailboxSpec | None
    writer: int
    sequence: int
    time_s: float


@dataclass(frozen=True)
class Hello:
    """Content of HELLO. offers, wants: names of mailboxes."""

    role: int
    name: str
    offers: frozenset[str]
    wants: frozenset[str]


_SIZES: Final = {
    DatagramKind.HELLO: HELLO.itemsize,
    DatagramKind.HEARTBEAT: HEARTBEAT.itemsize,
    DatagramKind.GOODBYE: TEXT.itemsize,
    DatagramKind.REFUSED: TEXT.itemsize,
}


def pack(
    kind: DatagramKind,
    payload: bytes | memoryview,
    writer: int,
    sequence: int,
    time_s: float,
    cell: MailboxSpec | None = None,
) -> bytes:
    """Return the datagram; sequence is taken modulo 2^32."""
    number, layout = (cell.number, cell.layout) if cell is not None else (0, 0)
    datagram = bytearray(HEADER.size + len(payload))
    HEADER.pack_into(
        datagram, 0, MAGIC, 0, VERSION, kind, number, len(payload), layout, writer, sequence & 0xFFFF_FFFF, time_s
    )
    datagram[HEADER.size :] = payload
    struct.pack_into("<I", datagram, 4, zlib.crc32(memoryview(datagram)[_PROTECTED:]))
    return bytes(datagram)


def unpack(datagram: bytes) -> DatagramHeader | Fault:
    """Return the header of a valid datagram, whose payload is ``datagram[HEADER.size:]``, else the fault.

    Accepts any bytes.
    """
    if len(datagram) < HEADER.size or datagram[:4] != MAGIC:
        return Fault.FOREIGN
    _, crc, version, kind_number, number, size, layout, writer, sequence, time_s = HEADER.unpack_from(datagram)
    if version != VERSION:
        return Fault.VERSION  # its checksum can be a different one
    if zlib.crc32(memoryview(datagram)[_PROTECTED:]) != crc:
        return Fault.CORRUPT
    if kind_number == DatagramKind.CELL:
        cell = BY_NUMBER.get(number)
        if cell is None:
            return Fault.CELL
        if size != cell.dtype.itemsize or len(datagram) != HEADER.size + size:
            return Fault.SIZE
        if layout not in (0, cell.layout):
            return Fault.LAYOUT
        return DatagramHeader(DatagramKind.CELL, cell, writer, sequence, time_s)
    try:
        kind = DatagramKind(kind_number)
    except ValueError:
        return Fault.KIND
    if size != _SIZES[kind] or len(datagram) != HEADER.size + size:
        return Fault.SIZE
    return DatagramHeader(kind, None, writer, sequence, time_s)


def hello_payload(role: Role, name: str, offers: Iterable[str], wants: Iterable[str]) -> bytes:
    """Return the payload of HELLO; offers, wants: names of mailboxes."""
    record = np.zeros(1, HELLO)
    entries = [(cell, OFFERS) for cell in offers] + [(cell, WANTS) for cell in wants]
    record["role"], record["count"], record["name"] = role, len(entries), name.encode()[:32]
    for i, (cell, use) in enumerate(entries):
        kind = MAILBOXES[cell]
        record["cells"][0, i] = (kind.number, kind.dtype.itemsize, kind.layout, use)
    return record.tobytes()


def read_hello(payload: bytes) -> Hello | str:
    """Return the content of HELLO, or the reason why its mailboxes do not match."""
    record = np.frombuffer(payload, HELLO)[0]
    count = int(record["count"])
    if not 0 <= count <= _MAX_CELLS:
        return f"{count} mailboxes in its hello, allowed 0 to {_MAX_CELLS}"
    mailboxes: dict[int, set[str]] = {OFFERS: set(), WANTS: set()}
    for number, size, layout, use in record["cells"][:count].tolist():
        kind = BY_NUMBER.get(number)
        if kind is None or use not in mailboxes:
            return (
                f"mailbox {number}, use {use}: known are {', '.join(map(str, BY_NUMBER))}, use 1 (offers) or 2 (wants)"
            )
        if size != kind.dtype.itemsize:
            return f"mailbox {kind.name} has {size} bytes there and {kind.dtype.itemsize} here"
        if layout not in (0, kind.layout):
            return f"mailbox {kind.name} has a different layout there"
        mailboxes[use].add(kind.name)
    name = _text(record["name"]) or "without a name"
    return Hello(int(record["role"]), name, frozenset(mailboxes[OFFERS]), frozenset(mailboxes[WANTS]))


def text_payload(code: int, text: str) -> bytes:
    """Return the payload of ``GOODBYE`` or ``REFUSED``; the text is truncated to 124 bytes."""
    record = np.zeros(1, TEXT)
    record["code"], record["text"] = code, text.encode()[:124]
    return record.tobytes()


def read_text(payload: bytes) -> tuple[int, str]:
    """Return code and text of ``GOODBYE`` or ``REFUSED``."""
    record = np.frombuffer(payload, TEXT)[0]
    return int(record["code"]), _text(record["text"])


def heartbeat_payload(peer_time_s: float, peer_received_s: float) -> bytes:
    """Return the payload of HEARTBEAT."""
    return struct.pack("<dd", peer_time_s, peer_received_s)


def read_heartbeat(payload: bytes) -> tuple[float, float]:
    """Return ``peer_time_s`` and ``peer_received_s``."""
    there_s, here_s = struct.unpack("<dd", payload)
    return there_s, here_s


def _text(raw: bytes) -> str:
    """Return ``raw`` as printable text."""
    text = raw.decode("utf-8", errors="replace")
    return "".join(c if c.isprintable() else "?" for c in text)
