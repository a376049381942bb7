"""Turntable behind one serial controller that speaks ASCII lines, request and reply."""

from __future__ import annotations

import time
from collections import deque

import numpy as np
import serial

from hil.clock import Clock
from hil.config.rig import SerialLine, Turntable
from hil.drivers.base import GIMBAL_NAMES, full_names
from hil.drivers.turntable import ascii_codec as codec
from hil.drivers.turntable.ascii_codec import BrokenLine, Command, LineSplitter, Report
from hil.drivers.turntable.exchange import ExchangedTurntable
from hil.errors import BadInput, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError
from hil.messages import Array, AxisFeedback

_REPLY_S = 0.05  # bench time that one reply may take
_BURST = 4  # broken replies in a row that end the link
_SET_UP_WALL_S = 2.0
_REPLY_WALL_S = 0.3  # set-up: wall time that one reply may take
_POLL_WALL_S = 0.005
_BITS_A_BYTE = 10


class AsciiLink:
    """One port; each exchange is one line out and one line in.

    Feedback is stamped with the bench time at which the request's last byte reaches the controller.
    """

    def __init__(self, device: str, config: SerialLine, timeout_s: float, clock: Clock) -> None:
        self.device = device
        self.axis_names = full_names(device, GIMBAL_NAMES)
        self._config = config
        self._timeout_s = timeout_s
        self._clock = clock
        self._port: serial.Serial | None = None
        self._sequence = 0
        self._stopped = False
        self._reset()

    def _reset(self) -> None:
        self._splitter = LineSplitter(codec.REPLY_START)
        self._lines: deque[bytes] = deque()
        self._heard_s = self._clock.now_s()
        self._broken_in_a_row = 0
        self._counts = {"exchanges": 0, "broken_replies": 0, "unanswered": 0, "stale_replies": 0}

    def open(self) -> Array:
        """Identify the controller, bring the axes to a stand, enable them; return their position (3,), rad."""
        wall_s = 0.5 * _REPLY_S / self._clock.speed
        try:
            self._port = serial.Serial(
                self._config.port, self._config.baud, timeout=wall_s, write_timeout=_REPLY_WALL_S
            )
            self._port.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise LinkLost(self.device, f"cannot open {self._config.port}: {error}") from error
        self._reset()
        try:
            return self._set_up()
        except DeviceError:
            self._last_word()
            self.close()
            raise

    def _set_up(self) -> Array:
        words = self._ask(codec.IDENTIFY)
        if words[0] != codec.IDENTIFY.answer or words[-1] != "3":
            raise ProtocolError(self.device, f"is not a turntable of 3 axes: {' '.join(words)}")
        end_s = time.monotonic() + _SET_UP_WALL_S
        self._report(self._ask(codec.QUICK_STOP))
        while any(flags & codec.MOVING for flags in self._report(self._ask(codec.READ)).status):
            if time.monotonic() > end_s:
                raise LinkTimeout(self.device, f"axes do not come to a stand within {_SET_UP_WALL_S:g} s")
            time.sleep(_POLL_WALL_S)
        self._report(self._ask(codec.CLEAR_FAULTS))
        words = self._ask(codec.ENABLE)
        report = self._report(words if words[0] == codec.ENABLE.answer else self._ask(codec.READ))
        self._stopped = False
        self._check(report)
        self._heard_s = self._clock.now_s()
        return np.radians(report.position_deg)

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Give the setpoint, take the report; after ``quick_stop`` take the report only."""
        if self._stopped:
            answer = self._transact(codec.READ)
        else:
            answer = self._transact(codec.SET, (*np.degrees(position).tolist(), *np.degrees(rate).tolist()))
        self._counts["exchanges"] += 1
        if answer is None:
            self._check_silence()
            return None
        sampled_s, words = answer
        report = self._report(words)
        self._check(report)
        return AxisFeedback(sampled_s, np.radians(report.position_deg), np.radians(report.rate_degps))

    def quick_stop(self) -> None:
        """Send the quick stop, again when the reply is broken or missing."""
        self._stopped = True
        if self._port is None:
            return
        for _ in range(_BURST):
            if self._transact(codec.QUICK_STOP) is not None:
                return
            self._check_silence()

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, broken_replies (checksum, form), unanswered, stale_replies, skipped_bytes."""
        return {**self._counts, "skipped_bytes": self._splitter.skipped_bytes}

    def _last_word(self) -> None:
        """Quick stop without waiting for an answer: set-up has failed anyway and says why."""
        try:
            self._write(codec.encode_request(self._next(), codec.QUICK_STOP))
        except LinkLost:
            return

    def _check(self, report: Report) -> None:
        for axis, status, faults in zip(self.axis_names, report.status, report.faults, strict=True):
            if status & codec.FAULT or faults:
                raise DriveFault(axis, codec.fault_text(faults))
            if not self._stopped and not status & codec.ENABLED:
                raise DriveFault(axis, f"was disabled by the controller, status 0x{status:02X}")

    def _check_silence(self) -> None:
        silent_s = self._clock.now_s() - self._heard_s
        if silent_s > self._timeout_s:
            raise LinkTimeout(self.device, f"no reply for {silent_s:.3f} s, allowed {self._timeout_s:g} s")

    def _report(self, words: list[str]) -> Report:
        try:
            return codec.decode_report(words)
        except BrokenLine as error:
            raise ProtocolError(self.device, str(error)) from error

    def _ask(self, command: Command) -> list[str]:
        """Transact in set-up, where wall time counts."""
        for _ in range(_BURST):
            answer = self._transact(command, reply_s=_REPLY_WALL_S * self._clock.speed)
            if answer is not None:
                return answer[1]
            if self._broken_in_a_row == 0:
                break
        raise LinkTimeout(self.device, f"does not answer {command.word} within {_REPLY_WALL_S:g} s")

    def _transact(
        self, command: Command, numbers: tuple[float, ...] = (), reply_s: float = _REPLY_S
    ) -> tuple[float, list[str]] | None:
        """Return when the controller had the request, bench s, and its answer's words; None without a good one."""
        request = codec.encode_request(self._next(), command, numbers)
        self._write(request)
        arrived_s = self._clock.now_s() + len(request) * _BITS_A_BYTE / self._config.baud
        end_s = arrived_s + reply_s
        while self._clock.now_s() < end_s:
            if not self._lines:
                self._lines.extend(self._splitter.feed(self._read()))
                continue
            try:
                sequence, words = codec.decode_reply(self._lines.popleft())
            except BrokenLine as error:
                self._count_broken(error)
                return None
            if sequence == self._sequence:
                self._broken_in_a_row = 0
                self._heard_s = self._clock.now_s()
                return arrived_s, words
            self._counts["stale_replies"] += 1
        self._counts["unanswered"] += 1
        self._splitter.clear()
        return None

    def _count_broken(self, error: BrokenLine) -> None:
        self._counts["broken_replies"] += 1
        self._broken_in_a_row += 1
        if self._broken_in_a_row >= _BURST:
            raise ProtocolError(self.device, f"{_BURST} broken replies in a row: {error}") from error

    def _next(self) -> int:
        self._sequence = (self._sequence + 1) % 256
        return self._sequence

    def _write(self, request: bytes) -> None:
        if self._port is None:
            raise LinkLost(self.device, "is not open")
        try:
            self._port.write(request)
        except OSError as error:
            raise LinkLost(self.device, f"write to {self._config.port} failed: {error}") from error

    def _read(self) -> bytes:
        """Return what is there, b"" after half a reply time; it never waits for more once bytes came."""
        if self._port is None:
            raise LinkLost(self.device, "is not open")
        try:
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else first
        except (OSError, TypeError) as error:
            raise LinkLost(self.device, f"read from {self._config.port} failed: {error}") from error


class AsciiTurntable(ExchangedTurntable):
    """Turntable on a serial port; ``config.ascii`` names port and baud rate."""

    def __init__(self, config: Turntable, clock: Clock) -> None:
        if config.ascii is None or config.ascii.port is None:
            raise BadInput.single("rig", "turntable.ascii.port", "is missing: the wire to the device")
        super().__init__(config, clock, AsciiLink("turntable", config.ascii, config.timeout_s, clock))
