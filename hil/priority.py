"""Asks the operating system for precedence over whatever else this computer does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_REAL_TIME_PRIORITY = 20  # of 1..99; round robin, so that loop and emulators on one core take turns
_SWITCH_INTERVAL_S = 5e-5  # damage limit for the I/O threads that share the loop's interpreter


@contextmanager
def precedence() -> Iterator[str]:
    """Run the body, and threads and processes started in it, under the real-time scheduler if that is allowed.

    Gives "" where it was, otherwise a line that says what was refused; the body then runs all the same.
    """
    switch_interval = sys.getswitchinterval()
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    refused = ""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_REAL_TIME_PRIORITY))
    except PermissionError:
        refused = "no right to real-time scheduling (CAP_SYS_NICE, or rtprio in limits.conf): cycles may come late"
    try:
        yield refused
    finally:
        sys.setswitchinterval(switch_interval)
        if not refused:
            os.sched_setscheduler(0, policy, parameter)
