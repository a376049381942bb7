"""Requests that take longer than a cycle: open, home, close. One JSON line each way over a socket pair."""

from __future__ import annotations

import json
import socket
import threading
from contextlib import suppress
from typing import Any, Final

from hil.errors import LinkLost, LinkTimeout

ANSWER_WALL_S: Final = 30.0


class IoRequests:
    """The loop's end: sends requests to the process ``name``, IO or WATCHDOG, and waits for the answers."""

    def __init__(self, end: socket.socket, name: str) -> None:
        self._process = f"{name} process"
        self._socket = end
        self._lines = end.makefile("rwb")
        self._lock = threading.Lock()

    def request(self, do: str, device: str, within_s: float = ANSWER_WALL_S) -> dict[str, Any]:
        """Return the answer, which may take ``within_s`` of wall time.

        Raises LinkLost if the process has ended, LinkTimeout if it does not answer; do not use the line after that.
        """
        try:
            with self._lock:
                self._socket.settimeout(within_s)
                self._lines.write(json.dumps({"do": do, "device": device}).encode() + b"\n")
                self._lines.flush()
                line = self._lines.readline()
        except TimeoutError as silence:
            raise LinkTimeout(device, f"{self._process} did not {do} it within {within_s:g} s") from silence
        except (OSError, ValueError) as cause:
            raise LinkLost(device, f"{self._process} has ended: {cause}") from cause
        if not line:
            raise LinkLost(device, f"{self._process} has ended")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """Close the socket; idempotent. A request that a process which has ended did not take is lost with it."""
        with suppress(OSError):
            self._lines.close()
        self._socket.close()
