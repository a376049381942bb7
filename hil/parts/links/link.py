"""One side of the reflective memory between two hosts: mailboxes over UDP to and from one other side.

Only ``wait`` blocks, and no received datagram raises: invalid ones are counted, and reported in a text once for each
cause and sender.
"""

from __future__ import annotations

import math
import secrets
import time
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hil.core.gnc_records import GNC_ORBIT, GNC_SETUP_2
from hil.core.observable import ObservableList
from hil.frmn import wire
from hil.frmn.gnc_input import mailboxes_of
from hil.frmn.mailboxes import MAILBOXES, Role
from hil.frmn.wire import DatagramHeader, DatagramKind, Fault, Refusal
from hil.parts.links.authentication import AuthenticatedSocket, link_key
from hil.parts.links.link_statistics import ClockOffset, DatagramStats
from hil.parts.links.udp import Address, address_towards, shown

_EVERY_S: Final = 0.1  # heartbeats, and hellos until the first answer
_POLL_MAX: Final = 64
_STRANGERS_MAX: Final = 4
_UNLIMITED: Final = 1 << 30
_DROPPING_S: Final = 2e-3
_REPORTED_MAX: Final = 64  # texts of causes; further ones are only counted
_REFUSE_EVERY_S: Final = 0.5  # to one address: limits amplification of a flood
_REFUSED_ADDRESSES: Final = 256
PORT_CLOSED: Final = "its port is closed"
"""Reason for a side whose program has ended without a ``goodbye``."""
_NAMES: Final = {Role.DSS: "dss", Role.GNC: "gnc"}


class Arrival(NamedTuple):
    """A received mailbox. record: (1,) of its dtype, read-only. received_s: by this host's monotonic clock."""

    name: str
    record: np.ndarray
    time_s: float
    received_s: float


@dataclass(slots=True)
class Peer:
    """The other side. last_rx_s: time of its last datagram, monotonic; hello: None if it sent none."""

    address: Address
    writer: int
    last_rx_s: float
    hello: wire.Hello | None = None
    gone: str | None = None
    """Text of its ``goodbye``."""


class Link:
    """This side, as ``role``, of a link that sends the mailboxes in ``offers`` and receives those in ``wants``.

    bind: address of this host to listen on; None: the one on the route to ``peer``. peer: the only address accepted
    as the other side; None: the first sender of a hello. key: of the link; None: the user's (``link_key``).
    """

    def __init__(
        self,
        role: Role,
        name: str,
        offers: Collection[str],
        wants: Collection[str],
        bind: Address | None = None,
        peer: Address | None = None,
        key: bytes | None = None,
    ) -> None:
        assert bind is not None or peer is not None
        self.role = role
        self.there = Role.GNC if role is Role.DSS else Role.DSS
        self._writer = secrets.randbits(32) or 1
        where, option = bind or address_towards(peer or ("", 0)), "--listen" if bind else "--dss"
        self._sealed = AuthenticatedSocket(where, option, link_key() if key is None else key, self._writer)
        self._socket = self._sealed.socket
        self.address = self._socket.address
        self.silent_max_s = 1.0
        """A side that has been silent for longer is gone, and another one can replace it."""
        self.peer: Peer | None = None
        self.joined = 0
        """Number of other sides that have joined so far."""
        self.refusal: tuple[int, str] | None = None
        """Last refusal by the other side: Refusal and its text."""
        self.complaints: ObservableList[str] = ObservableList()
        """Texts of what was rejected here, and why; each cause and sender once."""
        self.clock = ClockOffset()
        self.datagram_stats = {cell: DatagramStats() for cell in wants}
        self._offers, self._wants = tuple(offers), tuple(wants)
        self._only = peer
        if peer is not None:
            self._socket.connect(peer)
        self._hello = wire.hello_payload(role, name, offers, wants)
        self._sequences: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()
        self._reported: set[tuple[str, Address]] = set()
        self._refused_s: dict[Address, float] = {}
        self._beaten_s = -math.inf
        self._heartbeat = (math.nan, math.nan)  # newest one of the other side: its time and its arrival

    def alive(self, now_s: float) -> bool:
        """Return whether the other side has sent within ``silent_max_s``; now_s: monotonic."""
        return self.peer is not None and self.peer.gone is None and now_s - self.peer.last_rx_s <= self.silent_max_s

    @property
    def peer_wants(self) -> frozenset[str]:
        """Mailboxes that the other side has asked for in its hello."""
        hello = self.peer.hello if self.peer is not None else None
        return hello.wants if hello is not None else frozenset()

    @property
    def expects(self) -> bool:
        """Whether the address of the other side was given."""
        return self._only is not None

    def poll(self, at_most: int = _POLL_MAX) -> list[Arrival]:
        """Process the received datagrams; return the mailboxes in them in order of arrival, without outdated values.

        at_most: limit of authenticated datagrams per call; the others remain for the next call. Datagrams without a
        valid tag are dropped, for at most ``_DROPPING_S`` of wall-clock time per call. While the other side is alive,
        strangers are answered at ``_STRANGERS_MAX`` datagrams per call.
        """
        now_s = time.monotonic()
        arrivals: list[Arrival] = []
        # of strangers first: they have what the other side sent before it was connected to
        strangers = _STRANGERS_MAX if self.alive(now_s) else _UNLIMITED
        for from_peer, tries in ((False, strangers), (True, _UNLIMITED)):
            while at_most > 0 and tries > 0:
                received = self._sealed.receive(from_peer)
                if received is None:
                    break
                tries -= 1
                datagram, sender, received_s = received
                if datagram is None:
                    self._count("unauthenticated", sender, "sends datagrams that are not of the key of this link")
                    if time.monotonic() - now_s > _DROPPING_S:
                        break
                    continue
                at_most -= 1
                arrival = self.handle(datagram, sender, received_s)
                if arrival is not None:
                    arrivals.append(arrival)
        closed = self._socket.closed_ports()
        if self.peer is not None and self.peer.gone is None and self.peer.address in closed:
            self.peer.gone = PORT_CLOSED  # without a `goodbye`
        return arrivals

    def wait(self, timeout_s: float) -> bool:
        """Wait for a datagram, at most ``timeout_s``; return whether there is one. Strangers do not end it."""
        return self._socket.wait(timeout_s, self.alive(time.monotonic()))

    def service(self) -> None:
        """Send what is due: a heartbeat, or a hello before the first answer; to be called frequently."""
        now_s = time.monotonic()
        if now_s - self._beaten_s < _EVERY_S:
            return
        self._beaten_s = now_s
        if self.alive(now_s) or (self.peer is not None and self._only is None):
            self._send(DatagramKind.HEARTBEAT, wire.heartbeat_payload(*self._heartbeat))
        elif self._only is not None:
            self._send(DatagramKind.HELLO, self._hello, self._only)

    def send(self, cell: str, record: np.ndarray | np.void) -> bool:
        """Send ``record`` to the other side or its expected address; False if there is none or the buffer is full."""
        to = self.peer.address if self.peer is not None and self.peer.gone is None else self._only
        if to is None:
            return False
        self._sequences[cell] += 1
        datagram = wire.pack(
            DatagramKind.CELL, record.tobytes(), self._writer, self._sequences[cell], time.monotonic(), MAILBOXES[cell]
        )
        return self._put(datagram, to)

    def send_setup(self, setup: np.record) -> None:
        """Send ``setup`` (GNC_SETUP): its last fields in a mailbox of their own, to a peer that wants it."""
        block, size = np.asarray(setup).tobytes(), GNC_SETUP_2.itemsize
        self.send("gnc.setup", np.frombuffer(block[:size], GNC_SETUP_2))
        if "gnc.orbit" in self.peer_wants:
            self.send("gnc.orbit", np.frombuffer(block[size:], GNC_ORBIT))

    def send_input(self, given: np.record) -> None:
        """Send ``given`` (GNC_INPUT): before it what is measured in mailboxes of its own, to a peer that wants them."""
        for name, record in mailboxes_of(given, self.peer_wants):
            self.send(name, record)

    def close(self, text: str = "") -> None:
        """Send ``goodbye`` and close the socket; idempotent."""
        if self.peer is not None and self.peer.gone is None:
            for _ in range(2):  # it is not acknowledged
                self._send(DatagramKind.GOODBYE, wire.text_payload(0, text))
        self.peer = None
        self._socket.close()

    def counters(self) -> dict[str, int]:
        """Return the counts of received and rejected datagrams, summed over the mailboxes."""
        sums = {
            name: sum(int(getattr(stats, name)) for stats in self.datagram_stats.values())
            for name in ("received", "lost", "reordered", "duplicates")
        }
        refused = {fault.value: self._counts[fault.value] for fault in Fault}
        others = {name: self._counts[name] for name in ("unknown_sender", "second_writer", "unauthenticated", "unsent")}
        return {**sums, **refused, **others}

    def handle(self, datagram: bytes, sender: Address, received_s: float) -> Arrival | None:
        """Process one datagram, valid or not; return its mailbox if it is newer than the last."""
        header = wire.unpack(datagram)
        if isinstance(header, Fault):
            self._refuse_faulty(header, datagram, sender)
            return None
        if self._only is not None and sender != self._only:
            self._count("unknown_sender", sender, f"is not {shown(self._only)}, the expected address")
            self._refuse(sender, Refusal.SENDER, "another address is expected")
            return None
        if header.kind is DatagramKind.REFUSED:
            self._receive_refusal(datagram, sender)
            return None
        if not self._is_peer(header, datagram, sender, received_s):
            return None
        assert self.peer is not None
        self.peer.last_rx_s = received_s
        payload = datagram[wire.HEADER.size :]
        if header.kind is DatagramKind.CELL:
            return self._receive_mailbox(header, payload, sender, received_s)
        if header.kind is DatagramKind.HEARTBEAT:
            self._receive_heartbeat(header.time_s, payload, received_s)
        elif header.kind is DatagramKind.GOODBYE:
            self.peer.gone = wire.read_text(payload)[1] or "goodbye"
        return None

    def _receive_mailbox(
        self, header: DatagramHeader, payload: bytes, sender: Address, received_s: float
    ) -> Arrival | None:
        assert header.cell is not None
        name = header.cell.name
        stats = self.datagram_stats.get(name)
        if stats is None:
            writer = "this side writes it" if header.cell.writer is self.role else "it is not requested here"
            self._count("second_writer", sender, f"sends the mailbox {name}, but {writer}")
            return None
        if not stats.count(header.sequence):
            return None
        return Arrival(name, np.frombuffer(payload, header.cell.dtype), header.time_s, received_s)

    def _receive_heartbeat(self, time_s: float, payload: bytes, received_s: float) -> None:
        sent_s, there_s = wire.read_heartbeat(payload)
        if math.isfinite(sent_s):
            self.clock.add(sent_s, there_s, time_s, received_s)
        self._heartbeat = (time_s, received_s)

    def _is_peer(self, header: DatagramHeader, datagram: bytes, sender: Address, received_s: float) -> bool:
        """Return whether this is from the other side; accept a new one if none is alive."""
        peer = self.peer
        from_peer = peer is not None and header.writer == peer.writer and sender == peer.address
        if header.kind is DatagramKind.HELLO:
            return self._receive_hello(header, datagram, sender, received_s, from_peer)
        if from_peer:
            return True
        if self.alive(received_s):
            assert peer is not None
            self._refuse_second(header, sender, peer)
            return False
        if header.cell is not None and self._opens(header.cell.name):
            self._join(Peer(sender, header.writer, received_s))
            return True
        self._count("unknown_sender", sender, "has sent no hello")
        self._refuse(sender, Refusal.SENDER, "send hello first")
        return False

    def _opens(self, cell: str) -> bool:
        """Return whether ``cell`` replaces a hello: the setup, or an answer from the expected address."""
        if cell not in self.datagram_stats:
            return False
        return cell == "gnc.setup" if self.role is Role.GNC else self._only is not None

    def _receive_hello(
        self, header: DatagramHeader, datagram: bytes, sender: Address, received_s: float, from_peer: bool
    ) -> bool:
        hello = wire.read_hello(datagram[wire.HEADER.size :])
        if isinstance(hello, str):
            return self._refuse_hello(Fault.SIZE, sender, hello)
        if hello.role != self.there:
            return self._refuse_hello(Fault.CELL, sender, f"has role {hello.role}, expected {self.there.value}")
        if not from_peer and self.alive(received_s):
            assert self.peer is not None
            self._refuse_second(header, sender, self.peer)
            return False
        if not from_peer:
            self._join(Peer(sender, header.writer, received_s))
        assert self.peer is not None
        self.peer.hello, self.peer.gone = hello, None
        return True

    def _join(self, peer: Peer) -> None:
        self._socket.connect(peer.address)
        self.peer = peer
        self.joined += 1
        self.refusal = None
        self.clock = ClockOffset()
        self._heartbeat = (math.nan, math.nan)
        for stats in self.datagram_stats.values():
            stats.restart()

    def _refuse_faulty(self, fault: Fault, datagram: bytes, sender: Address) -> None:
        texts = {
            Fault.FOREIGN: "sends datagrams of another protocol",
            Fault.CORRUPT: "sends datagrams with a wrong checksum",
            Fault.SIZE: "sends a mailbox or message of the wrong size",
            Fault.LAYOUT: "sends a mailbox of another layout",
            Fault.KIND: "sends datagrams of an unknown kind",
            Fault.CELL: "sends an unknown mailbox",
        }
        if fault is Fault.VERSION:
            text = f"uses version {datagram[8]} of the protocol, here is version {wire.VERSION}"
            self._count(fault.value, sender, text)
            self._refuse(sender, Refusal.VERSION, f"this side uses version {wire.VERSION} of the protocol")
            return
        self._count(fault.value, sender, texts[fault])
        if fault in (Fault.SIZE, Fault.LAYOUT, Fault.CELL):
            self._refuse(sender, Refusal.MAILBOXES, texts[fault].replace("sends", "you send"))

    def _refuse_hello(self, fault: Fault, sender: Address, why: str) -> bool:
        self._count(fault.value, sender, why)
        self._refuse(sender, Refusal.MAILBOXES, why)
        return False

    def _refuse_second(self, header: DatagramHeader, sender: Address, peer: Peer) -> None:
        what = header.cell.name if header.cell is not None else f"the mailboxes of the {_NAMES[self.there]}"
        self._count("second_writer", sender, f"is a second writer of {what}: {shown(peer.address)} is alive")
        self._refuse(sender, Refusal.WRITER, f"another {_NAMES[self.there]}, {shown(peer.address)}, is alive")

    def _receive_refusal(self, datagram: bytes, sender: Address) -> None:
        code, text = wire.read_text(datagram[wire.HEADER.size :])
        expected = self._only or (self.peer.address if self.peer is not None else None)
        if sender == expected:
            self.refusal = (code, text)

    def _count(self, counter: str, sender: Address, text: str) -> None:
        self._counts[counter] += 1
        key = (text, sender)
        if key not in self._reported and len(self._reported) < _REPORTED_MAX:
            self._reported.add(key)
            self.complaints.append(f"{shown(sender)} {text}")

    def _refuse(self, to: Address, code: Refusal, text: str) -> None:
        now_s = time.monotonic()
        if now_s - self._refused_s.get(to, -math.inf) < _REFUSE_EVERY_S:
            return
        if len(self._refused_s) >= _REFUSED_ADDRESSES:
            self._refused_s.clear()
        self._refused_s[to] = now_s
        self._send(DatagramKind.REFUSED, wire.text_payload(code, text), to)

    def _send(self, kind: DatagramKind, payload: bytes, to: Address | None = None) -> None:
        to = to or (self.peer.address if self.peer is not None else None)
        if to is not None:
            self._sequences[kind.name] += 1
            self._put(wire.pack(kind, payload, self._writer, self._sequences[kind.name], time.monotonic()), to)

    def _put(self, datagram: bytes, to: Address) -> bool:
        sent = self._sealed.send(datagram, to)
        self._counts["unsent"] += not sent
        return sent
