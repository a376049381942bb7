"""Modes of the bench and the allowed transitions between them (diagram in docs/explanation/safety.md)."""

from __future__ import annotations

from enum import Enum

from hil.core.observable import ObservableList
from hil.errors import BenchError


class Mode(Enum):
    """Mode of the bench.

    OFF: no device is open. STANDBY: devices open, axes at rest. HOMING: axes move to their home switches.
    JOGGING: one axis moves slowly while a key is held. PLACING: moving to the start pose. ARMED: at the
    start pose, poses are received. RUNNING: the loop is closed. PARKING: moving to the park position.
    HOLD: axes brought to rest during PLACING or RUNNING, the run's time is held. SAFE_STOP: stopped by a fault
    or by the operator; leads to OFF only.
    """

    OFF = "off"
    STANDBY = "standby"
    HOMING = "homing"
    JOGGING = "jogging"
    PLACING = "placing"
    ARMED = "armed"
    RUNNING = "running"
    PARKING = "parking"
    HOLD = "hold"
    SAFE_STOP = "safe-stop"


AT_REST = frozenset({Mode.OFF, Mode.STANDBY, Mode.ARMED, Mode.HOLD, Mode.SAFE_STOP})
"""Modes without motion of the axes."""

ALLOWED: dict[Mode, frozenset[Mode]] = {
    Mode.OFF: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.STANDBY: frozenset({Mode.HOMING, Mode.JOGGING, Mode.PLACING, Mode.PARKING, Mode.OFF, Mode.SAFE_STOP}),
    Mode.HOMING: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.JOGGING: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.PLACING: frozenset({Mode.ARMED, Mode.HOLD, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.ARMED: frozenset({Mode.RUNNING, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.RUNNING: frozenset({Mode.HOLD, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.PARKING: frozenset({Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.HOLD: frozenset({Mode.PLACING, Mode.RUNNING, Mode.STANDBY, Mode.SAFE_STOP}),
    Mode.SAFE_STOP: frozenset({Mode.OFF, Mode.SAFE_STOP}),
}


class ModeMachine:
    """Present mode; rejects transitions that are not in the table.

    A hold leads back only to the mode that it interrupted: it cannot bypass arming.
    """

    def __init__(self) -> None:
        self.mode = Mode.OFF
        self.history: ObservableList[Mode] = ObservableList([Mode.OFF])
        """All modes so far, the present one last."""
        self.held_from: Mode | None = None

    def go(self, to: Mode) -> None:
        """Change to ``to``; raise BenchError if the table does not allow it."""
        past_arming = self.mode is Mode.HOLD and to in (Mode.PLACING, Mode.RUNNING) and to is not self.held_from
        if to not in ALLOWED[self.mode] or past_arming:
            raise BenchError(f"bench: cannot go from {self.mode.value} to {to.value}")
        self.held_from = self.mode if to is Mode.HOLD else None
        self.mode = to
        self.history.append(to)
