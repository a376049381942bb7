"""Who stands in for a technician at an emulated bench."""

from __future__ import annotations

from hil.drivers.fault_injection import FaultControl
from hil.drivers.shared_state import SharedAxisState


class AutoOperator:
    """Hand and eye of a technician at an emulated bench: the emergency stop's control port, and the axis board."""

    def __init__(self, board: SharedAxisState, addresses: dict[str, str]) -> None:
        self._board = board
        self._addresses = addresses

    def press(self) -> None:
        """Press the emergency stop."""
        self._say("on estop")

    def release(self) -> None:
        """Release it."""
        self._say("off estop")

    def place(self, axis: int, now_s: float) -> float:
        """Return where an axis truly is, m or rad."""
        position, _ = self._board.read("rails" if axis < 3 else "turntable", now_s)
        return float(position[axis % 3])

    def _say(self, line: str) -> None:
        control = FaultControl(self._addresses["io.faults"])
        try:
            control.send(line)
        finally:
            control.close()
