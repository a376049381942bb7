"""Transport of an ASCII protocol: requests and replies over one serial port."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Final

import serial

from hil.core.clock import BenchClock
from hil.drivers.serial_port import open_serial
from hil.drivers.tcp_port import TcpPort, is_tcp
from hil.drivers.turntable.ascii.frames import BrokenLine
from hil.drivers.turntable.ascii.protocol import AsciiCommand, AsciiProtocol, Key, Value
from hil.errors import LinkLost, LinkTimeout, ProtocolError

BURST: Final = 4  # consecutive broken replies that end the link
REPLY_S: Final = 0.05  # bench time that one reply may take
_LATE_REPLY_S: Final = 0.1  # without sequence numbers: additional wait for a late reply
_WRITE_WALL_S: Final = 0.3
_BITS_PER_BYTE: Final = 10
_HISTORY: Final = 16  # sequence numbers with a reply
COUNTERS: Final = ("exchanges", "lost", "protocol_errors", "late", "duplicates")


class AsciiTransport:
    """Requests and their replies over one port. Errors name ``device``.

    A reply is valid if its checksum is correct, its sequence number is that of the request, its form is that of the
    protocol file and, in a line for one axis, the axis is the requested one. Without sequence numbers a reply later
    than the prolonged wait passes for a new one.
    """

    def __init__(
        self, device: str, port: str, baud: int, timeout_s: float, protocol: AsciiProtocol, clock: BenchClock
    ) -> None:
        self.device = device
        self.protocol = protocol
        self._path = port
        self._baud = baud
        self._timeout_s = timeout_s
        self._clock = clock
        self._port: serial.Serial | TcpPort | None = None
        self._sequence = 0
        self.reset()

    def reset(self) -> None:
        """Reset counters and buffers."""
        self._splitter = self.protocol.replies.splitter()
        self._lines: deque[bytes] = deque()
        self._answered: deque[int] = deque(maxlen=_HISTORY)
        self._broken_in_a_row = 0
        self._echo = b""
        self.broken = ""
        """Last reply that could not be read."""
        self.restart_timeout()
        self.counts = dict.fromkeys(COUNTERS, 0)

    @property
    def is_open(self) -> bool:
        return self._port is not None

    @property
    def skipped_bytes(self) -> int:
        return self._splitter.skipped_bytes

    def open(self) -> None:
        """Open the port. Raises LinkLost."""
        wall_s = 0.5 * REPLY_S / self._clock.speed
        try:
            if is_tcp(self._path):
                self._port = TcpPort(self._clock, self._path, timeout=wall_s)
            else:
                self._port = open_serial(
                    self._clock, self._path, self._baud, timeout=wall_s, write_timeout=_WRITE_WALL_S, exclusive=True
                )
        except (OSError, ValueError) as error:
            raise LinkLost(self.device, f"cannot open {self._path}: {error}") from error
        self.reset()

    def close(self) -> None:
        """Close the port. Idempotent."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def restart_timeout(self) -> None:
        """Restart the time-out."""
        self._received_s = self._clock.now_s()

    def check_silence(self) -> None:
        """Raise LinkTimeout if the last valid reply is too old."""
        silent_s = self._clock.now_s() - self._received_s
        if silent_s > self._timeout_s:
            raise LinkTimeout(
                self.device, f"no reply for {silent_s:.3f} s, allowed {self._timeout_s:g} s{self._hint()}"
            )

    def send(self, line: AsciiCommand, axis: int, values: Mapping[Key, Value]) -> bytes:
        """Send a request without waiting for the reply; return it."""
        self._sequence = (self._sequence + 1) % self.protocol.sequence_range
        request = self.protocol.request(self._sequence, line, axis, values)
        self._write(request)
        return request

    def request(
        self, line: AsciiCommand, axis: int, values: Mapping[Key, Value], reply_s: float = REPLY_S, patient: bool = True
    ) -> tuple[float, dict[Key, Value]] | None:
        """Return the bench time of the request at the controller, s, and the values of its reply; None without one.

        patient: without sequence numbers, wait longer for a late reply, which would pass for that to the next request;
        not for urgent requests. Raises CommandRefused for an error reply, ProtocolError for a burst of broken ones,
        LinkLost.
        """
        self._discard_pending()
        sent = self.send(line, axis, values)
        arrived_s = self._clock.now_s() + len(sent) * _BITS_PER_BYTE / self._baud
        if line.reply is None:
            return arrived_s, {}
        self._echo = sent.removesuffix(self.protocol.requests.end) if self.protocol.protocol.line.echo else b""
        end_s = arrived_s + reply_s
        last_s = end_s if self.protocol.has_sequence or not patient else end_s + _LATE_REPLY_S
        while self._clock.now_s() < last_s:
            if not self._lines:
                self._lines.extend(self._splitter.feed(self._read()))
                continue
            try:
                values_read = self._accept(self._lines.popleft(), line, axis)
            except BrokenLine as error:
                self._count_broken(error)
                return None
            if values_read is not None:
                self.counts["late"] += self._clock.now_s() > end_s
                return arrived_s, values_read
        self.counts["lost"] += 1
        self._splitter.clear()
        return None

    def _hint(self) -> str:
        """Return the last broken reply and the counters, for diagnosis."""
        counted = [f"{name} {count}" for name, count in self.counts.items() if count]
        return f" (since open: {', '.join(counted)})" + (f"; {self.broken}" if self.broken else "") if counted else ""

    def _accept(self, text: bytes, line: AsciiCommand, axis: int) -> dict[Key, Value] | None:
        """Return the values of a reply, None for one to another request."""
        if self._echo and self._echo in text:  # with echoes of requests without a reply before it
            text = text.rpartition(self._echo)[2].lstrip(self.protocol.requests.end)
            if not text:
                return None
        sequence, body = self.protocol.replies.decode(text)
        if self.protocol.has_sequence and sequence != self._sequence:
            self.counts["duplicates" if sequence in self._answered else "late"] += 1
            return None
        values = self.protocol.decode_reply(body, line, axis)
        self._answered.append(sequence)
        self._broken_in_a_row = 0
        self.restart_timeout()
        return values

    def _discard_pending(self) -> None:
        """Discard data received before the request, if there are no sequence numbers."""
        if self.protocol.has_sequence or self._port is None:
            return
        self._lines.extend(self._splitter.feed(self._read(wait=False)))
        self.counts["duplicates"] += len(self._lines)
        self._lines.clear()

    def _count_broken(self, error: BrokenLine) -> None:
        self.counts["protocol_errors"] += 1
        self.broken = f"last one: {error}"
        self._broken_in_a_row += 1
        if self._broken_in_a_row >= BURST:
            raise ProtocolError(self.device, f"{BURST} broken replies in a row: {error}") from error

    def _write(self, request: bytes) -> None:
        if self._port is None:
            raise LinkLost(self.device, "is not open")
        try:
            self._port.write(request)
        except OSError as error:
            raise LinkLost(self.device, f"write to {self._path} failed: {error}") from error

    def _read(self, wait: bool = True) -> bytes:
        """Return the received bytes, b"" after half a reply time, at once without ``wait``; waits for no more."""
        if self._port is None:
            raise LinkLost(self.device, "is not open")
        try:
            first: bytes = self._port.read(1) if wait or self._port.in_waiting else b""
            return first + self._port.read(self._port.in_waiting) if first else first
        except (OSError, TypeError) as error:
            raise LinkLost(self.device, f"read from {self._path} failed: {error}") from error
