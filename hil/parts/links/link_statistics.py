"""Statistics of a link: counts of its datagrams, and the offset of the other host's clock (NTP's four stamps)."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final

_WINDOW: Final = 64  # datagrams before the newest whose arrival is tracked
_HALF: Final = 1 << 31
_WHOLE: Final = 1 << 32
_KEPT: Final = 16
_PLAUSIBLE_S: Final = 60.0  # a longer round trip is discarded


@dataclass(slots=True)
class DatagramStats:
    """Counts of the datagrams of one mailbox by sequence numbers, modulo 2^32.

    received: newest values and reordered ones, without duplicates. lost: numbers missing so far; one that arrives
    late counts as ``reordered`` and no longer as lost.
    """

    received: int = 0
    lost: int = 0
    reordered: int = 0
    duplicates: int = 0
    newest: int = -1
    _seen: int = 0

    def count(self, sequence: int) -> bool:
        """Take account of a datagram; return whether it is newer than all before."""
        if self.newest < 0:
            self.newest, self._seen = sequence, 1
            self.received += 1
            return True
        ahead = (sequence - self.newest + _HALF) % _WHOLE - _HALF
        if ahead > 0:
            self.lost += ahead - 1
            self.newest = sequence
            self._seen = ((self._seen << ahead) | 1) & ((1 << _WINDOW) - 1) if ahead < _WINDOW else 1
            self.received += 1
            return True
        if -ahead < _WINDOW and not (self._seen >> -ahead) & 1:
            self._seen |= 1 << -ahead
            self.received += 1
            self.reordered += 1
            self.lost = max(0, self.lost - 1)
        else:
            self.duplicates += 1
        return False

    def restart(self) -> None:
        """Take the next datagram as the first of another writer; the counts continue."""
        self.newest, self._seen = -1, 0


class ClockOffset:
    """Offset of the other clock against this one, from the exchange with the shortest round trip of the last 16.

    Half the round trip bounds the error, as the two directions cannot differ by more.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, sent_s: float, there_received_s: float, there_sent_s: float, received_s: float) -> None:
        """Add the stamps of an exchange: sent and received by this clock, ``there`` by the other one."""
        round_trip_s = (received_s - sent_s) - (there_sent_s - there_received_s)
        offset_s = ((there_received_s - sent_s) + (there_sent_s - received_s)) / 2.0
        if 0.0 <= round_trip_s <= _PLAUSIBLE_S and math.isfinite(offset_s):
            self._kept.append((round_trip_s, offset_s))

    @property
    def known(self) -> bool:
        return bool(self._kept)

    @property
    def offset_s(self) -> float:
        """The other clock minus this one; nan before the first exchange."""
        return min(self._kept)[1] if self._kept else math.nan

    @property
    def round_trip_s(self) -> float:
        """Round trip of the selected exchange; nan before the first."""
        return min(self._kept)[0] if self._kept else math.nan
