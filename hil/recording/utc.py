"""Times of day, for names and catalogue."""

from __future__ import annotations

import time
from datetime import UTC, datetime


def utc_ns() -> int:
    """Return nanoseconds since 1970, UTC."""
    return time.time_ns()


def utc_text(time_ns: int | None = None) -> str:
    """Return ``2026-03-01T14:05:06.123Z`` of ``time_ns``, by default of now; texts sort as their times do."""
    moment = datetime.fromtimestamp((utc_ns() if time_ns is None else time_ns) * 1e-9, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
