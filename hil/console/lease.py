"""Command lease: one operator commands, the others watch. Time is an argument."""

from __future__ import annotations

import math
from dataclasses import dataclass


class RequestRejected(Exception):
    """Rejected request of a client; the text is the reason sent to it."""


@dataclass(slots=True)
class Lease:
    """Right to command, held by one client while it sends a message at least every ``timeout_s``.

    key: secret of the client; name: of its operator. An expired lease is free; its holder must acquire it again.
    """

    timeout_s: float
    key: str = ""
    name: str = ""
    last_rx_s: float = -math.inf

    @property
    def held(self) -> bool:
        return bool(self.key)

    def silent_s(self, now_s: float) -> float:
        """Return the time since the last message of the holder."""
        return now_s - self.last_rx_s

    def acquire(self, key: str, name: str, now_s: float) -> None:
        """Acquire a free lease, or renew the client's own; raise RequestRejected if another client holds it."""
        if self.held and self.key != key:
            raise RequestRejected(f"{self.name} has the command: watch, or take it over")
        self.key, self.name, self.last_rx_s = key, name, now_s

    def take_over(self, key: str, name: str, now_s: float) -> str:
        """Take the lease over; return the name of the previous holder, "" if it was free or the client's own."""
        before = self.name if self.held and self.key != key else ""
        self.key, self.name, self.last_rx_s = key, name, now_s
        return before

    def renew(self, key: str, now_s: float) -> None:
        """Renew the lease after a message of ``key``; no effect for a client that does not hold it."""
        if self.held and self.key == key:
            self.last_rx_s = now_s

    def release(self, key: str) -> None:
        """Release the lease if ``key`` holds it."""
        if self.key == key:
            self.key = self.name = ""

    def expire(self, now_s: float) -> str:
        """Release the lease if its holder has timed out; return the holder's name, else ""."""
        if not self.held or self.silent_s(now_s) <= self.timeout_s:
            return ""
        name = self.name
        self.key = self.name = ""
        return name

    def require(self, key: str) -> None:
        """Raise RequestRejected if ``key`` may not command."""
        if self.key == key and self.held:
            return
        holder = self.name if self.held else "no operator"
        raise RequestRejected(f"{holder} has the command: take it before sending orders")
