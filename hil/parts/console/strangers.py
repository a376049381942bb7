"""Bounds on clients that have not authenticated: how many at a time, and how often an address guesses the token.

Time is an argument. An address is that of the other computer, without its port.
"""

from __future__ import annotations

import hmac
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Generic, TypeVar

from hil.core.operator_keys import OperatorKey
from hil.parts.console.lease import RequestRejected

_TYPING_ERRORS: Final = 2
_FIRST_PAUSE_S: Final = 0.5
_LONGEST_PAUSE_S: Final = 30.0
_DOUBLINGS_MAX: Final = 16
_ADDRESSES_MAX: Final = 1024

T = TypeVar("T")


@dataclass(frozen=True)
class Access:
    """Requirement of each client: a key of ``operators``, by their ids, or else ``token``, None for none."""

    token: str | None = None
    operators: Mapping[str, OperatorKey] = field(default_factory=dict)


class FairSlots(Generic[T]):
    """At most ``most`` occupants; a newcomer displaces the oldest one of the address that has most of them.

    So one address cannot keep another one out.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._occupants: dict[T, str] = {}  # in the order of arrival

    def __len__(self) -> int:
        return len(self._occupants)

    def enter(self, newcomer: T, address: str) -> T | None:
        """Add ``newcomer``; return the occupant that is displaced, if any."""
        self._occupants[newcomer] = address
        if len(self._occupants) <= self._most:
            return None
        fullest = Counter(self._occupants.values()).most_common(1)[0][0]
        displaced = next(each for each, of in self._occupants.items() if of == fullest)
        self.leave(displaced)
        return displaced

    def leave(self, occupant: T) -> None:
        """Remove ``occupant``; no effect if it was displaced."""
        self._occupants.pop(occupant, None)


class GuessLimiter:
    """Checks the token of clients. The right one is accepted at any time: guesses of the same address, as behind a
    tunnel, keep no operator out. A wrong one is answered by a pause, from the third of its address on: 0.5 s, doubled
    by each further one, 30 s at most.
    """

    def __init__(self, token: str) -> None:
        self._token = token.encode()
        self._wrong: dict[str, tuple[int, float]] = {}  # number of wrong tokens, end of the pause

    def check(self, given: str, address: str, now_s: float) -> None:
        """Raise RequestRejected for a wrong token."""
        if hmac.compare_digest(given.encode(errors="replace"), self._token):
            self._wrong.pop(address, None)
            return
        if pause_s := self.pause_s(address, now_s):
            raise RequestRejected(f"wrong tokens came from this address: try again in {pause_s:.1f} s")
        self.failed(address, now_s)
        raise RequestRejected("wrong token")

    def pause_s(self, address: str, now_s: float) -> float:
        """Return the time for which wrong tokens of ``address`` are not counted."""
        return max(0.0, self._wrong.get(address, (0, 0.0))[1] - now_s)

    def failed(self, address: str, now_s: float) -> None:
        """Count a wrong token of ``address``."""
        count = self._wrong.pop(address, (0, 0.0))[0]
        while len(self._wrong) >= _ADDRESSES_MAX:
            del self._wrong[next(iter(self._wrong))]
        count += 1
        doublings = min(count - _TYPING_ERRORS - 1, _DOUBLINGS_MAX)
        pause_s = min(_LONGEST_PAUSE_S, _FIRST_PAUSE_S * 2.0**doublings) if doublings >= 0 else 0.0
        self._wrong[address] = (count, now_s + pause_s)
