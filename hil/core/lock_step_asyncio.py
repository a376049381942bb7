"""Event loop of asyncio in lock-step: its time is bench time, the bytes of its connections are counted."""

from __future__ import annotations

import asyncio
import math
import selectors
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from hil.core.lock_step import LockStepWire

if TYPE_CHECKING:
    from hil.core.lock_step import LockStepClock

_DELIVERY_WALL_S: Final = 1.0  # longest delay of bytes and connections by the kernel


class _CountedSocket(socket.socket):
    """A connected socket whose bytes are counted. on_close: called with its descriptor before that is released."""

    wire: LockStepWire
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


class _LockStepSelector(selectors.DefaultSelector):  # type: ignore[valid-type, misc]
    """Selector that waits in bench time, and for bytes that are counted as long as the kernel takes to deliver them."""

    def __init__(self, clock: LockStepClock) -> None:
        super().__init__()
        self._clock = clock
        self.wires: dict[int, LockStepWire] = {}
        """By descriptor."""
        self.accepts = False
        self.called = clock.event()

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        if not (self._is_delivering() or (timeout is not None and timeout <= 0.0) or self.called.begin()):
            listens = 0
            for wire in self.wires.values():
                listens |= wire.listens
            self._clock.wait_until_ns(
                self._clock.deadline_ns(math.inf if timeout is None else timeout), listens, self.accepts
            )
        self.called.clear()
        found: list[tuple[selectors.SelectorKey, int]] = super().select(
            _DELIVERY_WALL_S if self._is_delivering() else 0.0
        )
        return found

    def _is_delivering(self) -> bool:
        """Return whether a descriptor is to be ready by itself: bytes are counted, or a connection is being made."""
        writes = any(key.events & selectors.EVENT_WRITE for key in self.get_map().values())
        return writes or any(wire.is_readable for wire in self.wires.values())


class LockStepEventLoop(asyncio.SelectorEventLoop):
    """Event loop of one participant."""

    def __init__(self, clock: LockStepClock) -> None:
        self._waits = _LockStepSelector(clock)
        self._clock = clock
        super().__init__(self._waits)

    def time(self) -> float:
        return self._clock.now_s()

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
        wires = self._waits.wires
        counted.wire = wires[counted.fileno()] = LockStepWire(self._clock, key, int(not accepted), of_line=False)
        counted.on_close = lambda descriptor: wires.pop(descriptor, None)
        return super()._make_socket_transport(  # type: ignore[misc]
            counted, protocol, waiter, extra=extra, server=server
        )
