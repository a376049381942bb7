"""Threads of a bench in lock-step that wait as it ends."""

from __future__ import annotations

import pytest

from hil.core.clock import Order
from hil.parts.emulation.lock_step import LockStepConductor

FAR_NS = 10**12


def test_thread_that_waits_as_the_bench_ends_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, found = LockStepConductor(0.02, 5.0), list[bool]()
    # as it calls the loop the bench ends, whose descriptors are gone
    monkeypatch.setattr("hil.parts.emulation.lock_step.os.eventfd_write", lambda *_: clock.close())
    clock.start_thread(lambda: found.append(clock.wait_until_ns(FAR_NS)), "waits", Order.DRIVERS).join(5.0)
    assert found == [True]
