"""Requests that may take their time: open, home, close. One JSON line each way over a socket pair."""

from __future__ import annotations

import json
import socket
import threading
from typing import Any, Final

from hil.errors import LinkLost, LinkTimeout

ANSWER_WALL_S: Final = 30.0


class IoRequests:
    """The loop's end: asks the I/O process and waits for its answer."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._lines = end.makefile("rwb")
        self._lock = threading.Lock()

    def ask(self, do: str, device: str, within_s: float = ANSWER_WALL_S) -> dict[str, Any]:
        """Return the answer, which has ``within_s`` of wall time.

        Raises LinkLost when the I/O process is gone, LinkTimeout when it stays silent; then the line is not to be
        used again.
        """
        try:
            with self._lock:
                self._socket.settimeout(within_s)
                self._lines.write(json.dumps({"do": do, "device": device}).encode() + b"\n")
                self._lines.flush()
                line = self._lines.readline()
        except TimeoutError as silence:
            raise LinkTimeout(device, f"I/O process did not {do} it within {within_s:g} s") from silence
        except (OSError, ValueError) as cause:
            raise LinkLost(device, f"I/O process is gone: {cause}") from cause
        if not line:
            raise LinkLost(device, "I/O process is gone")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """Hang up; idempotent."""
        self._lines.close()
        self._socket.close()
