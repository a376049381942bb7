"""Emulated serial turntable controller: the ASCII protocol on a paced pty, three gimbals behind it."""

from __future__ import annotations

import math
import threading
from collections import deque

import numpy as np

from hil.clock import WallClock
from hil.config.rig import Turntable
from hil.drivers.board import AxisBoard
from hil.drivers.emulated_axes import STEP_S, EmulatedAxes
from hil.drivers.lines import PtyLine
from hil.drivers.turntable import ascii_codec as codec
from hil.drivers.turntable.ascii_codec import BrokenLine, LineSplitter, Report
from hil.errors import BadInput

_IDENTITY = ("EMULATED-3AX", "0001", "3")
_COMMAND_TIMEOUT = 0x0080
_UNKNOWN, _ARGUMENTS, _REFUSED = codec.ERRORS


class AsciiTurntableEmulator:
    """Controller of roll, pitch, yaw on ``config.ascii``; serve it with ``run`` in a process of its own."""

    def __init__(self, config: Turntable, clock: WallClock, board: AxisBoard) -> None:
        if config.ascii is None:
            raise BadInput.single("rig", "turntable.ascii", "is missing")
        self._baud = config.ascii.baud
        self._clock = clock
        self.gimbals = EmulatedAxes("turntable", config, clock, board)
        self.faults = self.gimbals.faults
        self._splitter = LineSplitter(codec.REQUEST_START)
        self._enabled = [False, False, False]
        self._quick_stopped = False
        self._faults = [0, 0, 0]
        self._injected: deque[tuple[int, int]] = deque()
        self._line: PtyLine | None = None

    def start(self) -> dict[str, str]:
        """Open the line; return the controller's port of it."""
        self._line = PtyLine(self._baud, self._clock)
        return {"turntable": self._line.path}

    def fail_axis(self, axis: int, flags: int) -> None:
        """Let ``axis`` (0 to 2) report fault ``flags`` (see FAULT_FLAGS). For any thread."""
        self._injected.append((axis, flags))

    def run(self, stop: threading.Event) -> None:
        """Serve the line until ``stop`` is set."""
        line = self._line
        if line is None:
            raise RuntimeError("start the emulator first")
        while not stop.is_set():
            data = line.read(STEP_S)
            self.gimbals.advance(self._clock.now_s())
            self._housekeep()
            for request in self._splitter.feed(data) if data else ():
                reply = self.answer(request)
                if reply:
                    line.write(reply)
                    self.gimbals.advance(self._clock.now_s())

    def close(self) -> None:
        """Close the line."""
        if self._line is not None:
            self._line.close()
        self._line = None

    def answer(self, line: bytes) -> bytes:
        """Do what one request line says; return the reply line, b"" for a line that is broken."""
        try:
            sequence, word, words = codec.decode_request(line)
        except BrokenLine:
            return b""  # whose sequence number could not be trusted: the controller says nothing
        command = codec.COMMANDS.get(word)
        if command is None:
            return codec.encode_answer(sequence, "ERR", str(_UNKNOWN))
        try:
            numbers = codec.decode_numbers(command, words)
        except BrokenLine:
            return codec.encode_answer(sequence, "ERR", str(_ARGUMENTS))
        if command is codec.IDENTIFY:
            return codec.encode_answer(sequence, codec.IDENTIFY.answer, *_IDENTITY)
        if command is codec.ENABLE and not self._may_enable():
            return codec.encode_answer(sequence, "ERR", str(_REFUSED))
        self._do(command, numbers)
        return codec.encode_report(sequence, self._report())

    def _do(self, command: codec.Command, numbers: tuple[float, ...]) -> None:
        if command is codec.SET:
            self._follow(np.radians(numbers[:3]).tolist(), np.radians(numbers[3:]).tolist())
        elif command is codec.HOLD:
            self._follow(self.gimbals.position.tolist(), [0.0, 0.0, 0.0])
        elif command is codec.ENABLE:
            self._enabled = [True, True, True]
            self._quick_stopped = False
            self._follow(self.gimbals.position.tolist(), [0.0, 0.0, 0.0])
        elif command is codec.QUICK_STOP:
            self._brake_all()
        elif command is codec.CLEAR_FAULTS:
            self._faults = [0, 0, 0]

    def _follow(self, position_rad: list[float], rate_radps: list[float]) -> None:
        now_s = self._clock.now_s()
        for axis in range(3):
            if self._enabled[axis]:
                self.gimbals.follow(axis, position_rad[axis], rate_radps[axis], now_s)

    def _may_enable(self) -> bool:
        return not any(self._faults) and not any(self.gimbals.moving(axis) for axis in range(3))

    def _brake_all(self) -> None:
        self._enabled = [False, False, False]
        self._quick_stopped = True
        for axis in range(3):
            self.gimbals.brake(axis)

    def _housekeep(self) -> None:
        while self._injected:
            axis, flags = self._injected.popleft()
            self._faults[axis] |= flags
            self._enabled[axis] = False
            self.gimbals.brake(axis)
        for axis, overdue in enumerate(self.gimbals.overdue):
            if overdue:
                self.gimbals.overdue[axis] = False
                self._faults[axis] |= _COMMAND_TIMEOUT
                self._enabled[axis] = False

    def _status(self, axis: int) -> int:
        return (
            codec.ENABLED * self._enabled[axis]
            | codec.QUICK_STOPPED * self._quick_stopped
            | codec.MOVING * self.gimbals.moving(axis)
            | codec.FAULT * bool(self._faults[axis])
        )

    def _report(self) -> Report:
        roll, pitch, yaw = (math.degrees(angle) for angle in self.gimbals.position)
        rates = [math.degrees(rate) for rate in self.gimbals.rate]
        return Report(
            (self._status(0), self._status(1), self._status(2)),
            (self._faults[0], self._faults[1], self._faults[2]),
            (roll, pitch, yaw),
            (rates[0], rates[1], rates[2]),
        )
