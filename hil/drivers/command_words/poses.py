"""Forwarder of the vision unit's frames to a serial port of the flight computer."""

from __future__ import annotations

import contextlib
import queue
import threading
from dataclasses import replace
from typing import Final

import serial

from hil.config.flight_computer import WordsLine
from hil.core.messages import PoseFrame
from hil.drivers.command_words.receiver import NAME
from hil.drivers.vmu.frame_codec import frame_codec
from hil.errors import LinkLost

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
