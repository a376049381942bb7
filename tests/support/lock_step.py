"""Benches of tests in lock-step: the test's thread is the loop, and nothing in them depends on the wall clock."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hil.core.child_process import Service
from hil.core.clock import Order
from hil.parts.emulation.lock_step import LockStepConductor

GRID_S = 0.02


@contextmanager
def in_lock_step(timeout_s: float = 30.0) -> Iterator[LockStepConductor]:
    """Give a clock whose time passes in the waits of this thread."""
    clock = LockStepConductor(GRID_S, timeout_s)
    try:
        yield clock
    finally:
        clock.close()


@contextmanager
def serving(
    clock: LockStepConductor, service: Service, order: Order = Order.AXES, stop: threading.Event | None = None
) -> Iterator[None]:
    """Run a started service, as an emulator, in a thread; close it afterwards. stop: ends it before that."""
    ended = stop or threading.Event()
    thread = clock.start_thread(lambda: service.run(ended), type(service).__name__, order)
    try:
        yield
    finally:
        ended.set()
        clock.join(thread, 5.0)
        service.close()
