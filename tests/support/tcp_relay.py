"""TCP relay that is a bad network: it delays both directions, with jitter, and holds them until they are let go."""

from __future__ import annotations

import queue
import random
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress


class Direction:
    """One direction. delay_s: least delay; jitter_s: of up to so much more; passes: cleared while it is held."""

    def __init__(self) -> None:
        self.delay_s = self.jitter_s = 0.0
        self.passes = threading.Event()
        self.passes.set()


class Relay:
    """Relay to ``port`` of this computer; what is under way when a direction is held arrives, in order, later."""

    def __init__(self, port: int) -> None:
        self._to = port
        self._dice = random.Random(port)
        self._open: list[socket.socket] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.up, self.down = Direction(), Direction()
        threading.Thread(target=self._accept, daemon=True).start()

    def hold(self, *directions: Direction) -> None:
        """Hold ``directions``."""
        for each in directions:
            each.passes.clear()

    def heal(self) -> None:
        """Let both directions go, without delay."""
        for each in (self.up, self.down):
            each.delay_s = each.jitter_s = 0.0
            each.passes.set()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                page, _ = self._listener.accept()
                there = socket.create_connection(("127.0.0.1", self._to))
                self._open += [page, there]
                for source, to, direction in ((page, there, self.up), (there, page, self.down)):
                    sent: queue.SimpleQueue[tuple[float, bytes]] = queue.SimpleQueue()
                    for target, near in ((self._take, source), (self._give, to)):
                        threading.Thread(target=target, args=(near, direction, sent), daemon=True).start()

    def _take(self, source: socket.socket, way: Direction, sent: queue.SimpleQueue[tuple[float, bytes]]) -> None:
        data = b"-"
        while data:
            try:
                data = source.recv(1 << 16)
            except OSError:
                data = b""
            sent.put((time.monotonic() + way.delay_s + way.jitter_s * self._dice.random(), data))

    def _give(self, to: socket.socket, way: Direction, sent: queue.SimpleQueue[tuple[float, bytes]]) -> None:
        with suppress(OSError):
            while (item := sent.get())[1]:
                time.sleep(max(0.0, item[0] - time.monotonic()))
                way.passes.wait()
                to.sendall(item[1])
            to.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close all connections."""
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self.heal()
        for each in self._open:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


@contextmanager
def relay_to(address: str) -> Iterator[Relay]:
    """Yield a relay to ``address``, ``host:port`` of this computer."""
    relay = Relay(int(address.rpartition(":")[2]))
    try:
        yield relay
    finally:
        relay.close()
