"""What the bench may be doing, and which changes are allowed."""

from __future__ import annotations

from enum import Enum

from hil.errors import BenchError


class Mode(Enum):
    """OFF: nothing is open. STANDBY: devices open, standing. PLACING: moving to the start pose.
    ARMED: at the start pose, poses come in. RUNNING: the loop is closed. SAFE_STOP: stopped by a
    fault or by the operator; only OFF leads out."""

    OFF = "off"
    STANDBY = "standby"
    PLACING = "placing"
    ARMED = "armed"
    RUNNING = "running"
    SAFE_STOP = "safe-stop"


ALLOWED: dict[Mode, frozenset[Mode]] = {
    Mode.OFF: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.STANDBY: frozenset({Mode.PLACING, Mode.OFF, Mode.SAFE_STOP}),
    Mode.PLACING: frozenset({Mode.ARMED, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.ARMED: frozenset({Mode.RUNNING, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.RUNNING: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.SAFE_STOP: frozenset({Mode.OFF, Mode.SAFE_STOP}),
}


class ModeMachine:
    """Holds the mode and refuses moves that are not in the table."""

    def __init__(self) -> None:
        self.mode = Mode.OFF

    def go(self, to: Mode) -> None:
        """Change to ``to``; raise BenchError where the table does not allow it."""
        if to not in ALLOWED[self.mode]:
            raise BenchError(f"bench: cannot go from {self.mode.value} to {to.value}")
        self.mode = to
