"""How far another host's clock is from this one's: NTP's four stamps, the best of the last exchanges."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

_KEPT: Final = 16
_PLAUSIBLE_S: Final = 60.0  # a round trip beyond this is no measurement


class ClockOffset:
    """The offset of the other clock against this one, from the exchange with the least round trip of the last 16.

    Half the round trip bounds the error: the ways there and back may differ by no more than that.
    """

    def __init__(self) -> None:
        self._kept: deque[tuple[float, float]] = deque(maxlen=_KEPT)

    def add(self, sent_s: float, there_received_s: float, there_sent_s: float, received_s: float) -> None:
        """Take the stamps of an exchange: sent and received by this clock, what is ``there`` by the other one."""
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
        """Of the exchange that counts; nan before the first."""
        return min(self._kept)[0] if self._kept else math.nan
