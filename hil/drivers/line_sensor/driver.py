"""Driver of a sensor on a serial wire: a thread reads lines with their time of receipt, the loop polls for samples."""

from __future__ import annotations

import math
import os
from collections import Counter, deque
from typing import Any, Final, NamedTuple

import numpy as np

from hil.core.clock import BenchClock
from hil.core.line_protocol import BITS_PER_BYTE, LONGEST_LINE, LineProtocol
from hil.core.sensor_records import SENSOR_SAMPLE
from hil.drivers.serial_port import open_serial
from hil.drivers.wire_reader import READ_WALL_S, WireReader
from hil.errors import LinkLost

_KEPT: Final = 64  # samples that the loop has not asked for
_REASON: Final = 100  # characters


class LineSettings(NamedTuple):
    """Wire of a sensor. port: path. baud: None: the protocol's. latency_s: from the measurement to its line."""

    port: str
    baud: int | None = None
    latency_s: float = 0.0


class LineSensor:
    """Samples of one sensor. name: for errors. number: of the sensor in the loop. n: its components.

    A sample was measured ``latency_s`` and the line's own time before its receipt; its covariance is not reported.
    Lines that cannot be used are counted in ``refused``, by reason. Raises LinkLost if the port cannot be opened.
    """

    def __init__(
        self, name: str, number: int, n: int, protocol: LineProtocol, settings: LineSettings, clock: BenchClock
    ) -> None:
        self.name = name
        self.refused: Counter[str] = Counter()
        self._number, self._n, self._protocol, self._clock = number, n, protocol, clock
        self._baud, self._latency_s = settings.baud or protocol.baud, settings.latency_s
        self._lines: deque[tuple[float, tuple[float, ...]]] = deque(maxlen=_KEPT)  # time of measurement, components
        self._count, self._pending = 0, b""
        self.last_s = clock.now_s()
        """Bench time of the last usable line, at first of the opening."""
        try:
            port = open_serial(
                clock, settings.port, self._baud, timeout=READ_WALL_S, write_timeout=READ_WALL_S, exclusive=True,
                **_framing(settings.port, protocol),
            )  # fmt: skip
            port.write(protocol.start)
        except Exception as cause:  # pyserial: OSError, ValueError (baud), termios.error
            raise LinkLost(name, f"cannot open {settings.port}: {cause}") from cause
        self._reader = WireReader(name, port, clock, self._take)

    @property
    def failure(self) -> str:
        """Why the wire is gone, "" while it is there."""
        return self._reader.failure

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        """Return what has arrived since the last call, (n,) of SENSOR_SAMPLE, in the run's time; never waits.

        Measurements from before the run are left out.
        """
        rows = np.zeros(len(self._lines), SENSOR_SAMPLE)
        for row in rows:
            measured_s, values = self._lines.popleft()
            row["sensor"], row["number"] = self._number, self._count
            row["t_s"], row["received_s"] = measured_s - run_zero_s, now_s - run_zero_s
            row["value"][: self._n] = values
            self._count += 1
        return rows[rows["t_s"] >= 0.0]

    def close(self) -> None:
        """Stop the sensor, end the reader and close the port; may be called more than once, never raises."""
        self._reader.close(self._protocol.stop)

    def _take(self, data: bytes, received_s: float) -> None:
        """Split what was received by ``received_s`` into lines."""
        *lines, self._pending = (self._pending + data).split(b"\n")
        for line in lines:
            if line := line.strip(b"\r \0"):
                self._decode(line, received_s)
        if len(self._pending) > LONGEST_LINE:
            self._pending = b""
            self.refused["a line without an end"] += 1

    def _decode(self, line: bytes, received_s: float) -> None:
        try:
            values = self._protocol.decode(line[:LONGEST_LINE])
            if values is not None and not (len(values) == self._n and all(map(math.isfinite, values))):
                raise ValueError(f"{len(values)} numbers, or not finite: must be {self._n}")
        except ValueError as error:
            self.refused[str(error)[:_REASON]] += 1
            return
        if values is not None:
            on_wire_s = BITS_PER_BYTE * (len(line) + 2) / self._baud
            self._lines.append((received_s - on_wire_s - self._latency_s, values))
            self.last_s = received_s


def _framing(port: str, protocol: LineProtocol) -> dict[str, Any]:
    """Return the arguments of the port for bits and parity, which a pseudo terminal does not have, and refuses."""
    if os.path.realpath(port).startswith("/dev/pts/"):
        return {}
    return {"bytesize": protocol.bytesize, "parity": protocol.parity}
