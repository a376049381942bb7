"""Technician of an emulated rig, who acts by himself."""

from __future__ import annotations

from hil.parts.emulation.fault_injection import FaultControl
from hil.parts.emulation.shared_state import SharedAxisState


class AutoOperator:
    """Presses the emergency stop through its control port, and reads true positions from the shared axis state."""

    def __init__(self, state: SharedAxisState, addresses: dict[str, str]) -> None:
        self._state = state
        self._addresses = addresses

    def press(self) -> None:
        """Press the emergency stop."""
        self._send("on estop")

    def release(self) -> None:
        """Release the emergency stop."""
        self._send("off estop")

    def position(self, axis: int, now_s: float) -> float:
        """Return the true position of an axis, m or rad."""
        position, _ = self._state.read("rails" if axis < 3 else "turntable", now_s)
        return float(position[axis % 3])

    def _send(self, line: str) -> None:
        control = FaultControl(self._addresses["io.faults"])
        try:
            control.send(line)
        finally:
            control.close()
