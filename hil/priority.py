"""Asks the operating system for precedence over whatever else this computer does."""

from __future__ import annotations

import os
import sys

_NICE = -15
_SWITCH_INTERVAL_S = 5e-5  # damage limit for the I/O threads that share the loop's interpreter


def ask_for_precedence() -> bool:
    """Raise this process' priority; return False where that is not allowed (the run then goes on without)."""
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        os.setpriority(os.PRIO_PROCESS, 0, _NICE)
    except PermissionError:
        return False
    return True
