"""What the operating system grants to a process of this user, tried out in a process that ends at once.

``python -m hil.preflight.privileges`` is that process: it asks as a run does and prints what was refused;
whatever it got ends with it.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import dataclass

from hil.core.realtime import FIFO, MEMORY, RealTime

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


if __name__ == "__main__":
    with RealTime() as asked:
        refused = {grant.name: grant.detail for grant in asked.refused()}
    json.dump({"fifo": refused.get(FIFO, ""), "memory_lock": refused.get(MEMORY, "")}, sys.stdout)
