"""Authentication of the link: nothing of a stranger, and nothing recorded, starts or flies a bench."""

from __future__ import annotations

import hashlib
import hmac
import os
import random
import socket
import stat
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.core.gnc_records import GNC_OUTPUT
from hil.errors import BadInput
from hil.frmn import wire
from hil.frmn.mailboxes import MAILBOXES, Role
from hil.frmn.wire import DatagramKind
from hil.parts.links.authentication import TAG_BYTES, link_key, tag_of, users_key_file
from hil.parts.links.link import Link

LOCAL = ("127.0.0.1", 0)
KEY = b"k" * 32
STRANGER = 99


@pytest.fixture
def bench() -> Iterator[Link]:
    link = Link(Role.DSS, "bench", ("gnc.setup", "gnc.input"), ("gnc.output",), LOCAL, None, KEY)
    yield link
    link.close()


@pytest.fixture
def stranger() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.setblocking(False)
        yield made


def hello() -> bytes:
    return wire.pack(DatagramKind.HELLO, wire.hello_payload(Role.GNC, "x", ("gnc.output",), ()), STRANGER, 1, 0.0)


def output(sequence: int = 1) -> bytes:
    record = np.zeros(1, GNC_OUTPUT)
    record["cycle"] = -1
    return wire.pack(DatagramKind.CELL, record.tobytes(), STRANGER, sequence, 0.0, MAILBOXES["gnc.output"])


def sealed(datagram: bytes, key: bytes, receiver: int = 0) -> bytes:
    return datagram + tag_of(key, datagram, receiver)


def until_empty(link: Link) -> list[str]:
    """Return the names of the mailboxes that arrive within 50 ms."""
    end_s, names = time.monotonic() + 0.05, []
    while time.monotonic() < end_s:
        names += [arrival.name for arrival in link.poll()]
    return names


def test_tag_is_as_documented() -> None:
    datagram = output()
    expected = hmac.new(KEY, struct.pack("<I", 7) + datagram, hashlib.sha256).digest()[:16]
    assert tag_of(KEY, datagram, 7) == expected
    assert tag_of(KEY, hello(), 7) == tag_of(KEY, hello(), 0)
    assert tag_of(KEY, datagram, 7) != tag_of(KEY, datagram, 0)


def test_stranger_without_the_key_is_no_peer(bench: Link, stranger: socket.socket) -> None:
    for datagram in (hello(), sealed(hello(), b"another key of 32 bytes or so..."), hello() + bytes(TAG_BYTES)):
        stranger.sendto(datagram, bench.address)
    assert until_empty(bench) == []
    assert bench.peer is None
    assert bench.counters()["unauthenticated"] == 3
    sender = f"127.0.0.1:{stranger.getsockname()[1]}"
    assert bench.complaints == [f"{sender} sends datagrams that are not of the key of this link"]


def test_recorded_exchange_cannot_be_repeated(bench: Link, stranger: socket.socket) -> None:
    stranger.sendto(sealed(hello(), KEY), bench.address)  # recorded: it is received, and sets nothing up
    stranger.sendto(sealed(output(), KEY, bench._writer ^ 1), bench.address)  # to a bench of an earlier start
    stranger.sendto(sealed(output(), KEY), bench.address)
    assert until_empty(bench) == []
    stranger.sendto(sealed(output(), KEY, bench._writer), bench.address)
    assert until_empty(bench) == ["gnc.output"]


def test_two_sides_with_one_key_exchange_mailboxes_and_with_two_keys_none(bench: Link) -> None:
    for key, joins in ((KEY, True), (b"o" * 32, False)):
        gnc = Link(Role.GNC, "gnc", ("gnc.output",), ("gnc.setup",), None, bench.address, key)
        end_s = time.monotonic() + 0.3
        got = []
        while time.monotonic() < end_s:
            for side in (gnc, bench):
                side.service()
            bench.poll()
            bench.send("gnc.setup", np.zeros(1, MAILBOXES["gnc.setup"].dtype))
            got += gnc.poll()
        assert bool(got) is joins
        gnc.close()
        until_empty(bench)
        bench.peer = None


def test_strangers_can_neither_fill_the_buffer_of_the_other_side_nor_end_the_wait_for_it(
    bench: Link, stranger: socket.socket
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gnc:
        gnc.sendto(sealed(hello(), KEY), bench.address)
        assert until_empty(bench) == []
        for _ in range(5000):  # several times the buffer of a socket
            stranger.sendto(bytes(1000), bench.address)
        began_s = time.monotonic()
        assert not bench.wait(0.05)
        assert time.monotonic() - began_s >= 0.05
        gnc.sendto(sealed(output(), KEY, bench._writer), bench.address)
        assert bench.wait(1.0)
        assert [arrival.name for arrival in bench.poll()] == ["gnc.output"]


def test_port_of_a_connected_link_is_taken_also_for_programs_of_the_same_user(bench: Link) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gnc,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as thief,
    ):
        gnc.sendto(sealed(hello(), KEY), bench.address)
        assert until_empty(bench) == []
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        thief.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with pytest.raises(OSError, match="in use"):
            thief.bind(bench.address)


@pytest.mark.parametrize("count", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_burst_of_unauthenticated_datagrams_delays_a_reply_by_less_than_a_cycle(
    bench: Link, stranger: socket.socket, count: int
) -> None:
    dice = random.Random(3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gnc:
        gnc.sendto(sealed(hello(), KEY), bench.address)
        assert until_empty(bench) == []
        good = sealed(output(), KEY, bench._writer)
        worst_s = 0.0
        for sequence in range(1, count // 267 + 1):
            for _ in range(267):
                odd = bytearray(good)
                odd[dice.randrange(len(odd))] ^= 1 << dice.randrange(8)
                stranger.sendto(bytes(odd[: dice.choice((8, 40, len(odd)))]), bench.address)
            gnc.sendto(sealed(output(sequence), KEY, bench._writer), bench.address)
            polls, names = 0, []
            while not names and polls < 8:
                began_s = time.thread_time()
                names = [arrival.name for arrival in bench.poll()]
                worst_s = max(worst_s, time.thread_time() - began_s)
                polls += 1
            assert names == ["gnc.output"]
        assert worst_s < 0.02


def test_users_key_is_made_once_and_is_for_its_owner(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    made = link_key()
    assert link_key() == made
    assert len(made) == 64
    assert stat.S_IMODE(users_key_file().stat().st_mode) == 0o600
    assert os.listdir(users_key_file().parent) == ["gnc-link.key"]
    users_key_file().chmod(0o644)
    with pytest.raises(BadInput, match="readable by other users, mode 644: chmod 600"):
        link_key()


def test_key_that_is_short_or_missing_is_refused(tmp_path: Path) -> None:
    short = tmp_path / "key"
    short.write_text("12345\n")
    short.chmod(0o600)
    with pytest.raises(BadInput, match="5 characters, at least 16"):
        link_key(str(short))
    with pytest.raises(BadInput, match="cannot be read"):
        link_key(str(tmp_path / "none"))
