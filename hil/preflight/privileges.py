"""What the operating system grants to a process of this user, tried out in a process that ends at once.

``python -m hil.preflight.privileges`` is that process: it takes each privilege and prints what was refused;
whatever it got ends with it.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import sys
from dataclasses import dataclass

PRIORITY = 80
_MCL_CURRENT_AND_FUTURE = 3
_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True)
class Privileges:
    """What was refused, in the system's words; "" where it was granted."""

    fifo_refused: str
    memory_lock_refused: str


def probe_privileges() -> Privileges:
    """Return what a child of this process gets."""
    program = [sys.executable, "-m", "hil.preflight.privileges"]
    try:
        done = subprocess.run(program, capture_output=True, text=True, timeout=_TIMEOUT_S, check=True)
        found = json.loads(done.stdout)
        return Privileges(found["fifo"], found["memory_lock"])
    except (OSError, ValueError, KeyError, subprocess.SubprocessError) as error:
        return Privileges(*[f"could not be tried: {error}"] * 2)


def take_fifo() -> str:
    """Put this thread under SCHED_FIFO; return what was refused, "" where it was granted."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (OSError, AttributeError) as error:
        return str(error)
    return ""


def take_memory_lock() -> str:
    """Lock the memory of this process; return what was refused, "" where it was granted."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        if libc.mlockall(_MCL_CURRENT_AND_FUTURE) != 0:
            return os.strerror(ctypes.get_errno())
    except (OSError, AttributeError) as error:
        return str(error)
    return ""


if __name__ == "__main__":
    json.dump({"fifo": take_fifo(), "memory_lock": take_memory_lock()}, sys.stdout)
