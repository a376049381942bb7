"""A list that somebody listens to: what is put into it is told as it happens."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeVar

Item = TypeVar("Item")


class ObservableList(list[Item]):
    """A list whose ``append`` also tells ``listener``, where there is one."""

    def __init__(self, items: Iterable[Item] = ()) -> None:
        super().__init__(items)
        self._listener: Callable[[Item], None] | None = None

    def append(self, item: Item) -> None:
        """Put ``item`` at the end and tell it."""
        super().append(item)
        if self._listener is not None:
            self._listener(item)

    def tell(self, listener: Callable[[Item], None]) -> None:
        """Tell ``listener`` what is there already, and from now on what comes."""
        for item in self:
            listener(item)
        self._listener = listener
