"""Requests outside of the cycle: open, home, torque, close. One JSON line each way over a socket pair."""

from __future__ import annotations

import json
import socket
import threading
from typing import Any, Final

from hil.core.clock import BenchClock
from hil.errors import LinkLost, LinkTimeout

ANSWER_WALL_S: Final = 30.0
_PATIENCE_S: Final = 3600.0
_READ_BYTES: Final = 65536


class RequestLine:
    """One end of the line of requests, 0 of the server and 1 of the loop: lines of JSON. name: of the server."""

    def __init__(self, end: socket.socket, clock: BenchClock, name: str, which: int) -> None:
        self._socket = end
        self._clock = clock
        self._wire = clock.wire(f"requests of {name}", which)
        self._received = b""

    def send(self, message: dict[str, Any]) -> None:
        """Send one line. Raises OSError."""
        data = json.dumps(message).encode() + b"\n"
        while data:
            data = data[self._wire.write(self._socket.fileno(), data) :]

    def receive(self, within_s: float | None = None) -> dict[str, Any] | None:
        """Return the next line, None at the end. Raises TimeoutError after ``within_s`` of wall time, OSError."""
        deadline_s = None if within_s is None else self._clock.host_s() + within_s
        while b"\n" not in self._received:
            left_s = _PATIENCE_S if deadline_s is None else deadline_s - self._clock.host_s()
            if not self._wire.wait(self._socket.fileno(), max(0.0, left_s)):
                if deadline_s is None:
                    continue
                raise TimeoutError
            part = self._wire.read(self._socket.fileno(), _READ_BYTES)
            if not part:
                return None
            self._received += part
        line, _, self._received = self._received.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def close(self) -> None:
        """Close the socket. Idempotent."""
        self._wire.close()
        self._socket.close()


class IoRequests:
    """The loop's end: sends requests to the process ``name``, IO or WATCHDOG, and waits for the answers."""

    def __init__(self, end: socket.socket, name: str, clock: BenchClock) -> None:
        self._process = f"{name} process"
        self._line = RequestLine(end, clock, name, 1)
        self._lock = threading.Lock()

    def request(self, do: str, device: str, within_s: float = ANSWER_WALL_S, **more: object) -> dict[str, Any]:
        """Return the answer, which may take ``within_s`` of wall time; more: arguments of ``do``.

        Raises LinkLost if the process has ended, LinkTimeout if it does not answer; do not use the line after that.
        """
        try:
            with self._lock:
                self._line.send({"do": do, "device": device, **more})
                answer = self._line.receive(within_s)
        except TimeoutError as silence:
            raise LinkTimeout(device, f"{self._process} did not {do} it within {within_s:g} s") from silence
        except (OSError, ValueError) as cause:
            raise LinkLost(device, f"{self._process} has ended: {cause}") from cause
        if answer is None:
            raise LinkLost(device, f"{self._process} has ended")
        return answer

    def close(self) -> None:
        """Close the socket; idempotent."""
        self._line.close()
