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
        found = socket.getaddrinfo(host, int(port_text), socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        raise BadInput.single(option, "", f"{text}: unknown host: {error.strerror or error}") from error
    address: Address = (str(found[0][4][0]), int(found[0][4][1]))
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
    """UDP socket bound to one address of this host. Raises BadInput if it cannot be bound."""

    def __init__(self, bind: Address, option: str = "--listen") -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self._socket.setsockopt(socket.IPPROTO_IP, _IP_RECVERR, 1)
        self._closed: list[Address] = []
        try:
            self._socket.bind(bind)
        except OSError as error:
            self._socket.close()
            raise BadInput.single(option, "", f"{shown(bind)}: cannot listen there: {error.strerror}") from error
        self.address: Address = self._socket.getsockname()

    def receive(self) -> tuple[bytes, Address, float] | None:
        """Return the next datagram, its sender and the kernel's receive time (monotonic, s); None without any."""
        for _ in range(_TRIES):
            try:
                datagram, ancillary, _, sender = self._socket.recvmsg(_BUFFER_SIZE, 64)
                break
            except BlockingIOError:
                return None
            except OSError:  # the error of an earlier datagram comes first
                self._read_errors()
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
                self._socket.sendto(datagram, to)
                return True
            except BlockingIOError:
                return False
            except OSError:
                self._read_errors()
        return False

    def closed_ports(self) -> list[Address]:
        """Return the addresses that were reported as unreachable (port closed) since the last call."""
        closed, self._closed = self._closed, []
        return closed

    def _read_errors(self) -> None:
        for _ in range(_ERRORS_AT_ONCE):
            try:
                _, ancillary, _, to = self._socket.recvmsg(_BUFFER_SIZE, 512, socket.MSG_ERRQUEUE)
            except OSError:
                return
            for level, kind, error in ancillary:
                reported = level == socket.IPPROTO_IP and kind == _IP_RECVERR and len(error) >= 4
                if reported and struct.unpack_from("=I", error)[0] == errno.ECONNREFUSED:
                    self._closed.append(to)

    def wait(self, timeout_s: float) -> bool:
        """Wait for a datagram; return whether there is one. 0 does not wait."""
        return bool(select.select([self._socket], [], [], max(0.0, timeout_s))[0])  # poll() has a resolution of 1 ms

    def close(self) -> None:
        """Close the socket; idempotent."""
        self._socket.close()
