"""Emulator: the controller on a pseudo terminal, with the servo dynamics and axis faults that hil provides."""

from __future__ import annotations

import math
import threading

from acme_rails import codec
from acme_rails.codec import Status
from hil.config.rig import Rails
from hil.core.clock import BenchClock
from hil.maths.random_streams import stream
from hil.parts.emulation.emulated_axes import STEP_S, EmulatedAxes
from hil.parts.emulation.fault_injection import FaultyChannel
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.shared_state import SharedAxisState

MODEL = "ACME-3R"


class AcmeEmulator:
    """Controller of x, y, z. ``shared`` publishes where the axes are, for the emulated vision unit."""

    def __init__(
        self, config: Rails, clock: BenchClock, shared: SharedAxisState, seed: int = 0, name: str = "rails"
    ) -> None:
        self._clock = clock
        self._baud, self._response_s = config.settings.baud, config.settings.emulated_response_s
        self._axes = EmulatedAxes(name, config, clock, shared, seed=seed)
        self.faults = self._axes.faults
        self._channel = FaultyChannel(self.faults, stream(seed, "wire"))
        self._status = Status(0)
        self._line: PtyLine | None = None

    def start(self) -> dict[str, str]:
        """Open the line; return the address for the wire key of the entry."""
        self._line = PtyLine(self._baud, self._clock)
        return {self.faults.device: self._line.path}

    def run(self, stop: threading.Event) -> None:
        """Serve the line until ``stop`` is set."""
        assert self._line is not None
        data = b""
        while not stop.is_set():
            data += self._line.read(STEP_S)
            self._advance()
            *lines, data = data.split(b"\n")
            if self.faults.value("link_down") is None:
                for line in lines:
                    self._respond(line)
            for packet in self._channel.due(self._clock.now_s()):
                self._line.write(packet)

    def close(self) -> None:
        """Close the line. Idempotent."""
        if self._line is not None:
            self._line.close()
        self._line = None

    def _advance(self) -> None:
        self._axes.advance(self._clock.now_s())
        if any(self._axes.overdue) or self._axes.torque_off:
            self._axes.overdue = [False, False, False]
            self._trip(Status.TORQUE_OFF if self._axes.torque_off else Status(0))
        for name in self._axes.names:
            if self.faults.pop("drive_fault", name) is not None:
                self._trip(Status(0))

    def _trip(self, cause: Status) -> None:
        if self._status & Status.ENABLED:
            self._status = Status.FAULT | cause
            self._brake()

    def _brake(self) -> None:
        for axis in range(3):
            self._axes.brake(axis)

    def _respond(self, line: bytes) -> None:
        try:
            number, command, *words = codec.decode(line)
            position, rate = codec.decode_numbers(words) if command == codec.SET else ((), ())
        except ValueError:
            return  # damaged: no response
        if command == codec.ENABLE and not self._axes.torque_off:
            self._status = Status.ENABLED
            position, rate = tuple(self._axes.position), (0.0, 0.0, 0.0)
        elif command == codec.STOP:
            self._status = Status(0)
            self._brake()
        if position and self._status & Status.ENABLED:
            watchdog = {"watchdog_s": math.inf} if command == codec.ENABLE else {}
            for axis in range(3):
                self._axes.follow(axis, position[axis], rate[axis], self._clock.now_s(), **watchdog)
        answer = f"{int(self._status)} {codec.encode_numbers(self._axes.position, self._axes.rate)}"
        text = f"{number} {MODEL if command == codec.IDENT else answer}"
        self._channel.put(codec.encode(text), self._clock.now_s() + self._response_s)
