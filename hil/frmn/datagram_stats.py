"""What became of the datagrams of one cell: which are new, which were lost on the way, came late or twice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

_WINDOW: Final = 64  # datagrams before the newest of which it is known whether they came
_HALF: Final = 1 << 31
_WHOLE: Final = 1 << 32


@dataclass(slots=True)
class DatagramStats:
    """Counts by sequence numbers, modulo 2^32. received == newest values + reordered; duplicates apart.

    lost: numbers that have not come, so far: one that comes late after all is ``reordered`` and lost no more.
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
        """Let the next datagram be the first of another writer; the counts go on."""
        self.newest, self._seen = -1, 0
