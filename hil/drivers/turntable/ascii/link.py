"""One serial port to a turntable controller: a line out, a line in, by whatever protocol file."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Final

import serial

from hil.core.clock import Clock
from hil.drivers.turntable.ascii.frames import BrokenLine
from hil.drivers.turntable.ascii.protocol import AsciiCommand, AsciiProtocol, Key, Value
from hil.errors import LinkLost, LinkTimeout, ProtocolError

BURST: Final = 4  # broken replies in a row that end the link
REPLY_S: Final = 0.05  # bench time that one reply may take
_PATIENCE_S: Final = 0.1  # without sequence numbers: how much longer an answer is waited for
_WRITE_WALL_S: Final = 0.3
_BITS_A_BYTE: Final = 10
_REMEMBERED: Final = 16  # sequence numbers that were answered
COUNTERS: Final = ("exchanges", "lost", "protocol_errors", "late", "duplicates")


class AsciiTransport:
    """Requests and their replies over one port. Errors name ``device``.

    A reply counts when its checksum is right, its sequence number is that of the request, its form is that
    of the protocol file and, in a line for one axis, the axis is the one that was asked. Without
    sequence numbers an answer that comes still later than the longer wait for it passes for a new one.
    """

    def __init__(
        self, device: str, port: str, baud: int, timeout_s: float, dialect: AsciiProtocol, clock: Clock
    ) -> None:
        self.device = device
        self.dialect = dialect
        self._path = port
        self._baud = baud
        self._timeout_s = timeout_s
        self._clock = clock
        self._port: serial.Serial | None = None
        self._sequence = 0
        self.reset()

    def reset(self) -> None:
        """Count from zero."""
        self._splitter = self.dialect.replies.splitter()
        self._lines: deque[bytes] = deque()
        self._answered: deque[int] = deque(maxlen=_REMEMBERED)
        self._broken_in_a_row = 0
        self.heard()
        self.counts = dict.fromkeys(COUNTERS, 0)

    @property
    def is_open(self) -> bool:
        return self._port is not None

    @property
    def in_doubt(self) -> bool:
        """Whether the last replies were broken, rather than missing."""
        return self._broken_in_a_row > 0

    @property
    def skipped_bytes(self) -> int:
        return self._splitter.skipped_bytes

    def open(self) -> None:
        """Open the port. Raises LinkLost."""
        wall_s = 0.5 * REPLY_S / self._clock.speed
        try:
            self._port = serial.Serial(self._path, self._baud, timeout=wall_s, write_timeout=_WRITE_WALL_S)
            self._port.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise LinkLost(self.device, f"cannot open {self._path}: {error}") from error
        self.reset()

    def close(self) -> None:
        """Let go of the port. Idempotent."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def heard(self) -> None:
        """Let the time-out run from now on."""
        self._heard_s = self._clock.now_s()

    def check_silence(self) -> None:
        """Raise LinkTimeout when the controller has not answered for too long."""
        silent_s = self._clock.now_s() - self._heard_s
        if silent_s > self._timeout_s:
            raise LinkTimeout(
                self.device, f"no reply for {silent_s:.3f} s, allowed {self._timeout_s:g} s{self._hint()}"
            )

    def tell(self, line: AsciiCommand, axis: int, values: Mapping[Key, Value]) -> bytes:
        """Send a request without waiting for the reply; return it."""
        self._sequence = (self._sequence + 1) % self.dialect.sequence_range
        request = self.dialect.request(self._sequence, line, axis, values)
        self._write(request)
        return request

    def ask(
        self, line: AsciiCommand, axis: int, values: Mapping[Key, Value], reply_s: float = REPLY_S, patient: bool = True
    ) -> tuple[float, dict[Key, Value]] | None:
        """Return when the controller had the request, bench s, and what its reply tells; None without a good one.

        patient: without sequence numbers, wait longer for a late answer, which would pass for that to the next
        request; not for what has to go out at once. Raises Refused for an error reply, ProtocolError for a
        burst of broken ones, LinkLost.
        """
        self._drop_left_over()
        request = self.tell(line, axis, values)
        arrived_s = self._clock.now_s() + len(request) * _BITS_A_BYTE / self._baud
        end_s = arrived_s + reply_s
        last_s = end_s if self.dialect.has_sequence or not patient else end_s + _PATIENCE_S
        while self._clock.now_s() < last_s:
            if not self._lines:
                self._lines.extend(self._splitter.feed(self._read()))
                continue
            try:
                told = self._take(self._lines.popleft(), line, axis)
            except BrokenLine as error:
                self._count_broken(error)
                return None
            if told is not None:
                self.counts["late"] += self._clock.now_s() > end_s
                return arrived_s, told
        self.counts["lost"] += 1
        self._splitter.clear()
        return None

    def _hint(self) -> str:
        """Return what did come, for whoever looks for the fault."""
        seen = ", ".join(f"{name} {count}" for name, count in self.counts.items() if count)
        return f" (since open: {seen})" if seen else ""

    def _take(self, text: bytes, line: AsciiCommand, axis: int) -> dict[Key, Value] | None:
        """Return what a reply tells, None for one to another request."""
        sequence, body = self.dialect.replies.decode(text)
        if self.dialect.has_sequence and sequence != self._sequence:
            self.counts["duplicates" if sequence in self._answered else "late"] += 1
            return None
        told = self.dialect.take_reply(body, line, axis)
        self._answered.append(sequence)
        self._broken_in_a_row = 0
        self.heard()
        return told

    def _drop_left_over(self) -> None:
        """Without sequence numbers: what lies here before the request went out cannot answer it."""
        if self.dialect.has_sequence or self._port is None:
            return
        if self._port.in_waiting:
            self._lines.extend(self._splitter.feed(self._read()))
        self.counts["duplicates"] += len(self._lines)
        self._lines.clear()

    def _count_broken(self, error: BrokenLine) -> None:
        self.counts["protocol_errors"] += 1
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

    def _read(self) -> bytes:
        """Return what is there, b"" after half a reply time; it never waits for more once bytes came."""
        if self._port is None:
            raise LinkLost(self.device, "is not open")
        try:
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first
        except (OSError, TypeError) as error:
            raise LinkLost(self.device, f"read from {self._path} failed: {error}") from error
