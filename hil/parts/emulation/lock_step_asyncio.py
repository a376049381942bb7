"""Event loop of asyncio in lock-step: its time is bench time, the bytes of its connections are counted."""

from __future__ import annotations

import asyncio
import math
import selectors
import socket
import time
from collections.abc import Callable
from typing import Any, Final

_DELIVERY_WALL_S: Final = 5e-5  # between two looks for bytes and connections that the kernel delivers


class _CountedSocket(socket.socket):
    """A connected socket whose bytes are counted. on_close: called with its descriptor before that is released."""

    wire: Any
    """Its ``LockStepWire``."""
    on_close: Callable[[int], object]

    def recv(self, size: int, *args: Any) -> bytes:
        return self.wire.read(self.fileno(), size) if self.wire.pending > 0 else super().recv(size, *args)

    def send(self, data: Any, *args: Any) -> int:
        self.wire.sending(len(data))
        taken = 0
        try:
            taken = super().send(data, *args)
        finally:
            self.wire.sending(taken - len(data))
        return taken

    def close(self) -> None:
        if self.fileno() >= 0:
            self.on_close(self.fileno())
        super().close()
        self.wire.close()


class _LockStepSelector(selectors.DefaultSelector):
    """Selector that waits in bench time, and for counted bytes as long as the kernel takes to deliver them."""

    def __init__(self, clock: Any) -> None:
        super().__init__()
        self._clock = clock
        self.wires: dict[int, Any] = {}
        """Wires, LockStepWire, by descriptor."""
        self.accepts = False
        self.called = clock.event()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if not (self._expected() or (timeout is not None and timeout <= 0.0) or self.called.begin()):
            listens = 0
            for wire in self.wires.values():
                listens |= wire.listens
            deadline_ns = self._clock.deadline_ns(math.inf if timeout is None else timeout)
            self._clock.wait_until_ns(deadline_ns, listens, self.accepts)
        self.called.clear()
        events: list[tuple[selectors.SelectorKey, int]] = super().select(0.0)
        while not self._expected() <= {key.fd for key, _ in events}:
            time.sleep(_DELIVERY_WALL_S)
            events = super().select(0.0)
        return sorted(events, key=lambda ready: ready[0].fd)  # in the same order each time

    def _expected(self) -> set[int]:
        """Return the descriptors that are or will be ready by themselves: of counted bytes, of a new connection."""
        descriptors = set()
        keys: dict[int, selectors.SelectorKey] = self._fd_to_key  # type: ignore[attr-defined]
        for descriptor, key in keys.items():
            wire = self.wires.get(descriptor)
            if key.events & selectors.EVENT_WRITE or (wire is not None and wire.is_readable):
                descriptors.add(descriptor)
        return descriptors


class LockStepEventLoop(asyncio.SelectorEventLoop):
    """Event loop of one participant in the bench time of ``clock``, a LockStepClock."""

    def __init__(self, clock: Any) -> None:
        self._waits = _LockStepSelector(clock)
        self.clock = clock
        self.wires = self._waits.wires
        """Wires whose bytes are work of this loop, by descriptor."""
        super().__init__(self._waits)

    def time(self) -> float:
        return float(self.clock.now_s())

    async def create_server(self, *args: Any, **kwargs: Any) -> asyncio.Server:
        server = await super().create_server(*args, **kwargs)
        self._waits.accepts = True
        return server

    def _write_to_self(self) -> None:
        self._waits.called.set()

    def _make_socket_transport(
        self, sock: socket.socket, protocol: Any, waiter: Any = None, *, extra: Any = None, server: Any = None
    ) -> Any:
        here, there = sock.getsockname(), sock.getpeername()
        accepted = server is not None
        key = f"{here}>{there}" if accepted else f"{there}>{here}"
        counted = _CountedSocket(fileno=sock.detach())
        counted.setblocking(False)
        wires = self.wires
        counted.wire = wires[counted.fileno()] = self.clock.wire(key, int(not accepted), of_line=False)
        counted.on_close = lambda descriptor: wires.pop(descriptor, None)
        return super()._make_socket_transport(  # type: ignore[misc]
            counted, protocol, waiter, extra=extra, server=server
        )
