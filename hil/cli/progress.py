"""A progress bar that is drawn by whoever tells it something: no thread of its own beside the loop."""

from __future__ import annotations

from typing import Self

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class Bar:
    """Shown on a terminal alone, and gone at the end. title: of what comes before the first word."""

    def __init__(self, console: Console, title: str) -> None:
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            auto_refresh=False,
            transient=True,
        )
        self._visible = console.is_terminal
        self._task = self._progress.add_task(title, total=1.0)

    def __enter__(self) -> Self:
        if self._visible:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._visible:
            self._progress.stop()

    def tell(self, title: str, share: float) -> None:
        """Show what is under way and how far along it is, 0..1."""
        if self._visible:
            self._progress.update(self._task, description=title, completed=share, refresh=True)
