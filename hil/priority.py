"""Asks the operating system for precedence over whatever else this computer does."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_NICE = -15
_SWITCH_INTERVAL_S = 5e-5  # damage limit for the I/O threads that share the loop's interpreter


@contextmanager
def precedence() -> Iterator[str]:
    """Run the body, and threads and processes started in it, at a raised priority if that is allowed.

    Not under a real-time policy: loop, I/O threads and emulators together can fill a core, and the kernel
    then takes 50 ms of each second away from all of them. Gives "" where the priority was raised, otherwise
    a line that says what was refused; the body then runs all the same.
    """
    switch_interval = sys.getswitchinterval()
    before = os.getpriority(os.PRIO_PROCESS, 0)
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    refused = ""
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    except PermissionError:
        refused = "no right to raise the priority (CAP_SYS_NICE, or nice in limits.conf): cycles may come late"
    try:
        yield refused
    finally:
        sys.setswitchinterval(switch_interval)
        if not refused:
            os.setpriority(os.PRIO_PROCESS, 0, before)
