"""UDP wires: datagrams that a port of this computer receives and may answer, by the wall clock or in lock-step."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Final

from hil.core.clock import BenchClock

_LONGEST: Final = 65536
_DELIVERED_WALL_S: Final = 1.0  # of a datagram that was announced


def wire_key(port: int) -> str:
    """Return the key of the wire to a UDP port, the same for both ends."""
    return f"udp {port}"


class DatagramPort:
    """A port of this computer, with the interface of a serial port as far as readers use it.

    timeout_s: longest wait of ``read``, wall time, bench time in lock-step. answered: to the first sender alone, others
    are not received then. Raises OSError if it cannot be opened.
    """

    in_waiting = 0

    def __init__(self, clock: BenchClock, host: str, port: int, timeout_s: float, answered: bool = False) -> None:
        self.port = f"{host}:{port}"
        self._timeout_s = timeout_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.settimeout(_DELIVERED_WALL_S)
        self._wire = clock.wire(wire_key(port), 1)
        self._answered, self._connected = answered, False

    @property
    def number(self) -> int:
        """Number of the port."""
        return int(self._socket.getsockname()[1])

    @property
    def is_readable(self) -> bool:
        """Whether a datagram has arrived. Raises OSError after ``close``."""
        return self._wire.wait(self._socket.fileno(), 0.0)

    def read(self, size: int = _LONGEST) -> bytes:
        """Return the next datagram, whole, b"" if none has come in time. Raises OSError after ``close``."""
        descriptor = self._socket.fileno()
        if not self._wire.wait(descriptor, self._timeout_s):
            return b""
        with suppress(TimeoutError, ConnectionRefusedError):
            data, sender = self._socket.recvfrom(_LONGEST, socket.MSG_PEEK)
            if data:
                received = self._wire.read(descriptor, len(data))
                if self._answered and not self._connected:
                    self._socket.connect(sender)
                    self._connected = True
                return received
            self._socket.recv(1)  # an empty one
        return b""

    def answer(self, data: bytes) -> None:
        """Send a datagram to the sender of the first one."""
        with suppress(ConnectionRefusedError):
            self._wire.write(self._socket.fileno(), data)

    def close(self) -> None:
        """Close the port, with what has not been read. Idempotent."""
        self._timeout_s = 0.0
        self._socket.settimeout(0.0)
        with suppress(OSError, ValueError):
            while self.read():
                pass
        self._wire.close()
        self._socket.close()


class DatagramSender:
    """The device's end of a UDP wire. port: to which it sends; None: one of 127.0.0.1 that is free."""

    def __init__(self, clock: BenchClock, host: str = "127.0.0.1", port: int | None = None) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        if port is None:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((host, 0))
                port = int(probe.getsockname()[1])
        self.path = f"{host}:{port}"
        self._socket.connect((host, port))
        self._wire = clock.wire(wire_key(port), 0)

    def read(self, timeout_s: float) -> bytes:
        """Return the next answer, b"" if none comes within ``timeout_s``, wall time, bench time in lock-step."""
        descriptor = self._socket.fileno()
        if self._wire.wait(descriptor, timeout_s):
            with suppress(ConnectionRefusedError, BlockingIOError):
                length = len(self._socket.recv(_LONGEST, socket.MSG_PEEK | socket.MSG_DONTWAIT))
                return self._wire.read(descriptor, length)
        return b""

    def write(self, data: bytes) -> None:
        """Send one datagram; it is lost if no program receives it."""
        for _ in range(2):  # the first may report that the one before was not received
            with suppress(ConnectionRefusedError):
                self._wire.write(self._socket.fileno(), data)
                return

    def close(self) -> None:
        """Close the wire. Idempotent."""
        self._wire.close()
        self._socket.close()
