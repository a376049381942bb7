"""Homing state machine and limit switches of the rails. No I/O."""

from __future__ import annotations

from hil.config.rig import LinearAxes
from hil.core.messages import Homing
from hil.drivers.rails.codec import State, Status


class HomingMonitor:
    """Homing state of each axis. Axes with absolute encoders are DONE from the start.

    From ``begin`` an axis is UNDER_WAY until its drive reports homed or failed; "failed" of an earlier homing is
    ignored.
    """

    def __init__(self, config: LinearAxes) -> None:
        self._absolute = [axis.encoder == "absolute" for axis in config.axes]
        self.state = [Homing.DONE if known else Homing.NEEDED for known in self._absolute]
        self._exchanges = [0] * len(self.state)  # since homing was commanded

    def begin(self) -> None:
        """Start homing of each axis that is not homed."""
        for axis, homing in enumerate(self.state):
            if homing in (Homing.NEEDED, Homing.FAILED):
                self.state[axis] = Homing.UNDER_WAY
                self._exchanges[axis] = 0

    def abort(self) -> None:
        """Abort homing that is under way."""
        for axis, homing in enumerate(self.state):
            if homing is Homing.UNDER_WAY:
                self.state[axis] = Homing.FAILED

    def is_homing(self, axis: int) -> bool:
        """Whether the homing bit must be set in the command."""
        return self.state[axis] is Homing.UNDER_WAY

    def update(self, axis: int, state: State, commanded: bool) -> bool:
        """Update from a state of the drive; return whether its zero has just moved. commanded: homing bit was set."""
        if self._absolute[axis]:
            return False
        before = self.state[axis]
        if before is Homing.UNDER_WAY:
            self._exchanges[axis] += commanded
            if not commanded:
                return False
            if state.status & Status.HOMING_FAILED and self._exchanges[axis] > 1:
                self.state[axis] = Homing.FAILED
            elif state.status & Status.HOMED:
                self.state[axis] = Homing.DONE
        elif state.status & Status.HOMED and before is Homing.NEEDED:
            self.state[axis] = Homing.DONE  # homed in an earlier run, not switched off since
        elif not state.status & Status.HOMED and before is Homing.DONE:
            self.state[axis] = Homing.NEEDED  # the drive was switched off
        return self.state[axis] is not before


def limit_switch(status: Status, position_m: float, middle_m: float) -> int:
    """Return the limit switch that is active: -1 low, 1 high, 0 none.

    If the drive reports one without its side, the one nearer to the position is meant.
    """
    if status & Status.LIMIT_LOW:
        return -1
    if status & Status.LIMIT_HIGH:
        return 1
    if status & Status.LIMIT:
        return -1 if position_m < middle_m else 1
    return 0
