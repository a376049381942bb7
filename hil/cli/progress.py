"""Progress bar that is drawn by its caller's updates: no additional thread."""

from __future__ import annotations

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn


class ProgressBar(Progress):
    """Bar on a terminal only, removed at the end. title: shown before the first update."""

    def __init__(self, console: Console, title: str) -> None:
        super().__init__(
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            auto_refresh=False,
            transient=True,
            disable=not console.is_terminal,
        )
        self._task = self.add_task(title, total=1.0)

    def show(self, title: str, fraction: float) -> None:
        """Show the present step and the completed fraction, 0..1."""
        if not self.disable:
            self.update(self._task, description=title, completed=fraction, refresh=True)
