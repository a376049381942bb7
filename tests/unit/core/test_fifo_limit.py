"""Real-time priority that ends when a thread works for longer than it should."""

import os
import subprocess
import sys

import pytest

BUSY = """
import os, time
from hil.core.realtime import limit_fifo, take_fifo
limit_fifo(0.02)
take_fifo(1)
before = os.sched_getscheduler(0)
end = time.thread_time() + 0.2
while time.thread_time() < end: pass
after = os.sched_getscheduler(0)
take_fifo(1)
for _ in range(20):
    end = time.thread_time() + 0.005
    while time.thread_time() < end: pass
    time.sleep(0.001)
print(before == os.SCHED_FIFO, after == os.SCHED_OTHER, os.sched_getscheduler(0) == os.SCHED_FIFO)
"""


def test_a_thread_that_works_too_long_loses_its_real_time_priority_and_a_short_one_keeps_it() -> None:
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
    except PermissionError:
        pytest.skip("SCHED_FIFO is not permitted")
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    found = subprocess.run([sys.executable, "-c", BUSY], capture_output=True, text=True, timeout=30, check=True)
    assert found.stdout.split() == ["True"] * 3, found.stdout
