"""Thread that reads a wire on which a device sends by itself, and passes on what it receives."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from hil.core.clock import BenchClock
from hil.errors import LinkLost

READ_WALL_S: Final = 0.1
"""Bound of one blocking read, for the time-out of a port; ``close`` cuts it short."""


class WireReader:
    """Reads ``port`` until it is closed or fails. name: of the device. receive: takes bytes and their time of receipt.

    port: a serial port or ``DatagramPort``. Any error that ends the thread is kept for the cycle.
    """

    def __init__(self, name: str, port: Any, clock: BenchClock, receive: Callable[[bytes, float], None]) -> None:
        self._name, self._port, self._clock, self._receive = name, port, clock, receive
        self._ending = threading.Event()
        self._cause: Exception | None = None
        self.failure = ""
        """Why the wire is gone, "" while it is there."""
        self._thread = clock.start_thread(self._read, f"{name}-reader")

    def check(self) -> None:
        """Raise LinkLost if the wire is gone."""
        if self.failure:
            raise LinkLost(self._name, self.failure) from self._cause

    def close(self, last: bytes = b"") -> None:
        """Send ``last``, end the thread and close the port; idempotent, never raises."""
        self._ending.set()
        with suppress(Exception):  # the port may be gone already, and one of datagrams has no cancel_read
            if last:
                self._port.write(last)
            self._port.cancel_read()
        self._clock.join(self._thread, 2.0 * READ_WALL_S)
        with suppress(Exception):
            self._port.close()

    def _read(self) -> None:
        try:
            while not self._ending.is_set():
                data = self._port.read(max(1, self._port.in_waiting))
                if data:
                    self._receive(data, self._clock.now_s())
        except Exception as cause:
            if not self._ending.is_set():
                self._cause, self.failure = cause, f"{self._port.port}: {cause}"
