"""Freshness of what an operator sends: nothing acts later than the operator meant it.

Each request that may move the bench carries ``seen_s``: the console's time of the newest update that the page had drawn
when the operator acted, sent back as it was received and never extrapolated. Its age at the console includes the way of
that update, the operator's act and the way back, whatever the network between has held. A request older than ``ACT_S``
is refused; one that waits in the session is not executed after that age either. A jog ends ``JOG_HOLD_S`` after the
update that the page had drawn when its key was last held; the release of the key ends it at once. STOP and HOLD are
never refused for their age. A program that is no page may send requests without ``seen_s``, and answers for the time
that its messages take. All times are wall-clock times of the console's computer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from hil.parts.console.lease import RequestRejected

ACT_S: Final = 0.5
JOG_HOLD_S: Final = 0.4
JOG_ROUND_TRIP_S: Final = 0.25
"""Longest round trip with which a page jogs: its updates, frames and key messages take the rest of ``JOG_HOLD_S``."""
MOVING: Final = frozenset({"open", "order", "second", "reply", "jog", "adjust"})
"""Requests that may move the bench, or change how it moves."""


def deadline_of(request: Mapping[str, Any], now_s: float) -> float:
    """Return until when a request may act; raise RequestRejected if that has passed, or without a valid ``seen_s``."""
    seen_s: Any = request.get("seen_s")
    is_number = isinstance(seen_s, int | float) and not isinstance(seen_s, bool)
    if not (is_number and -math.inf < seen_s <= now_s):
        raise RequestRejected(f"{_what(request)}: seen_s {seen_s!r}: required is wall_s of the newest update")
    age_s, limit_s = now_s - seen_s, JOG_HOLD_S if request.get("do") == "jog" else ACT_S
    if age_s > limit_s:
        text = f"is not executed: it was given {age_s:.1f} s ago, allowed {limit_s:g} s"
        raise RequestRejected(f"{_what(request)} {text}: the connection delayed it")
    return float(seen_s) + limit_s


def require_order(request: Mapping[str, Any], last: int) -> int:
    """Return the number of a request, which must be above that of the ``last`` one of its connection."""
    number = request.get("number")
    if not isinstance(number, int) or isinstance(number, bool) or number <= last:
        raise RequestRejected(f"{_what(request)}: number {number!r}: required is one above {last}")
    return number


def _what(request: Mapping[str, Any]) -> str:
    return str(request.get("order") if request.get("do") in ("order", "second") else request.get("do"))
