"""Datagrams of the reflective memory: transcripts, every fault by its name, and floods of nonsense."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from hil.core.gnc_records import GNC_OUTPUT
from hil.frmn import wire
from hil.frmn.mailboxes import BY_NUMBER, MAILBOXES, Role, layout_of
from hil.frmn.wire import DatagramKind, Fault

OUTPUT = MAILBOXES["gnc.output"]


def output(cycle: int) -> bytes:
    record = np.zeros(1, GNC_OUTPUT)
    record["cycle"] = cycle
    return wire.pack(DatagramKind.CELL, record.tobytes(), 7, 1, 2.5, OUTPUT)


def changed(datagram: bytes, offset: int, replacement: bytes) -> bytes:
    """Return ``datagram`` with other bytes at ``offset``, and the checksum that belongs to them."""
    made = bytearray(datagram)
    made[offset : offset + len(replacement)] = replacement
    made[4:8] = struct.pack("<I", zlib.crc32(made[8:]))
    return bytes(made)


def test_datagram_is_as_documented() -> None:
    datagram = wire.pack(DatagramKind.HEARTBEAT, wire.heartbeat_payload(1.0, 2.0), 0x01020304, 5, 0.5)
    assert datagram.hex(" ", 4) == (
        "46524d4e 54200001 02030000 10000000 04030201 05000000 00000000 0000e03f 00000000 0000f03f 00000000 00000040"
    )
    assert struct.unpack_from("<I", datagram, 4)[0] == zlib.crc32(datagram[8:])


def test_header_comes_back_and_the_payload_follows_it() -> None:
    datagram = output(42)
    header = wire.unpack(datagram)
    assert header == wire.DatagramHeader(DatagramKind.CELL, OUTPUT, 7, 1, 2.5)
    assert np.frombuffer(datagram[32:], GNC_OUTPUT)["cycle"][0] == 42


def test_every_cell_fits_an_ethernet_frame_and_has_a_number_of_its_own() -> None:
    assert len(BY_NUMBER) == len(MAILBOXES)
    assert all(wire.HEADER.size + kind.dtype.itemsize <= wire.LARGEST for kind in MAILBOXES.values())
    assert max(wire.HEADER.size + kind.dtype.itemsize for kind in MAILBOXES.values()) == wire.LARGEST


@pytest.mark.parametrize(
    ("datagram", "fault"),
    [
        (b"", Fault.FOREIGN),
        (output(1)[:31], Fault.FOREIGN),
        (b"HTTP" + output(1)[4:], Fault.FOREIGN),
        (changed(output(1), 8, b"\x01"), Fault.VERSION),
        (output(1)[:-1], Fault.CORRUPT),
        (output(1) + b"\0", Fault.CORRUPT),
        (output(1)[:100] + b"\x55" + output(1)[101:], Fault.CORRUPT),
        (changed(output(1), 9, b"\x09"), Fault.KIND),
        (changed(output(1), 10, b"\x63\0"), Fault.CELL),
        (changed(output(1), 12, b"\0\0"), Fault.SIZE),
        (changed(output(1) + b"\0" * 8, 12, struct.pack("<H", 248)), Fault.SIZE),
        (changed(output(1), 14, b"\x01\0"), Fault.LAYOUT),
        (changed(wire.pack(DatagramKind.HELLO, b"", 1, 1, 0.0), 9, b"\x01"), Fault.SIZE),
    ],
)
def test_each_fault_has_its_name(datagram: bytes, fault: Fault) -> None:
    assert wire.unpack(datagram) is fault


def test_layout_that_is_not_given_is_not_checked() -> None:
    assert isinstance(wire.unpack(changed(output(1), 14, b"\0\0")), wire.DatagramHeader)


def test_layout_distinguishes_other_fields_of_the_same_size_and_not_other_names() -> None:
    ours = np.dtype([("a", "f8", 2), ("b", "i4", 2)])
    assert layout_of(ours) == layout_of(np.dtype([("x", "f8", 2), ("y", "i4", 2)]))
    assert layout_of(ours) != layout_of(np.dtype([("a", "f8", 2), ("b", "f4", 2)]))
    assert layout_of(ours) != layout_of(np.dtype([("b", "i4", 2), ("a", "f8", 2)]))
    expanded = np.dtype([("a1", "f8", 2), ("b1", "i4", 2), ("a2", "f8", 2), ("b2", "i4", 2)])
    assert layout_of(np.dtype([("both", ours, 2)])) == layout_of(expanded)


def test_hello_comes_back() -> None:
    payload = wire.hello_payload(Role.GNC, "mine", ["gnc.output"], ["gnc.setup", "gnc.input"])
    hello = wire.read_hello(payload)
    assert hello == wire.Hello(2, "mine", frozenset({"gnc.output"}), frozenset({"gnc.setup", "gnc.input"}))


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("count", 17, "17 mailboxes in its hello, allowed 0 to 16"),
        ("count", -1, "-1 mailboxes in its hello"),
        ("number", 99, "mailbox 99, use 1: known are 1, 2, 3"),
        ("use", 3, "mailbox 3, use 3: known are"),
        ("size", 200, "mailbox gnc.output has 200 bytes there and 280 here"),
        ("layout", 1, "mailbox gnc.output has a different layout there"),
    ],
)
def test_hello_with_other_mailboxes_gives_the_reason(field: str, value: int, said: str) -> None:
    record = np.frombuffer(wire.hello_payload(Role.GNC, "mine", ["gnc.output"], []), wire.HELLO).copy()
    if field == "count":
        record["count"] = value
    else:
        record["cells"][field][0, 0] = value
    found = wire.read_hello(record.tobytes())
    assert isinstance(found, str)
    assert found.startswith(said)


def nonsense(rng: np.random.Generator, good: list[bytes]) -> bytes:
    """Return a good datagram with some of its bytes changed, cut, or grown; now and then with a right checksum."""
    datagram = bytearray(good[rng.integers(len(good))])
    for _ in range(rng.integers(0, 4)):
        datagram[rng.integers(len(datagram))] = rng.integers(256)
    if rng.random() < 0.1:
        datagram = datagram[: rng.integers(len(datagram))]
    elif rng.random() < 0.1:
        datagram += rng.bytes(rng.integers(1, 40))
    if rng.random() < 0.7 and len(datagram) >= 8:
        datagram[4:8] = struct.pack("<I", zlib.crc32(datagram[8:]))
    return bytes(datagram)


def good_ones() -> list[bytes]:
    """Return a datagram of each kind and cell."""
    hello = wire.hello_payload(Role.GNC, "mine", ["gnc.output"], ["gnc.input"])
    return [
        wire.pack(DatagramKind.HELLO, hello, 1, 1, 0.0),
        wire.pack(DatagramKind.HEARTBEAT, wire.heartbeat_payload(1.0, 2.0), 1, 1, 0.0),
        wire.pack(DatagramKind.GOODBYE, wire.text_payload(0, "over"), 1, 1, 0.0),
        wire.pack(DatagramKind.REFUSED, wire.text_payload(1, "no"), 1, 1, 0.0),
        *(wire.pack(DatagramKind.CELL, bytes(kind.dtype.itemsize), 1, 1, 0.0, kind) for kind in MAILBOXES.values()),
    ]


def test_nonsense_is_refused_or_read_and_nothing_else(rng: np.random.Generator) -> None:
    good, found = good_ones(), set()
    for _ in range(5000):
        datagram = nonsense(rng, good)
        header = wire.unpack(datagram)
        found.add(header if isinstance(header, Fault) else header.kind)
        if not isinstance(header, Fault) and header.kind is DatagramKind.HELLO:
            wire.read_hello(datagram[32:])
        if not isinstance(header, Fault) and header.kind in (DatagramKind.GOODBYE, DatagramKind.REFUSED):
            assert wire.read_text(datagram[32:])[1].isprintable()
    assert found == {*Fault, *DatagramKind}
