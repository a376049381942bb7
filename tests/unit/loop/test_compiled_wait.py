"""Wait of the rate keeper: punctual, open to signals, and without the interpreter's lock."""

from __future__ import annotations

import signal
import threading
import time

import numpy as np
import pytest

from hil.core.clock import WallClock
from hil.loop.rate_keeper import WallClockRate, wait_until


def test_the_deadline_is_kept_and_never_early() -> None:
    scratch = np.zeros(2, np.int64)
    for sleep_ns, spin_ns in ((3_000_000, 200_000), (100_000, 200_000), (-1_000_000, 0)):
        deadline_ns = time.monotonic_ns() + sleep_ns
        woken_ns = wait_until(deadline_ns, spin_ns, scratch)
        assert deadline_ns <= woken_ns <= time.monotonic_ns()


def test_a_signal_is_handled_during_the_wait() -> None:
    rate = WallClockRate(WallClock(), 20.0)
    rate.restart()
    main = threading.main_thread().ident
    assert main is not None
    before = signal.signal(signal.SIGUSR1, lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
    timer = threading.Timer(0.2, lambda: signal.pthread_kill(main, signal.SIGUSR1))
    timer.start()
    begun_s = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            rate.wait()
    finally:
        signal.signal(signal.SIGUSR1, before)
        timer.join()
    assert time.monotonic() - begun_s < 10.0


def test_other_threads_run_while_the_loop_spins() -> None:
    counted, ending = [0], threading.Event()

    def count() -> None:
        while not ending.is_set():
            counted[0] += 1

    scratch = np.zeros(2, np.int64)
    thread = threading.Thread(target=count)
    thread.start()
    before = counted[0]
    deadline_ns = time.monotonic_ns() + 200_000_000
    wait_until(deadline_ns, 200_000_000, scratch)  # one call into compiled code, all of it a spin
    passed = counted[0] - before
    ending.set()
    thread.join()
    assert passed > 100
