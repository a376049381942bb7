"""The watchdog process: holds the safety relay closed as long as the loop and the I/O process are alive.

``python -m hil.processes.watchdog`` is the child; it gets its configuration from its parent. It has the digital
lines and pulses the charge pump. When a heartbeat ceases it sets all lines off, and the relay takes the
torque from the drives; when the watchdog itself dies the pulses cease, and the relay does the same.
"""

from __future__ import annotations

import signal
import socket
from typing import Any

import numpy as np

from hil.config.rig import Rig
from hil.core.clock import WallClock
from hil.drivers.base import DiscreteIo
from hil.drivers.emulator_process import serve
from hil.drivers.io import NAME
from hil.drivers.remote import io_layout
from hil.drivers.remote.host import LOOP_SILENCE_MAX_S, DeviceServer, raise_priority
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.errors import BenchError, LinkLost

_PERIOD_WALL_S = 0.004  # a tenth of the shortest silence that it has to notice, less than a pulse's period
_WATCHED = {io_layout.LOOP: "the loop", io_layout.HOST: "the I/O process"}


class Watchdog(DeviceServer):
    """Serves the digital lines for the loop."""

    def __init__(self, lines: DiscreteIo, exchange: IoSharedMemory, requests: socket.socket, clock: WallClock) -> None:
        super().__init__({NAME: lines}, exchange, requests, clock, io_layout.GUARD, _PERIOD_WALL_S)
        self._lines = lines
        self._outputs = np.zeros(1, io_layout.OUTPUTS)
        self._taken = 0
        self._shown_s = -1.0

    def serve(self, now_s: float) -> None:
        """Pulse while everybody is alive; hand over outputs and inputs."""
        if self.stop_is_new(NAME):
            self.stop_soon(self._lines, now_s)
        if NAME not in self.served:
            return
        if silence := self._silence(now_s):
            self.stop_soon(self._lines, now_s)
            self.fail(NAME, LinkLost(NAME, silence), now_s)
            return
        try:
            self._lines.pulse(now_s)
            number, _ = self.exchange.block["io.outputs"].read(self._outputs)
            if number != self._taken:
                self._taken = number
                self._lines.write(io_layout.read_outputs(self._outputs), now_s)
            self._show(now_s)
        except BenchError as error:
            self.fail(NAME, error, now_s)

    def begin(self, name: str) -> None:
        """Leave out outputs from before the opening, and have inputs there when it is answered."""
        self._taken, _ = self.exchange.block["io.outputs"].read(np.zeros(1, io_layout.OUTPUTS))
        self._shown_s = -1.0
        self._show(self.clock.now_s())

    def close(self) -> None:
        """All lines off, then let go of the wire."""
        self._lines.stop(self.clock.now_s())
        super().close()

    def _show(self, now_s: float) -> None:
        inputs = self._lines.read(now_s)
        if inputs.t_s != self._shown_s:
            self._shown_s = inputs.t_s
            self.exchange.block["io.inputs"].write(io_layout.inputs_record(inputs), inputs.t_s)

    def _silence(self, now_s: float) -> str:
        """Return who has been silent for too long, "" where everybody is heard."""
        for cell, name in _WATCHED.items():
            silent_s = self.silent_s(cell, now_s)
            if silent_s > LOOP_SILENCE_MAX_S:
                return f"safety chain opened: {name} has been silent for {silent_s:.3f} s"
        return ""


def make_watchdog(configuration: dict[str, Any]) -> Watchdog:
    """Return the watchdog for the configuration that the parent sent; threads of this process get its priority."""
    raise_priority()
    rig = Rig.model_validate(configuration["rig"], strict=False)
    clock = WallClock(configuration["epoch_ns"], configuration["speed"])
    assert rig.io is not None
    exchange = IoSharedMemory.attach(tuple(configuration["descriptors"]))
    return Watchdog(rig.io.make_driver(clock), exchange, socket.socket(fileno=configuration["requests"]), clock)


if __name__ == "__main__":
    serve(make_watchdog, when_orphaned=signal.SIGTERM)
