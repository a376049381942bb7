"""List that notifies a subscriber of each appended item."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


class ObservableList(list[Item]):
    """List whose ``append`` also calls the subscribed listener."""

    def __init__(self, items: Iterable[Item] = ()) -> None:
        super().__init__(items)
        self._listener: Callable[[Item], None] | None = None

    def append(self, item: Item) -> None:
        """Append ``item`` and notify the listener."""
        super().append(item)
        if self._listener is not None:
            self._listener(item)

    def subscribe(self, listener: Callable[[Item], None]) -> None:
        """Call ``listener`` with the present items, then with each appended one."""
        for item in self:
            listener(item)
        self._listener = listener
