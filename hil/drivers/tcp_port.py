"""A TCP connection with the interface of a serial port: for controllers with their ASCII protocol on Ethernet."""

from __future__ import annotations

import fcntl
import socket
import struct
import termios
from typing import Final

from hil.core.clock import BenchClock

SCHEME: Final = "tcp://"
_CONNECT_WALL_S: Final = 2.0
_DRIVER: Final = 1


def is_tcp(path: str) -> bool:
    """Return whether a port is a TCP address, ``tcp://HOST:PORT``."""
    return path.startswith(SCHEME)


class TcpPort:
    """Connection to ``path``, tcp://HOST:PORT. Raises OSError, ValueError for an address that is none.

    timeout: longest wait of ``read``, s of wall time, bench time in lock-step, where the bytes are counted.
    """

    def __init__(self, clock: BenchClock, path: str, timeout: float | None = None) -> None:
        host, _, port = path.removeprefix(SCHEME).rpartition(":")
        self._timeout_s = timeout or 0.0
        self._socket = socket.create_connection((host, int(port)), timeout=_CONNECT_WALL_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._socket.settimeout(_CONNECT_WALL_S)
        key = f"{self._socket.getpeername()}>{self._socket.getsockname()}"
        self._wire = clock.wire(key, _DRIVER, of_line=False)

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read at once."""
        if (pending := getattr(self._wire, "pending", None)) is not None:
            return int(pending)
        raw = fcntl.ioctl(self._socket.fileno(), termios.FIONREAD, b"\0" * 4)
        return int(struct.unpack("i", raw)[0])

    def read(self, size: int = 1) -> bytes:
        """Return at most ``size`` bytes, b"" after the time-out. Raises OSError when the other end has gone."""
        if size == 0 or not self.wait_readable(self._timeout_s):
            return b""
        data = self._wire.read(self._socket.fileno(), size)
        if not data:
            raise OSError("the controller has closed the connection")
        return data

    def write(self, data: bytes) -> int:
        """Send ``data``."""
        sent = 0
        while sent < len(data):
            sent += self._wire.write(self._socket.fileno(), data[sent:])
        return sent

    def wait_readable(self, wall_s: float) -> bool:
        """Wait at most ``wall_s`` until there is something to read; return whether there is."""
        return self._wire.wait(self._socket.fileno(), wall_s)

    def close(self) -> None:
        """Disconnect. Idempotent."""
        if self._socket.fileno() >= 0:
            self._socket.close()
            self._wire.close()
