"""What the rails' driver makes of the drives' homing bits and limit switches. No I/O."""

from __future__ import annotations

from hil.config.rig import RAIL_NAMES, Rails
from hil.core.messages import Homing
from hil.drivers.rails.codec import State, Status


class HomingWatch:
    """How far the homing of each axis is. Axes with absolute encoders are at DONE from the beginning.

    An axis that has been told to seek (``begin``) is UNDER_WAY until its drive says homed, or failed; the
    drive's "failed" of an earlier search counts no more once it was told to seek anew.
    """

    def __init__(self, config: Rails) -> None:
        self._absolute = [getattr(config, name).encoder == "absolute" for name in RAIL_NAMES]
        self.state = [Homing.DONE if known else Homing.NEEDED for known in self._absolute]
        self._told = [0, 0, 0]  # exchanges since the search began

    def begin(self) -> None:
        """Let each axis that does not know its place seek its home switch."""
        for axis, homing in enumerate(self.state):
            if homing in (Homing.NEEDED, Homing.FAILED):
                self.state[axis] = Homing.UNDER_WAY
                self._told[axis] = 0

    def abort(self) -> None:
        """Give every search that is under way up."""
        for axis, homing in enumerate(self.state):
            if homing is Homing.UNDER_WAY:
                self.state[axis] = Homing.FAILED

    def seeks(self, axis: int) -> bool:
        """Whether the drive is to be told to seek."""
        return self.state[axis] is Homing.UNDER_WAY

    def heard(self, axis: int, state: State, told: bool) -> bool:
        """Take what the drive says; return whether its zero has just moved. told: the command said to seek."""
        if self._absolute[axis]:
            return False
        before = self.state[axis]
        if before is Homing.UNDER_WAY:
            self._told[axis] += told
            if not told:
                return False
            if state.status & Status.HOMING_FAILED and self._told[axis] > 1:
                self.state[axis] = Homing.FAILED
            elif state.status & Status.HOMED:
                self.state[axis] = Homing.DONE
        elif state.status & Status.HOMED and before is Homing.NEEDED:
            self.state[axis] = Homing.DONE  # from an earlier run, and the drive was not off since
        elif not state.status & Status.HOMED and before is Homing.DONE:
            self.state[axis] = Homing.NEEDED  # the drive was off
        return self.state[axis] is not before


def limit_switch(status: Status, position_m: float, middle_m: float) -> int:
    """Return the limit switch that an axis stands on: -1 low, 1 high, 0 none.

    A drive that does not tell which one it is stands on the one nearer to its position.
    """
    if status & Status.LIMIT_LOW:
        return -1
    if status & Status.LIMIT_HIGH:
        return 1
    if status & Status.LIMIT:
        return -1 if position_m < middle_m else 1
    return 0
