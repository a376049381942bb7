"""Shared state of the emulated devices: positions of the axes, for the cameras, and state of the safety chain."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.frmn.mailbox import MailboxBlock

_AXES: Final = np.dtype([("position", "f8", 3), ("rate", "f8", 3)])
_CHAIN: Final = np.dtype([("closed", "i8"), ("torque", "i8"), ("brakes_released", "i8")])
_MAILBOXES: Final = {"rails": _AXES, "turntable": _AXES, "target": _AXES, "chain": _CHAIN}
_CHAIN_AGE_WALL_S: Final = 0.25  # of a coupler; its outputs are off when it is older


class ChainState(NamedTuple):
    """State of the safety chain.

    closed: the drives may move; once open they make a quick stop. torque: the relay's delayed contacts, without which
    a drive has no torque. brakes_released: the holding brakes have current.
    """

    closed: bool = True
    torque: bool = True
    brakes_released: bool = True


class SharedAxisState:
    """Positions (3,) and rates (3,) of rails (m) and turntable (rad) with their bench time, s.

    Each device writes its own mailbox; that of a killed device keeps its last value.
    """

    def __init__(self, descriptor: int) -> None:
        self._block = MailboxBlock(descriptor, _MAILBOXES, "axis-board")

    @classmethod
    def create(cls) -> SharedAxisState:
        """Create the shared state; ``descriptor`` is passed to other processes (``pass_fds``)."""
        created = cls.__new__(cls)
        created._block = MailboxBlock.create(_MAILBOXES, "axis-board")
        return created

    @property
    def descriptor(self) -> int:
        return self._block.descriptor

    def write(self, device: str, t_s: float, position: Array, rate: Array) -> None:
        """Write position and rate of the axes of ``device`` at ``t_s``."""
        record = np.empty(1, _AXES)
        record["position"][0] = position
        record["rate"][0] = rate
        self._block[device].write(record, t_s)

    def read(self, device: str, t_s: float) -> tuple[Array, Array]:
        """Return position and rate of ``device`` extrapolated to ``t_s``; zeros before its first write."""
        record = np.zeros(1, _AXES)
        _, written_s = self._block[device].read(record)
        rate = record["rate"][0]
        return record["position"][0] + (t_s - written_s) * rate, rate

    def write_chain(self, chain: ChainState, t_s: float) -> None:
        """Write the state of the safety chain."""
        record = np.empty(1, _CHAIN)
        record[0] = chain
        self._block["chain"].write(record, t_s)

    def read_chain(self, clock: BenchClock) -> ChainState:
        """Return the state of the chain; closed if it was never written: a bench without such a device.

        Open if the state is older than 0.25 s of wall time.
        """
        record = np.zeros(1, _CHAIN)
        number, written_s = self._block["chain"].read(record)
        if number == 0:
            return ChainState()
        if clock.wall_s(clock.now_s() - written_s) > _CHAIN_AGE_WALL_S:
            return ChainState(False, False, False)
        closed, torque, brakes_released = record[0].item()
        return ChainState(bool(closed), bool(torque), bool(brakes_released))

    def close(self) -> None:
        """Release the memory. Idempotent."""
        self._block.close()
