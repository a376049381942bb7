"""What the console says of a session's recording: how much there is, what is lost, whether anybody writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np

SILENT_S: Final = 2.0
"""The recorder says ten times a second how it stands; after so long without a word it counts as dead."""


class RecordingWatch:
    """Watches the recording into ``file``; "" where nothing is recorded."""

    def __init__(self, file: str = "") -> None:
        self.file = file
        self._size_bytes = self._lost = 0
        self._trouble = ""

    def look(self, state: np.ndarray, silent_s: float) -> list[str]:
        """Take recorder.STATE (1,) and for how long nothing was said; return what of it belongs into the log."""
        row = state[0]
        trouble = row["trouble"].decode(errors="replace")
        if not trouble and silent_s > SILENT_S:
            trouble = f"its process says nothing for {SILENT_S:g} s"
        lines = []
        if trouble and trouble != self._trouble:
            lines.append(f"recording: {self.file}: {trouble}: nothing is recorded any more, the bench goes on")
        if self._trouble and not trouble:
            lines.append("recording: goes on")
        lost = int(row["dropped"])
        if lost and not self._lost and not trouble:
            lines.append(f"recording: {self.file}: {lost} messages came too fast and are lost, more are counted")
        self._size_bytes, self._lost, self._trouble = int(row["size_bytes"]), lost, trouble
        return lines

    def as_json(self) -> dict[str, Any] | None:
        """Return what a page shows; None where nothing is recorded."""
        if not self.file:
            return None
        name = Path(self.file).name
        return {"file": name, "size_bytes": self._size_bytes, "lost": self._lost, "trouble": self._trouble}
