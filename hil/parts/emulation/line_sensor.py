"""An emulated sensor on a serial wire or on UDP: measures while it is asked to, and sends each measurement."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from hil.core.clock import BenchClock
from hil.core.line_protocol import LineProtocol
from hil.drivers.datagrams import DatagramSender
from hil.maths.random_streams import stream
from hil.parts.emulation.fault_injection import Faults, FaultyChannel
from hil.parts.emulation.pty_line import PtyLine

_CATCHES_UP: Final = 0.25  # fraction of a period: a later measurement is dropped


class SensorFrames(NamedTuple):
    """Wire of a sensor with frames of its own. encode: returns one by bench time, s, and measured components."""

    wire: DatagramSender | PtyLine
    encode: Callable[[float, Sequence[float]], bytes]


class LineSensorEmulator:
    """Sensor ``name`` on a pseudo terminal, or on the wire of ``frames``.

    measure_at: returns the components of measurement ``number`` at a bench time, s, None if there is none. Each line
    leaves ``latency_s`` after its measurement.
    """

    def __init__(
        self,
        name: str,
        protocol: LineProtocol,
        measure_at: Callable[[float, int], Sequence[float] | None],
        times: tuple[float, float],
        clock: BenchClock,
        seed: int = 0,
        frames: SensorFrames | None = None,
    ) -> None:
        self._name, self._protocol, self._measure_at, self._clock = name, protocol, measure_at, clock
        self._encode = frames.encode if frames else lambda _, values: protocol.encode(values)
        self._rate_hz, self._latency_s = times
        self.faults = Faults(name, ("wire",))
        self._channel = FaultyChannel(self.faults, stream(seed, "wire"))
        self._line = frames.wire if frames else PtyLine(protocol.baud, clock)
        self._measures = not protocol.start
        self._received, self._last = b"", b""

    def start(self) -> dict[str, str]:
        """Return the path of the line by the name of the sensor."""
        return {self._name: self._line.path}

    def run(self, stop: threading.Event) -> None:
        line = self._line
        number = math.ceil(self._clock.now_s() * self._rate_hz)
        while not stop.is_set():
            number = max(number, math.ceil(self._clock.now_s() * self._rate_hz - _CATCHES_UP))
            measured_s = number / self._rate_hz
            if self._channel.next_s <= measured_s:
                self._clock.sleep_until(self._channel.next_s)
                for packet in self._channel.due(self._clock.now_s()):
                    line.write(packet)
                continue
            self._clock.sleep_until(measured_s)
            self._obey(line.read(0.0))
            if self._measures:
                self._send(measured_s, number)
            number += 1

    def close(self) -> None:
        """Let go of the line; idempotent. Not while ``run`` is at work."""
        self._line.close()

    def _obey(self, data: bytes) -> None:
        """Take commands: start and stop."""
        self._received = (self._received + data)[-256:]
        while b"\n" in self._received:
            command, _, self._received = self._received.partition(b"\n")
            if command + b"\n" in (self._protocol.start, self._protocol.stop):
                self._measures = command + b"\n" == self._protocol.start

    def _send(self, measured_s: float, number: int) -> None:
        """Put the line of measurement ``number`` on its way."""
        values = self._measure_at(measured_s, number)
        if self.faults.value("freeze") is None or not self._last:
            self._last = b"" if values is None else self._encode(measured_s, values)
        if self._last:
            self._channel.put(self._last, measured_s + self._latency_s)
