"""One page, as the console knows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

from hil.console.rows import Cursor

UNREAD_AT_MOST: Final = 20
"""Messages that may be on their way to a page: about a second."""


@dataclass(slots=True)
class Client:
    """One page. key: its secret, by which the lease knows it; name: by which people do."""

    key: str
    name: str
    cursor: Cursor = field(default_factory=Cursor)
    page_seen: int = -1
    camera: str = ""
    """Whose pictures it wants; "" for any."""
    picture_seen: int = 0
    portions_seen: int = 0
    sent: int = 0
    got: int | None = None
    """Messages that it has, by its own word; None where it does not tell."""

    @property
    def behind(self) -> bool:
        """Whether it has enough to read: what waits on the wire is old before it is read."""
        return self.got is not None and self.sent - self.got >= UNREAD_AT_MOST
