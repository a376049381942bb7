"""What emulated devices share: where the axes are, for cameras to look at, and whether the drives may have torque."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.clock import WallClock
from hil.core.messages import Array
from hil.frmn.mailbox import MailboxBlock

_AXES: Final = np.dtype([("position", "f8", 3), ("rate", "f8", 3)])
_CHAIN: Final = np.dtype([("closed", "i8")])
_CELLS: Final = {"rails": _AXES, "turntable": _AXES, "target": _AXES, "chain": _CHAIN}
_CHAIN_AGE_WALL_S: Final = 0.25  # a coupler that is silent for longer is dead, and its outputs are off


class SharedAxisState:
    """Positions (3,) and rates (3,) of rails (m) and turntable (rad) at a moment, s of bench time.

    Each device writes its own cell; a device that was killed leaves the last thing it wrote.
    """

    def __init__(self, descriptor: int) -> None:
        self._block = MailboxBlock(descriptor, _CELLS, "axis-board")

    @classmethod
    def create(cls) -> SharedAxisState:
        """Make a new board; hand ``descriptor`` to other processes (``pass_fds``)."""
        board = cls.__new__(cls)
        board._block = MailboxBlock.create(_CELLS, "axis-board")
        return board

    @property
    def descriptor(self) -> int:
        return self._block.descriptor

    def write(self, device: str, t_s: float, position: Array, rate: Array) -> None:
        """Tell where the axes of ``device`` are at ``t_s``."""
        record = np.empty(1, _AXES)
        record["position"][0] = position
        record["rate"][0] = rate
        self._block[device].write(record, t_s)

    def read(self, device: str, t_s: float) -> tuple[Array, Array]:
        """Return position and rate of ``device`` carried on to ``t_s`` by its rate; zeros before its first word."""
        record = np.zeros(1, _AXES)
        _, written_s = self._block[device].read(record)
        rate = record["rate"][0]
        return record["position"][0] + (t_s - written_s) * rate, rate

    def write_chain(self, closed: bool, t_s: float) -> None:
        """Tell whether the safety chain lets the drives have torque."""
        record = np.empty(1, _CHAIN)
        record["closed"] = closed
        self._block["chain"].write(record, t_s)

    def chain_closed(self, clock: WallClock) -> bool:
        """Return the last word on the chain; closed where nobody ever wrote one: a bench without such a device.

        Open where the last word is older than 0.25 s of wall time.
        """
        record = np.zeros(1, _CHAIN)
        number, written_s = self._block["chain"].read(record)
        if number == 0:
            return True
        return bool(record["closed"][0]) and clock.wall_s(clock.now_s() - written_s) <= _CHAIN_AGE_WALL_S

    def close(self) -> None:
        """Let go of the block; idempotent."""
        self._block.close()
