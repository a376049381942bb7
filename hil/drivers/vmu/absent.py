"""Pose source of a bench without a vision unit."""

from __future__ import annotations

from hil.core.messages import PoseFrame
from hil.drivers.vmu import COUNTERS, NAME


class AbsentVmu:
    """Vision unit that is not there: no pose ever comes, and none is missing."""

    name = NAME

    def open(self, now_s: float) -> None:
        """Do nothing."""

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return no poses."""
        return []

    def counters(self) -> dict[str, int]:
        """Return the counters of a vision unit, all 0."""
        return dict.fromkeys(COUNTERS, 0)

    def close(self) -> None:
        """Do nothing."""
