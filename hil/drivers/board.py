"""What emulated devices share: where the axes are, for cameras to look at, and whether the drives may have torque.

A block of anonymous shared memory that dies with its last user. Each device writes its own slot;
a sequence number, odd while a write is under way, lets a reader see that it read a whole slot.
"""

from __future__ import annotations

import mmap
import os
from typing import Final

import numpy as np

from hil.clock import WallClock
from hil.messages import Array

SLOTS: Final = {"rails": 0, "turntable": 1, "chain": 2, "target": 3}
_WORDS: Final = 8  # sequence, t_s, 3 positions, 3 rates
_TRIES: Final = 1000
_CHAIN_AGE_WALL_S: Final = 0.25  # a coupler that is silent for longer is dead, and its outputs are off
_SIZE: Final = len(SLOTS) * _WORDS * 8


class AxisBoard:
    """Positions (3,) and rates (3,) of rails (m) and turntable (rad) at a moment, s of bench time."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._map = mmap.mmap(descriptor, _SIZE)
        self._words = np.frombuffer(self._map, dtype=np.float64).reshape(len(SLOTS), _WORDS)
        self._sequence = np.frombuffer(self._map, dtype=np.int64).reshape(len(SLOTS), _WORDS)[:, 0]

    @classmethod
    def create(cls) -> AxisBoard:
        """Make a new board; hand ``descriptor`` to other processes (``pass_fds``)."""
        descriptor = os.memfd_create("hil-axis-board")
        os.ftruncate(descriptor, _SIZE)
        return cls(descriptor)

    def write(self, device: str, t_s: float, position: Array, rate: Array) -> None:
        slot = SLOTS[device]
        self._sequence[slot] += 1
        self._words[slot, 1] = t_s
        self._words[slot, 2:5] = position
        self._words[slot, 5:8] = rate
        self._sequence[slot] += 1

    def read(self, device: str, t_s: float) -> tuple[Array, Array]:
        """Return position and rate of ``device`` carried on to ``t_s`` by its rate.

        A device that was killed in the middle of a write leaves the slot half written for good; its
        words are then returned as they stand.
        """
        slot = SLOTS[device]
        for _ in range(_TRIES):
            before = self._sequence[slot]
            words = self._words[slot].copy()
            if before % 2 == 0 and before == self._sequence[slot]:
                break
        return words[2:5] + (t_s - words[1]) * words[5:8], words[5:8]

    def write_chain(self, closed: bool, t_s: float) -> None:
        """Tell whether the safety chain lets the drives have torque."""
        self._sequence[SLOTS["chain"]] += 1
        self._words[SLOTS["chain"], 1:3] = t_s, closed
        self._sequence[SLOTS["chain"]] += 1

    def chain_closed(self, clock: WallClock) -> bool:
        """Return the last word on the chain; closed where nobody ever wrote one: a bench without such a device.

        Open where the last word is older than 0.25 s of wall time.
        """
        slot = SLOTS["chain"]
        for _ in range(_TRIES):
            before = self._sequence[slot]
            t_s, closed = self._words[slot, 1:3]
            if before % 2 == 0 and before == self._sequence[slot]:
                break
        if before == 0:
            return True
        return bool(closed) and clock.wall_s(clock.now_s() - t_s) <= _CHAIN_AGE_WALL_S

    def close(self) -> None:
        """Let go of the block; idempotent."""
        if not self._map.closed:
            del self._words, self._sequence
            self._map.close()
            os.close(self.descriptor)
