"""Driver of an IMU on a wire: a thread reads frames, the cycle takes the mean rate since the last one."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import Any, Final

import numpy as np

from hil.config.tables.wires import UDP, ImuWire
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.datagrams import DatagramPort
from hil.drivers.serial_port import open_serial
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.wire_reader import READ_WALL_S, WireReader
from hil.errors import LinkLost, LinkTimeout

NAME: Final = "imu"
_FIRST_S: Final = 2.0  # bench time that the first frame may take
_LOOK_S: Final = 0.01


class WiredImu:
    """Rates of the IMU of ``config``, in its own axes. step_s: of the cycle. Raises LinkLost if its port cannot be
    opened."""

    def __init__(self, config: ImuWire, step_s: float, clock: BenchClock) -> None:
        self._config, self._clock = config, clock
        port, by_datagrams = config.port or "", (config.port or "").startswith(UDP)
        wire: Any
        self._decoder = frame_codec(config.frames).decoder(by_datagrams or config.can is not None)
        self._lock = threading.Lock()
        self._rates: deque[Array] = deque(maxlen=max(1, round(config.rate_hz * step_s)))
        self._mean = np.zeros(3)
        self._received_s: float | None = None
        self.counts: Counter[str] = Counter()
        """Frames, and those that have no rate."""
        try:
            if config.can is not None:
                from hil.drivers.imu.can_frames import CanFrames  # of few rigs

                port, wire = f"CAN {config.can.channel}", CanFrames(config.can, clock)
            elif by_datagrams:
                host, _, number = port.removeprefix(UDP).rpartition(":")
                wire = DatagramPort(clock, host, int(number), READ_WALL_S)
            else:
                wire = open_serial(clock, port, config.baud, timeout=READ_WALL_S, exclusive=True)
        except (OSError, ValueError, OverflowError) as error:
            raise LinkLost(NAME, f"cannot open {port or 'imu.port, which is not set'}: {error}") from error
        self._reader = WireReader(NAME, wire, clock, self._receive)

    def wait_first(self) -> None:
        """Wait for the first frame. Raises LinkTimeout if none comes, LinkLost when the port is gone."""
        end_s = self._clock.now_s() + _FIRST_S
        while self._received_s is None:
            self._reader.check()
            if self._clock.now_s() > end_s:
                raise LinkTimeout(NAME, f"no frame of {self._config.frames} in {_FIRST_S:g} s{self._hint()}")
            self._clock.sleep(_LOOK_S)

    def mean_rate(self) -> Array:
        """Return the mean rate of the last cycle, (3,), rad/s; the one before again without a new frame.

        Raises LinkTimeout after a silence of ``timeout_s``, LinkLost when the port is gone.
        """
        self._reader.check()
        with self._lock:
            silent_s = np.inf if self._received_s is None else self._clock.now_s() - self._received_s
            if silent_s > self._config.timeout_s:
                raise LinkTimeout(
                    NAME, f"no rate for {silent_s:.3f} s, allowed {self._config.timeout_s:g} s{self._hint()}"
                )
            if self._rates:
                self._mean = np.mean(self._rates, axis=0)
                self._rates.clear()
            return self._mean

    def numbers(self) -> dict[str, int]:
        """Return the counters since the opening."""
        return {name: self.counts[name] for name in ("frames", "no_rate")} | self._decoder.counts()

    def close(self) -> None:
        """End the reader and close the port; may be called more than once, never raises."""
        self._reader.close()

    def _hint(self) -> str:
        shown = ", ".join(f"{name} {count}" for name, count in self.numbers().items() if count)
        return f" (since open: {shown})" if shown else ""

    def _receive(self, data: bytes, received_s: float) -> None:
        for decoded in self._decoder.feed(data, received_s):
            self.counts["frames"] += 1
            if decoded.rate is None:
                self.counts["no_rate"] += 1
                continue
            with self._lock:
                self._rates.append(decoded.rate)
                self._received_s = received_s
