"""Shared state of the emulated devices: positions of the axes, for the cameras, and state of the safety chain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.frmn.mailbox import MailboxBlock

_AXES: Final = np.dtype([("position", "f8", 3), ("rate", "f8", 3), ("given", "?", 3)])
_CHAIN: Final = np.dtype([("closed", "i8"), ("torque", "i8"), ("brakes_released", "i8")])
_SEEN: Final = ("rails", "turntable", "target")  # by cameras and sensors
_PARTS: Final = {group: [f"{group}.{first}" for first in range(3)] for group in _SEEN}
_MAILBOXES: Final = (
    dict.fromkeys(_SEEN, _AXES) | {name: _AXES for names in _PARTS.values() for name in names} | {"chain": _CHAIN}
)
_CHAIN_AGE_WALL_S: Final = 0.25  # largest age of a coupler's state; beyond it its outputs are off


class ChainState(NamedTuple):
    """State of the safety chain.

    closed: the drives may move; once open they make a quick stop. torque: the relay's delayed contacts, without which
    a drive has no torque. brakes_released: the holding brakes have current. thrusters: lines that have power.
    """

    closed: bool = True
    torque: bool = True
    brakes_released: bool = True
    thrusters: bytes = b""


class SharedAxisState:
    """Positions (3,) and rates (3,) of rails (m) and turntable (rad) with their bench time, s.

    Each device writes its own mailbox, which keeps its last value if the device is killed.
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

    def write(self, device: str, t_s: float, position: Array, rate: Array, axes: Sequence[int] = (0, 1, 2)) -> None:
        """Write position and rate of the axes of ``device`` at ``t_s``. axes: numbers of those of its part.

        Axes that nothing sees are not written.
        """
        group = device.partition(".")[0]
        if group not in _SEEN:
            return
        record, which = np.zeros(1, _AXES), list(axes)
        record["position"][0, which], record["rate"][0, which], record["given"][0, which] = position, rate, True
        self._block[group if len(axes) == 3 else f"{group}.{axes[0]}"].write(record, t_s)

    def read(self, device: str, t_s: float) -> tuple[Array, Array]:
        """Return position and rate of ``device`` extrapolated to ``t_s``; zeros before its first write."""
        record = np.zeros(1, _AXES)
        number, written_s = self._block[device].read(record)
        rate = record["rate"][0]
        position = record["position"][0] + (t_s - written_s) * rate
        if number:
            return position, rate
        for name in _PARTS[device]:  # of a group on several controllers
            part = np.zeros(1, _AXES)
            _, written_s = self._block[name].read(part)
            given, moving = part["given"][0], part["rate"][0]
            position = np.where(given, part["position"][0] + (t_s - written_s) * moving, position)
            rate = np.where(given, moving, rate)
        return position, rate

    def write_chain(self, chain: ChainState, t_s: float) -> None:
        """Write the state of the safety chain."""
        record = np.empty(1, _CHAIN)
        record[0] = chain[:3]
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
