"""One direction of an emulated wire with its faults: what goes in, and when, and in what state, comes out."""

from __future__ import annotations

import heapq
import itertools

import numpy as np

from hil.drivers.fault_injection import Faults, FaultyWire


class FaultyChannel:
    """Packets that are under way. Time is bench time, s, and handed in; packets of one moment keep their order."""

    def __init__(self, faults: Faults, generator: np.random.Generator) -> None:
        self._wire = FaultyWire(faults, generator)
        self._under_way: list[tuple[float, int, bytes]] = []
        self._number = itertools.count()

    def put(self, packet: bytes, now_s: float) -> None:
        """Send one packet."""
        for delay_s, arrived in self._wire.passed(packet):
            heapq.heappush(self._under_way, (now_s + delay_s, next(self._number), arrived))

    def due(self, now_s: float) -> list[bytes]:
        """Return what has arrived by ``now_s``."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= now_s:
            arrived.append(heapq.heappop(self._under_way)[2])
        return arrived
