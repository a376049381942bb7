"""Non-blocking UDP sockets with the kernel's receive time stamps and notice of closed ports."""

from __future__ import annotations

import errno
import select
import socket
import struct
import time
from typing import Final

from hil.errors import BadInput

Address = tuple[str, int]

LOOPBACK: Final = "127.0.0.1"
_SO_TIMESTAMPNS: Final = 35  # Linux, asm-generic/socket.h
_IP_RECVERR: Final = 11  # Linux, linux/in.h: also of sockets that are not connected
_STAMP: Final = struct.Struct("=qq")  # s, ns of CLOCK_REALTIME
_BUFFER_BYTES: Final = 1 << 20
_TRIES: Final = 3
_ERRORS_AT_ONCE: Final = 16
_BUFFER_SIZE: Final = 2048  # bytes: more than any valid datagram, so that longer ones are detected
_OLDEST_S: Final = 1.0  # an older stamp means that the host's clock was set


def parse_address(option: str, text: str, default_port: int) -> Address:
    """Return host and port of ``HOST:PORT``, ``HOST`` or ``:PORT`` (this computer); raise BadInput."""
    host, colon, port_text = text.rpartition(":")
    if not colon:
        host, port_text = text, str(default_port)
    host = host.strip("[]") or LOOPBACK
    if not port_text.isdecimal() or not 0 <= int(port_text) <= 65535:
        raise BadInput.single(option, "", f"{text}: must be HOST:PORT with a port from 0 to 65535")
    try:
        resolved = socket.getaddrinfo(host, int(port_text), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise BadInput.single(option, "", f"{text}: unknown host: {error.strerror or error}") from error
    address: Address = (str(resolved[0][4][0]), int(resolved[0][4][1]))
    return address


def shown(address: Address) -> str:
    """Return ``HOST:PORT``."""
    return f"{address[0]}:{address[1]}"


def address_towards(peer: Address) -> Address:
    """Return this host's address on the route to ``peer``, with any free port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(peer)
        return str(probe.getsockname()[0]), 0


class UdpSocket:
    """UDP port of one address of this host, with a socket connected to the peer once there is one.

    The kernel delivers the peer's datagrams to the connected socket: those of strangers wait in the buffer of the
    other one, and can neither fill the peer's nor delay its reader. Raises BadInput if the port cannot be bound.
    """

    def __init__(self, bind: Address, option: str = "--listen") -> None:
        self._listening = _open()
        self._connected: socket.socket | None = None
        self._peer: Address | None = None
        self._closed: list[Address] = []
        try:
            self._listening.bind(bind)
        except OSError as error:
            self._listening.close()
            raise BadInput.single(option, "", f"{shown(bind)}: cannot listen there: {error.strerror}") from error
        self.address: Address = self._listening.getsockname()

    def connect(self, peer: Address) -> None:
        """Receive from ``peer`` by a socket of its own from now on; no effect if the system refuses it."""
        if peer == self._peer:
            return
        self._disconnect()
        connected = _open()
        pair = (self._listening, connected)
        try:
            for each in pair:
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            connected.bind(self.address)
            connected.connect(peer)
            for each in pair:  # no other process of this user can bind the port
                each.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 0)
        except OSError:
            connected.close()
            return
        self._connected, self._peer = connected, peer

    def receive(self, from_peer: bool = False) -> tuple[bytes, Address, float] | None:
        """Return the next datagram, its sender and the kernel's receive time (monotonic, s); None without any.

        from_peer: of the peer alone, to which this port is connected; else of all others.
        """
        source = self._connected if from_peer else self._listening
        if source is None:
            return None
        for _ in range(_TRIES):
            try:
                datagram, ancillary, _, sender = source.recvmsg(_BUFFER_SIZE, 64)
                break
            except BlockingIOError:
                return None
            except OSError:  # the error of an earlier datagram comes first
                self._read_errors(source)
        else:
            return None
        age_s = 0.0
        for level, kind, stamp in ancillary:
            if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS and len(stamp) >= _STAMP.size:
                s, ns = _STAMP.unpack_from(stamp)
                found_s = (time.time_ns() - (s * 1_000_000_000 + ns)) * 1e-9
                age_s = found_s if 0.0 <= found_s <= _OLDEST_S else 0.0
        return datagram, sender, time.monotonic() - age_s  # read last: preempted here, the time is late, never early

    def send(self, datagram: bytes, to: Address) -> bool:
        """Send ``datagram``; return whether the kernel accepted it. Never waits, never raises."""
        for _ in range(_TRIES):
            try:
                self._listening.sendto(datagram, to)
                return True
            except BlockingIOError:
                return False
            except OSError:
                self._read_errors(self._listening)
        return False

    def closed_ports(self) -> list[Address]:
        """Return the addresses that were reported as unreachable (port closed) since the last call."""
        closed, self._closed = self._closed, []
        return closed

    def _read_errors(self, source: socket.socket) -> None:
        for _ in range(_ERRORS_AT_ONCE):
            try:
                _, ancillary, _, to = source.recvmsg(_BUFFER_SIZE, 512, socket.MSG_ERRQUEUE)
            except OSError:
                return
            for level, kind, error in ancillary:
                reported = level == socket.IPPROTO_IP and kind == _IP_RECVERR and len(error) >= 4
                if reported and struct.unpack_from("=I", error)[0] == errno.ECONNREFUSED:
                    self._closed.append(to)

    def wait(self, timeout_s: float, for_peer: bool = False) -> bool:
        """Wait for a datagram; return whether there is one. 0 does not wait. for_peer: for one of the peer alone."""
        sources = [self._connected] if self._connected is not None else []
        if not (for_peer and sources):
            sources.append(self._listening)
        return bool(select.select(sources, [], [], max(0.0, timeout_s))[0])  # poll() has a resolution of 1 ms

    def close(self) -> None:
        """Close the port; idempotent."""
        self._disconnect()
        self._listening.close()

    def _disconnect(self) -> None:
        if self._connected is not None:
            self._connected.close()
            self._connected = self._peer = None


def _open() -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.setblocking(False)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    opened.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    opened.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
    return opened
