"""Emulated serial lines: pseudo terminals with the timing of the real line.

A pty has no line rate; here every byte takes ten bit times of bench time, which reproduces latency and half-duplex
turn-around. The other end opens ``path`` like any port.
"""

from __future__ import annotations

import os
import termios
import threading
import tty
from contextlib import suppress

from hil.core.clock import BenchClock

_BITS_PER_BYTE = 10
_CHUNK = 4096
_PACKET = 62  # bytes of an adapter's full USB packet (FTDI, AN232B-04)


def _open_raw_pty() -> tuple[int, int, str]:
    master, slave = os.openpty()
    tty.setraw(slave, termios.TCSANOW)
    os.set_blocking(master, False)
    return master, slave, os.ttyname(slave)


class PtyLine:
    """The device's end of a serial line. ``path`` is the port for the other end."""

    def __init__(self, baud: int, clock: BenchClock, latency_s: float = 0.0) -> None:
        """latency_s: time for which the adapter at the other end collects bytes, unless they fill a packet."""
        self._clock = clock
        self._byte_s = _BITS_PER_BYTE / baud
        self._latency_s = latency_s
        self._master, self._slave, self.path = _open_raw_pty()
        self._wire = clock.wire(self.path, 0)
        self._sent_until_s = 0.0
        self._write_lock = threading.Lock()
        self._open = True

    def read(self, timeout_s: float) -> bytes:
        """Return the data received within ``timeout_s`` of bench time, b"" if none, after its line time."""
        if not self._wire.wait(self._master, self._clock.wall_s(timeout_s)):
            return b""
        arrived_s = self._clock.now_s()
        data = self._wire.read(self._master, _CHUNK)
        self._clock.sleep_until(arrived_s + len(data) * self._byte_s)
        return data

    def write(self, data: bytes) -> None:
        """Send ``data``; returns, and the bytes arrive, after their line time.

        Unread data is lost once the kernel's buffer is full.
        """
        with self._write_lock:
            full = len(data) // _PACKET * _PACKET if self._latency_s else 0
            for part, latency_s in ((data[:full], 0.0), (data[full:], self._latency_s)):
                start_s = max(self._clock.now_s(), self._sent_until_s)
                self._sent_until_s = start_s + len(part) * self._byte_s
                self._deliver(part, max(self._sent_until_s, start_s + latency_s))

    def _deliver(self, data: bytes, arrive_s: float) -> None:
        if not data:
            return
        self._clock.sleep_until(arrive_s)
        with suppress(BlockingIOError):  # what exceeds the kernel's buffer is lost, as on a real line
            while data:
                data = data[self._wire.write(self._master, data) :]

    def close(self) -> None:
        """Close the line. Idempotent."""
        if self._open:
            self._open = False
            self._wire.close()
            os.close(self._slave)
            os.close(self._master)
