"""Life cycle of drivers on asyncio: one event loop in its own thread, from ``open`` to ``close``."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Final

from hil.core.clock import BenchClock, Order
from hil.drivers.latest import Latest
from hil.errors import DeviceError, LinkLost, LinkTimeout

_END_WAIT_WALL_S: Final = 0.1


class LoopThread:
    """Base of a driver whose wire is served by the coroutine ``_live`` in its own thread.

    A subclass makes a new ``_box`` in each ``open``; the error that ends the thread is stored there. ``_wake`` is an
    event of the thread's event loop, set by ``_call(self._wake.set)``.
    """

    name: str
    _clock: BenchClock
    _box: Latest[Any]
    _thread: threading.Thread | None = None
    _order = Order.DRIVERS
    _loop: asyncio.AbstractEventLoop
    _wake: asyncio.Event
    _closing = False
    """Whether the thread must end; checked by ``_live``, since Python 3.11 may drop a cancellation that coincides with
    a response."""

    def _start(self, bound_s: float) -> None:
        """Start the thread and wait until ``_live`` has opened the wire, at most ``bound_s`` of bench time.

        Raises the error of ``_live``, or LinkTimeout.
        """
        self._closing = False
        self._wake = asyncio.Event()
        self._loop = self._clock.new_event_loop()
        opened: Future[None] = Future()
        ready = self._clock.event()
        opened.add_done_callback(lambda _: ready.set())
        self._thread = self._clock.start_thread(lambda: self._run(opened), f"{self.name}-modbus", self._order)
        if not ready.wait(self._clock.wall_s(bound_s)):
            raise LinkTimeout(self.name, f"not open after {bound_s:g} s")
        opened.result()

    def _end(self) -> None:
        """End the thread; wait for it, at most 0.1 s of wall time. Idempotent.

        ``_live`` is cancelled once: a second cancellation would interrupt the last requests, which stop the device.
        """
        if self._thread is None:
            return
        if not self._closing:
            self._closing = True
            self._call(self._cancel)
        self._clock.join(self._thread, _END_WAIT_WALL_S)
        if not self._thread.is_alive():
            self._thread = None

    def _await_previous_thread(self, bound_s: float) -> None:
        """Wait for the previous thread, which on a busy host may outlast ``_end``.

        Until it has ended nothing that it uses may be replaced. Raises LinkTimeout.
        """
        if self._thread is not None:
            self._clock.join(self._thread, self._clock.wall_s(bound_s))
            if self._thread.is_alive():
                raise LinkTimeout(self.name, f"not closed after {bound_s:g} s")
        self._thread = None

    def _call(self, function: Callable[[], object]) -> None:
        """Schedule ``function`` in the event loop of the thread."""
        with suppress(RuntimeError):  # the event loop has ended; the box holds the error
            self._loop.call_soon_threadsafe(function)

    # The methods below run in the thread.

    async def _live(self, opened: Future[None]) -> None:
        """Open the wire, set the result of ``opened``, serve until ``_closing`` or cancelled."""
        raise NotImplementedError

    def _when_ended(self) -> None:
        """Hook called when the event loop has ended, for any reason."""

    def _run(self, opened: Future[None]) -> None:
        try:
            with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
                runner.run(self._live(opened))
            error: DeviceError = LinkLost(self.name, "the thread of the link has ended")
        except asyncio.CancelledError:
            error = LinkLost(self.name, "is closed")
        except DeviceError as problem:
            error = problem
        except Exception as problem:
            error = LinkLost(self.name, f"the thread of the link died: {problem!r}")
            error.__cause__ = problem
        self._box.fail(error)
        self._when_ended()
        if not opened.done():
            opened.set_exception(error)

    def _cancel(self) -> None:
        for task in asyncio.all_tasks():
            task.cancel()
