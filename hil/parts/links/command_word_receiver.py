"""Flight computer on a wire: receiver of its thruster command words, and forwarder of the vision unit's frames to it.

A reader thread keeps the newest word and counts losses.
"""

from __future__ import annotations

import contextlib
import queue
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Final, Protocol

import serial

from hil.config.tables.flight_computer import FlightComputer, WordsLine
from hil.core.clock import WallClock
from hil.core.messages import PoseFrame
from hil.drivers.latest import Latest
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import LinkLost
from hil.parts.links.command_word_codec import CommandWordDecoder, Word, decode_can

NAME: Final = "flight computer"
_READ_WALL_S: Final = 0.1  # bound of one blocking read


class WordWire(Protocol):
    """Source of command words."""

    @property
    def refused(self) -> int:
        """Number of invalid words received."""

    def receive(self) -> list[Word]:
        """Return the received words, after a bounded wait. Raises LinkLost and the errors of the wire."""

    def close(self) -> None:
        """Close the wire."""


class SerialWords:
    """Words on a serial port."""

    def __init__(self, port: str, baud: int) -> None:
        try:
            self._port = serial.Serial(port, baud, timeout=_READ_WALL_S, exclusive=True)
            self._port.reset_input_buffer()
        except Exception as cause:  # pyserial: OSError, ValueError (baud), termios.error
            raise LinkLost(NAME, f"cannot open {port}: {cause}") from cause
        self._decoder = CommandWordDecoder()

    @property
    def refused(self) -> int:
        return self._decoder.refused

    def receive(self) -> list[Word]:
        """Return the received words."""
        return self._decoder.feed(self._port.read(max(1, self._port.in_waiting)))

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(Exception):
            self._port.close()


class CanWords:
    """Words on a CAN bus."""

    def __init__(self, config: FlightComputer) -> None:
        from hil.drivers.can_port import CanPort  # python-can is slow to import

        self._identifier = config.can.identifier
        self._port = CanPort(NAME, config.can, WallClock())
        self._refused = 0

    @property
    def refused(self) -> int:
        return self._refused

    def receive(self) -> list[Word]:
        """Return the received words."""
        frame = self._port.receive(_READ_WALL_S)
        if frame is None or frame[0] != self._identifier:
            return []
        word = decode_can(frame[1])
        self._refused += word is None
        return [] if word is None else [word]

    def close(self) -> None:
        """Leave the bus."""
        self._port.close()


class CommandWordReceiver:
    """The newest word of a flight computer and its time of reception. now_s: returns bench time, from any thread."""

    def __init__(self, config: FlightComputer, now_s: Callable[[], float]) -> None:
        self._config = config
        self._now_s = now_s
        self._wire: WordWire | None = None
        self._reader: threading.Thread | None = None
        self._ending = threading.Event()
        self._newest: Latest[tuple[Word, float]] = Latest(NAME)
        self.received = self.lost = self.repeated = 0

    def open(self) -> None:
        """Open the wire and start to read. Raises LinkLost."""
        self.close()
        config = self._config
        self._ending = threading.Event()
        self._newest = Latest(NAME)
        self.received = self.lost = self.repeated = 0
        wire: WordWire
        if config.command_words == "can":
            wire = CanWords(config)
        else:
            wire = SerialWords(str(config.serial.port), config.serial.baud)
        self._wire = wire
        self._reader = threading.Thread(target=self._read, args=(wire,), name="words-reader", daemon=True)
        self._reader.start()

    def newest(self) -> tuple[Word, float] | None:
        """Return the newest word and its time of reception, None before the first. Raises LinkLost."""
        self._newest.check()
        return self._newest.peek()

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``."""
        refused = self._wire.refused if self._wire is not None else 0
        return {"received": self.received, "lost": self.lost, "repeated": self.repeated, "refused": refused}

    def close(self) -> None:
        """End the reader and close the wire. Idempotent."""
        self._ending.set()
        wire, self._wire = self._wire, None
        reader, self._reader = self._reader, None
        if reader is not None:
            reader.join(2.0 * _READ_WALL_S)
        if wire is not None:
            wire.close()

    def _read(self, wire: WordWire) -> None:
        previous: int | None = None
        try:
            while not self._ending.is_set():
                for word in wire.receive():
                    if word.counter == previous:
                        self.repeated += 1  # a sender that hangs repeats its word
                        continue
                    if previous is not None:
                        self.lost += (word.counter - previous - 1) & 0xFF
                    previous = word.counter
                    self.received += 1
                    received_s = self._now_s()
                    self._newest.put((word, received_s), received_s)
        except Exception as cause:  # any error that ends the thread is reported to the cycle
            if not self._ending.is_set():
                error = cause if isinstance(cause, LinkLost) else LinkLost(NAME, str(cause))
                self._newest.fail(error)


_WAITING: Final = 64  # frames; further ones are lost


class PoseForwarder:
    """Sends frames with the time of the run, in its own thread; ``put`` never waits."""

    def __init__(self, line: WordsLine) -> None:
        self._line = line
        self._queue: queue.Queue[bytes | None] = queue.Queue(_WAITING)
        self._writer: threading.Thread | None = None
        self.lost = 0

    def open(self) -> None:
        """Open the port. Raises LinkLost."""
        self.close()
        try:
            port = serial.Serial(self._line.port, self._line.baud, write_timeout=1.0, exclusive=True)
        except Exception as cause:  # pyserial: OSError, ValueError (baud), termios.error
            raise LinkLost(NAME, f"cannot open {self._line.port}: {cause}") from cause
        self._queue = queue.Queue(_WAITING)
        self._writer = threading.Thread(target=self._write, args=(port, self._queue), name="poses-writer", daemon=True)
        self._writer.start()

    def put(self, frame: PoseFrame, t_s: float) -> None:
        """Send ``frame``, exposed at ``t_s`` of the run; frames from before the run are discarded."""
        if self._writer is None or t_s < 0.0:
            return
        try:
            self._queue.put_nowait(frame_codec().encode(replace(frame, t_s=t_s)))
        except queue.Full:
            self.lost += 1

    def close(self) -> None:
        """Close the port. Idempotent."""
        writer, self._writer = self._writer, None
        if writer is not None:
            with contextlib.suppress(queue.Full):
                self._queue.put_nowait(None)
            writer.join(1.5)

    def _write(self, port: serial.Serial, frames: queue.Queue[bytes | None]) -> None:
        with contextlib.suppress(Exception), port:  # the command words show that the flight computer is gone
            while (frame := frames.get()) is not None:
                port.write(frame)
