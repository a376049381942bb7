"""Command lease: one operator commands, the others watch. Time is an argument."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol


class RequestRejected(Exception):
    """Rejected request of a client; the text is the reason sent to it."""


class Commander(Protocol):
    """Client that may have the command. key: its secret, or that of its operator; number: of its connection."""

    key: str
    name: str
    number: int


@dataclass(slots=True)
class Lease:
    """Right to command, held by one connection while it sends a message at least every ``timeout_s``.

    key, name: of its client. number: of the connection, 0 once that is closed; the lease then runs on until it expires,
    and a new connection with the same key reclaims it. Another one with that key (a duplicated tab) does not hold
    it. An expired lease is free; its holder must acquire it again.
    """

    timeout_s: float
    key: str = ""
    name: str = ""
    number: int = 0
    last_rx_s: float = -math.inf

    @property
    def held(self) -> bool:
        return bool(self.key)

    def held_by(self, client: Commander) -> bool:
        """Return whether the connection of ``client`` holds the lease."""
        return self.held and self.number == client.number

    def silent_s(self, now_s: float) -> float:
        """Return the time since the last message of the holder."""
        return now_s - self.last_rx_s

    def acquire(self, client: Commander, now_s: float) -> None:
        """Acquire a free lease, or renew the client's own; raise RequestRejected if another client holds it."""
        if self.held and not self.held_by(client) and (self.number or self.key != client.key):
            at = " at another page" if self.key == client.key else ""
            raise RequestRejected(f"{self.name} has the command{at}: watch, or take it over")
        self._give(client, now_s)

    def take_over(self, client: Commander, now_s: float) -> str:
        """Take the lease over; return the name of the previous holder, "" if it was free or the client's own."""
        before = self.name if self.held and not self.held_by(client) else ""
        self._give(client, now_s)
        return before

    def _give(self, client: Commander, now_s: float) -> None:
        self.key, self.name, self.number, self.last_rx_s = client.key, client.name, client.number, now_s

    def renew(self, client: Commander, now_s: float) -> None:
        """Renew the lease after a message of ``client``; no effect for one that does not hold it."""
        if self.held_by(client):
            self.last_rx_s = now_s

    def close(self, client: Commander) -> None:
        """Note that the connection of ``client`` is closed."""
        if self.held_by(client):
            self.number = 0

    def reclaim(self, client: Commander, now_s: float) -> None:
        """Give the lease of a closed connection to the new one with the same key."""
        if self.held and not self.number and self.key == client.key:
            self._give(client, now_s)

    def release(self, client: Commander) -> None:
        """Release the lease if ``client`` holds it."""
        if self.held_by(client):
            self._free()

    def expire(self, now_s: float) -> str:
        """Release the lease if its holder has timed out; return the holder's name, else ""."""
        if not self.held or self.silent_s(now_s) <= self.timeout_s:
            return ""
        name = self.name
        self._free()
        return name

    def require(self, client: Commander) -> None:
        """Raise RequestRejected if ``client`` may not command."""
        if self.held_by(client):
            return
        holder = self.name if self.held else "no operator"
        raise RequestRejected(f"{holder} has the command: take it before sending orders")

    def _free(self) -> None:
        self.key = self.name = ""
        self.number = 0
