"""Driver of an IMU on a wire: a thread reads frames, the cycle takes the mean rate since the last one."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter, deque
from typing import Any, Final

import numpy as np

from hil.config.tables.imu_wire import UDP, ImuWire
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.datagrams import DatagramPort
from hil.drivers.serial_port import open_serial
from hil.drivers.vmu.frame_codec import frame_codec
from hil.errors import LinkLost, LinkTimeout

NAME: Final = "imu"
_READ_WALL_S: Final = 0.1  # bound of one blocking read
_FIRST_S: Final = 2.0  # bench time that the first frame may take
_LOOK_S: Final = 0.01


class WiredImu:
    """Rates of the IMU of ``config``, in its own axes. step_s: of the cycle. Raises LinkLost if its port cannot be
    opened."""

    def __init__(self, config: ImuWire, step_s: float, clock: BenchClock) -> None:
        self._config, self._clock = config, clock
        port, by_datagrams = config.port or "", (config.port or "").startswith(UDP)
        self._decoder = frame_codec(config.frames).decoder(by_datagrams)
        self._lock, self._ending = threading.Lock(), threading.Event()
        self._rates: deque[Array] = deque(maxlen=max(1, round(config.rate_hz * step_s)))
        self._mean = np.zeros(3)
        self._failure = ""
        self._received_s: float | None = None
        self.counts: Counter[str] = Counter()
        """Frames, and those that have no rate."""
        try:
            if by_datagrams:
                host, _, number = port.removeprefix(UDP).rpartition(":")
                self._port: Any = DatagramPort(clock, host, int(number), _READ_WALL_S)
            else:
                self._port = open_serial(clock, port, config.baud, timeout=_READ_WALL_S, exclusive=True)
        except (OSError, ValueError, OverflowError) as error:
            raise LinkLost(NAME, f"cannot open {port or 'imu.port, which is not set'}: {error}") from error
        self._reader = clock.start_thread(self._read, "imu-reader")

    def wait_first(self) -> None:
        """Wait for the first frame. Raises LinkTimeout if none comes."""
        end_s = self._clock.now_s() + _FIRST_S
        while self._received_s is None:
            if self._failure or self._clock.now_s() > end_s:
                raise LinkTimeout(
                    NAME, self._failure or f"no frame of {self._config.frames} in {_FIRST_S:g} s{self._hint()}"
                )
            self._clock.sleep(_LOOK_S)

    def mean_rate(self) -> Array:
        """Return the mean rate of the last cycle, (3,), rad/s; the one before again without a new frame.

        Raises LinkTimeout after a silence of ``timeout_s``, LinkLost when the port is gone.
        """
        with self._lock:
            if self._failure:
                raise LinkLost(NAME, self._failure)
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
        decoder = self._decoder
        return {
            "frames": self.counts["frames"], "no_rate": self.counts["no_rate"], "crc_errors": decoder.crc_errors,
            "skipped_bytes": decoder.skipped_bytes, "invalid": decoder.invalid, "wrong_length": decoder.wrong_length,
        }  # fmt: skip

    def close(self) -> None:
        """End the reader and close the port; may be called more than once, never raises."""
        self._ending.set()
        with contextlib.suppress(Exception):  # a port of datagrams has no cancel_read
            self._port.cancel_read()
        self._clock.join(self._reader, 2.0 * _READ_WALL_S)
        with contextlib.suppress(Exception):
            self._port.close()

    def _hint(self) -> str:
        shown = ", ".join(f"{name} {count}" for name, count in self.numbers().items() if count)
        return f" (since open: {shown})" if shown else ""

    def _read(self) -> None:
        try:
            while not self._ending.is_set():
                data = self._port.read(max(1, self._port.in_waiting))
                received_s = self._clock.now_s()
                for decoded in self._decoder.feed(data, received_s) if data else ():
                    self.counts["frames"] += 1
                    if decoded.rate is None:
                        self.counts["no_rate"] += 1
                        continue
                    with self._lock:
                        self._rates.append(decoded.rate)
                        self._received_s = received_s
        except Exception as cause:  # any error that ends the thread is reported to the cycle
            if not self._ending.is_set():
                self._failure = f"{self._config.port}: {cause}"
