"""The command lease: one operator commands, the others watch. Time is an argument."""

from __future__ import annotations

import math
from dataclasses import dataclass


class LeaseRefused(Exception):
    """What was asked for is not done; the text says why, to the one who asked."""


@dataclass(slots=True)
class Lease:
    """Held by one client as long as it is heard at least every ``lasts_s``; ``key`` knows the client, ``name`` people.

    A lease that has run out is held by nobody: whoever had it takes it again in so many words.
    """

    lasts_s: float
    key: str = ""
    name: str = ""
    heard_s: float = -math.inf

    @property
    def held(self) -> bool:
        return bool(self.key)

    def silent_s(self, now_s: float) -> float:
        """Return for how long the holder has been silent."""
        return now_s - self.heard_s

    def take(self, key: str, name: str, now_s: float) -> None:
        """Take a lease that is free, or go on with one's own; Refused where another one holds it."""
        if self.held and self.key != key:
            raise LeaseRefused(f"{self.name} has the command: watch, or take it over")
        self.key, self.name, self.heard_s = key, name, now_s

    def take_over(self, key: str, name: str, now_s: float) -> str:
        """Take the lease from whoever holds it; return that one's name, "" where it was free or one's own."""
        before = self.name if self.held and self.key != key else ""
        self.key, self.name, self.heard_s = key, name, now_s
        return before

    def renew(self, key: str, now_s: float) -> None:
        """The client ``key`` was heard; of no effect for one who does not hold the lease."""
        if self.held and self.key == key:
            self.heard_s = now_s

    def release(self, key: str) -> None:
        """Give the lease back."""
        if self.key == key:
            self.key = self.name = ""

    def expire(self, now_s: float) -> str:
        """Let the lease go where its holder has been silent for too long; return the name, "" otherwise."""
        if not self.held or self.silent_s(now_s) <= self.lasts_s:
            return ""
        name = self.name
        self.key = self.name = ""
        return name

    def require(self, key: str) -> None:
        """Raise Refused where ``key`` may not command."""
        if self.key == key and self.held:
            return
        who = f"{self.name} has the command" if self.held else "nobody has the command"
        raise LeaseRefused(f"{who}: take it before you order anything")
