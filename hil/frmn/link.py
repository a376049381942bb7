"""One side of the reflective memory between two hosts: cells over UDP to and from one other side.

Nothing here waits but ``wait``, and nothing that comes from outside raises: what cannot be used is counted, and said
in words once for each cause and sender.
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

from hil.core.observable import ObservableList
from hil.frmn import wire
from hil.frmn.clock_offset import ClockOffset
from hil.frmn.datagram_stats import DatagramStats
from hil.frmn.mailboxes import MAILBOXES, Role
from hil.frmn.udp import Address, UdpSocket, address_towards, shown
from hil.frmn.wire import DatagramHeader, DatagramKind, Fault, Refusal

_EVERY_S: Final = 0.1  # heartbeats, and hellos as long as nobody answers
_AT_ONCE: Final = 64
_WORDS: Final = 64  # causes that are told; from then on they are counted alone
_REFUSE_EVERY_S: Final = 0.5  # to one address: nobody can be flooded by way of us
_REFUSED_ADDRESSES: Final = 256
PORT_CLOSED: Final = "its port is closed"
"""What is said in place of a goodbye of a side whose program has ended without one."""
_NAMES: Final = {Role.DSS: "dss", Role.GNC: "gnc"}


class Arrival(NamedTuple):
    """A cell that came. record: (1,) of its dtype, read-only. received_s: by this host's monotonic clock."""

    name: str
    record: np.ndarray
    time_s: float
    received_s: float


@dataclass(slots=True)
class Peer:
    """The other side. heard_s: when it was heard last, monotonic; hello: None where it never said any."""

    address: Address
    writer: int
    heard_s: float
    hello: wire.Hello | None = None
    gone: str | None = None
    """Its goodbye."""


class Link:
    """This side, as ``role``, of a link that carries the cells in ``offers`` there and those in ``wants`` here.

    bind: address of this host that is listened on; None: the one on the way to ``peer``. peer: the only address that
    is spoken with; None: whoever says hello first. silent_max_s: a side that has been silent for so long is gone, and
    another may take its place.
    """

    def __init__(
        self,
        role: Role,
        name: str,
        offers: Collection[str],
        wants: Collection[str],
        bind: Address | None = None,
        peer: Address | None = None,
        silent_max_s: float = 1.0,
    ) -> None:
        assert bind is not None or peer is not None
        self.role = role
        self.there = Role.GNC if role is Role.DSS else Role.DSS
        self._socket = UdpSocket(bind or address_towards(peer or ("", 0)), "--listen" if bind else "--dss")
        self.address = self._socket.address
        self.silent_max_s = silent_max_s
        self.peer: Peer | None = None
        self.joined = 0
        """How many other sides have been taken so far."""
        self.refusal: tuple[int, str] | None = None
        """What the other side refused last: Refusal and its words."""
        self.complaints: ObservableList[str] = ObservableList()
        """What was refused here, and why; each cause and sender once."""
        self.clock = ClockOffset()
        self.tallies = {cell: DatagramStats() for cell in wants}
        self._offers, self._wants = tuple(offers), tuple(wants)
        self._only = peer
        self._hello = wire.hello_payload(role, name, offers, wants)
        self._writer = secrets.randbits(32) or 1
        self._sequences: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()
        self._told: set[tuple[str, Address]] = set()
        self._refused_s: dict[Address, float] = {}
        self._beaten_s = -math.inf
        self._heartbeat = (math.nan, math.nan)  # the newest of the other side's: its time, and when it came

    def alive(self, now_s: float) -> bool:
        """Return whether there is another side that has been heard lately; now_s: monotonic."""
        return self.peer is not None and self.peer.gone is None and now_s - self.peer.heard_s <= self.silent_max_s

    @property
    def expects(self) -> bool:
        """Whether this side knows where the other one is to be, before it was heard."""
        return self._only is not None

    def poll(self, at_most: int = _AT_ONCE) -> list[Arrival]:
        """Take what has come; return the cells in it, in the order in which they came, old values left out.

        at_most: datagrams that are looked at; the others wait for the next call.
        """
        arrivals: list[Arrival] = []
        for _ in range(at_most):
            came = self._socket.receive()
            if came is None:
                break
            arrival = self.handle(*came)
            if arrival is not None:
                arrivals.append(arrival)
        closed = self._socket.closed_ports()
        if self.peer is not None and self.peer.gone is None and self.peer.address in closed:
            self.peer.gone = PORT_CLOSED  # without a goodbye
        return arrivals

    def wait(self, timeout_s: float) -> bool:
        """Wait until something has come, at most ``timeout_s``; return whether it has."""
        return self._socket.wait(timeout_s)

    def service(self) -> None:
        """Say what is due by itself: a heartbeat, or hello while there is nobody; call it often."""
        now_s = time.monotonic()
        if now_s - self._beaten_s < _EVERY_S:
            return
        self._beaten_s = now_s
        if self.alive(now_s) or (self.peer is not None and self._only is None):
            self._say(DatagramKind.HEARTBEAT, wire.heartbeat_payload(*self._heartbeat))
        elif self._only is not None:
            self._say(DatagramKind.HELLO, self._hello, self._only)

    def send(self, cell: str, record: np.ndarray | np.void) -> bool:
        """Send ``record`` to the other side, or to where it is expected; False where there is none or no room."""
        to = self.peer.address if self.peer is not None and self.peer.gone is None else self._only
        if to is None:
            return False
        self._sequences[cell] += 1
        datagram = wire.pack(
            DatagramKind.CELL, record.tobytes(), self._writer, self._sequences[cell], time.monotonic(), MAILBOXES[cell]
        )
        return self._put(datagram, to)

    def forget(self) -> None:
        """Let go of the other side: whoever comes next is taken."""
        self.peer = None

    def close(self, text: str = "") -> None:
        """Say goodbye and let go of the socket; idempotent."""
        if self.peer is not None and self.peer.gone is None:
            for _ in range(2):  # nobody answers it
                self._say(DatagramKind.GOODBYE, wire.word_payload(0, text))
        self.peer = None
        self._socket.close()

    def counters(self) -> dict[str, int]:
        """Return what came and what became of it, summed over the cells."""
        sums = {
            name: sum(int(getattr(tally, name)) for tally in self.tallies.values())
            for name in ("received", "lost", "reordered", "duplicates")
        }
        refused = {fault.value: self._counts[fault.value] for fault in Fault}
        others = {name: self._counts[name] for name in ("unknown_sender", "second_writer", "unsent")}
        return {**sums, **refused, **others}

    def handle(self, datagram: bytes, sender: Address, received_s: float) -> Arrival | None:
        """Take one datagram, whatever it is; return the cell in it where it is a newer one."""
        found = wire.unpack(datagram)
        if isinstance(found, Fault):
            self._refuse_faulty(found, datagram, sender)
            return None
        if self._only is not None and sender != self._only:
            self._count("unknown_sender", sender, f"is not {shown(self._only)}, with whom this side speaks")
            self._refuse(sender, Refusal.SENDER, "another address is expected here")
            return None
        if found.kind is DatagramKind.REFUSED:
            self._hear_refusal(datagram, sender)
            return None
        if not self._is_peer(found, datagram, sender, received_s):
            return None
        assert self.peer is not None
        self.peer.heard_s = received_s
        payload = datagram[wire.HEADER.size :]
        if found.kind is DatagramKind.CELL:
            return self._take_cell(found, payload, sender, received_s)
        if found.kind is DatagramKind.HEARTBEAT:
            self._take_heartbeat(found.time_s, payload, received_s)
        elif found.kind is DatagramKind.GOODBYE:
            self.peer.gone = wire.read_word(payload)[1] or "goodbye"
        return None

    def _take_cell(self, header: DatagramHeader, payload: bytes, sender: Address, received_s: float) -> Arrival | None:
        assert header.cell is not None
        name = header.cell.name
        tally = self.tallies.get(name)
        if tally is None:
            writer = "this side writes it" if header.cell.writer is self.role else "nobody wants it here"
            self._count("second_writer", sender, f"sends the cell {name}, but {writer}")
            return None
        if not tally.count(header.sequence):
            return None
        return Arrival(name, np.frombuffer(payload, header.cell.dtype), header.time_s, received_s)

    def _take_heartbeat(self, time_s: float, payload: bytes, received_s: float) -> None:
        sent_s, there_s = wire.read_heartbeat(payload)
        if math.isfinite(sent_s):
            self.clock.add(sent_s, there_s, time_s, received_s)
        self._heartbeat = (time_s, received_s)

    def _is_peer(self, header: DatagramHeader, datagram: bytes, sender: Address, received_s: float) -> bool:
        """Return whether this is from the other side; take a new one where there is none alive."""
        peer = self.peer
        known = peer is not None and header.writer == peer.writer and sender == peer.address
        if header.kind is DatagramKind.HELLO:
            return self._hear_hello(header, datagram, sender, received_s, known)
        if known:
            return True
        if self.alive(received_s):
            assert peer is not None
            self._refuse_second(header, sender, peer)
            return False
        if header.cell is not None and self._opens(header.cell.name):
            self._join(Peer(sender, header.writer, received_s))
            return True
        self._count("unknown_sender", sender, "has not said hello")
        self._refuse(sender, Refusal.SENDER, "say hello first")
        return False

    def _opens(self, cell: str) -> bool:
        """Return whether ``cell`` is enough of a hello: the setup, or an answer from where one is expected."""
        if cell not in self.tallies:
            return False
        return cell == "gnc.setup" if self.role is Role.GNC else self._only is not None

    def _hear_hello(
        self, header: DatagramHeader, datagram: bytes, sender: Address, received_s: float, known: bool
    ) -> bool:
        hello = wire.read_hello(datagram[wire.HEADER.size :])
        if isinstance(hello, str):
            return self._refuse_hello(Fault.SIZE, sender, hello)
        if hello.role != self.there:
            return self._refuse_hello(Fault.CELL, sender, f"has role {hello.role}, expected is {self.there.value}")
        if not known and self.alive(received_s):
            assert self.peer is not None
            self._refuse_second(header, sender, self.peer)
            return False
        if not known:
            self._join(Peer(sender, header.writer, received_s))
        assert self.peer is not None
        self.peer.hello, self.peer.gone = hello, None
        return True

    def _join(self, peer: Peer) -> None:
        self.peer = peer
        self.joined += 1
        self.refusal = None
        self.clock = ClockOffset()
        self._heartbeat = (math.nan, math.nan)
        for tally in self.tallies.values():
            tally.restart()

    def _refuse_faulty(self, fault: Fault, datagram: bytes, sender: Address) -> None:
        words = {
            Fault.FOREIGN: "sends what is none of this protocol",
            Fault.CORRUPT: "sends datagrams with a wrong checksum",
            Fault.SIZE: "sends a cell or word of another size than its kind has",
            Fault.LAYOUT: "sends a cell of another layout",
            Fault.KIND: "sends datagrams of an unknown kind",
            Fault.CELL: "sends an unknown cell",
        }
        if fault is Fault.VERSION:
            text = f"speaks version {datagram[8]} of the protocol, here is version {wire.VERSION}"
            self._count(fault.value, sender, text)
            self._refuse(sender, Refusal.VERSION, f"this side speaks version {wire.VERSION} of the protocol")
            return
        self._count(fault.value, sender, words[fault])
        if fault in (Fault.SIZE, Fault.LAYOUT, Fault.CELL):
            self._refuse(sender, Refusal.MAILBOXES, words[fault].replace("sends", "you send"))

    def _refuse_hello(self, fault: Fault, sender: Address, why: str) -> bool:
        self._count(fault.value, sender, why)
        self._refuse(sender, Refusal.MAILBOXES, why)
        return False

    def _refuse_second(self, header: DatagramHeader, sender: Address, peer: Peer) -> None:
        what = header.cell.name if header.cell is not None else f"the cells of the {_NAMES[self.there]}"
        self._count("second_writer", sender, f"is a second writer of {what}: {shown(peer.address)} is alive")
        self._refuse(sender, Refusal.WRITER, f"another {_NAMES[self.there]}, {shown(peer.address)}, is alive")

    def _hear_refusal(self, datagram: bytes, sender: Address) -> None:
        code, text = wire.read_word(datagram[wire.HEADER.size :])
        expected = self._only or (self.peer.address if self.peer is not None else None)
        if sender == expected:
            self.refusal = (code, text)

    def _count(self, counter: str, sender: Address, words: str) -> None:
        self._counts[counter] += 1
        key = (words, sender)
        if key not in self._told and len(self._told) < _WORDS:
            self._told.add(key)
            self.complaints.append(f"{shown(sender)} {words}")

    def _refuse(self, to: Address, code: Refusal, text: str) -> None:
        now_s = time.monotonic()
        if now_s - self._refused_s.get(to, -math.inf) < _REFUSE_EVERY_S:
            return
        if len(self._refused_s) >= _REFUSED_ADDRESSES:
            self._refused_s.clear()
        self._refused_s[to] = now_s
        self._say(DatagramKind.REFUSED, wire.word_payload(code, text), to)

    def _say(self, kind: DatagramKind, payload: bytes, to: Address | None = None) -> None:
        to = to or (self.peer.address if self.peer is not None else None)
        if to is not None:
            self._sequences[kind.name] += 1
            self._put(wire.pack(kind, payload, self._writer, self._sequences[kind.name], time.monotonic()), to)

    def _put(self, datagram: bytes, to: Address) -> bool:
        sent = self._socket.send(datagram, to)
        self._counts["unsent"] += not sent
        return sent
