"""Real-time privileges that the operating system grants to a process of this user, requested by a child process."""

from __future__ import annotations

from dataclasses import dataclass

from hil.core.child_process import ChildProcess
from hil.errors import DeviceError

_TIMEOUT_S = 20.0


@dataclass(frozen=True, slots=True)
class Privileges:
    """Reasons of refusal as the operating system gives them; "" for a privilege that was granted."""

    fifo_refused: str
    memory_lock_refused: str


def probe_privileges() -> Privileges:
    """Return what a child of this process is refused."""
    try:
        with ChildProcess("privileges probe", "hil.processes.privileges_probe", {}) as child:
            return Privileges(**child.receive(_TIMEOUT_S))
    except DeviceError as error:
        return Privileges(*[f"could not be tried: {error}"] * 2)
