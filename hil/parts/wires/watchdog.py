"""Watchdog process: holds the safety relay closed while the loop and the I/O process are alive.

``python -m hil.parts.wires.watchdog`` is started by ``IoProcesses``. It serves the digital I/O and pulses the charge
pump. When a heartbeat ceases it sets all outputs off, and the relay removes the torque from the drives; when the
watchdog itself dies the pulses cease, with the same effect.
"""

from __future__ import annotations

import signal
import socket

import numpy as np

from hil.config.rig import Rig
from hil.core.child_process import Message, serve
from hil.core.clock import BenchClock, clock_of
from hil.core.plug_ins import call
from hil.drivers.base import DiscreteIo
from hil.drivers.io import NAME
from hil.drivers.remote import io_layout
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.drivers.remote.server import LOOP_SILENCE_MAX_S, DeviceServer, raise_priority
from hil.drivers.returned import checked_inputs
from hil.errors import BenchError, LinkLost

_PERIOD_WALL_S = 0.004  # a tenth of the shortest silence to detect, less than a pulse's period
_WATCHED = {io_layout.LOOP: "the loop", io_layout.IO: "the I/O process"}


class Watchdog(DeviceServer):
    """Server of the digital I/O; opens the safety chain when the loop or the I/O process is silent."""

    def __init__(self, lines: DiscreteIo, memory: IoSharedMemory, requests: socket.socket, clock: BenchClock) -> None:
        super().__init__({NAME: lines}, memory, requests, clock, io_layout.WATCHDOG, _PERIOD_WALL_S)
        self._lines = lines
        self._outputs = np.zeros(1, io_layout.OUTPUTS)
        self._outputs_number = 0
        self._inputs_s = -1.0

    def step(self, now_s: float) -> None:
        """Pulse while the heartbeats continue; pass on outputs and inputs."""
        if self.stop_requested(NAME):
            self.stop_in_thread(NAME, self._lines.stop, now_s)
        if NAME not in self.served:
            return
        if silence := self._silence(now_s):
            self.stop_in_thread(NAME, self._lines.stop, now_s)
            self.fail(NAME, LinkLost(NAME, silence), now_s)
            return
        try:
            call(NAME, self._lines.pulse, now_s)
            number, _ = self.memory.block["io.outputs"].read(self._outputs)
            if number != self._outputs_number:
                self._outputs_number = number
                call(NAME, self._lines.write, io_layout.read_outputs(self._outputs), now_s)
            self._write_inputs(now_s)
        except BenchError as error:
            self.fail(NAME, error, now_s)

    def on_opened(self, name: str) -> None:
        """Skip outputs from before the opening, and write the first inputs before the request is answered."""
        self._outputs_number, _ = self.memory.block["io.outputs"].read(np.zeros(1, io_layout.OUTPUTS))
        self._inputs_s = -1.0
        self._write_inputs(self.clock.now_s())

    def stop_all(self, now_s: float) -> None:
        """Set all outputs off."""
        call(NAME, self._lines.stop, now_s)

    def _write_inputs(self, now_s: float) -> None:
        inputs = checked_inputs(NAME, self._lines.read, call(NAME, self._lines.read, now_s))
        if inputs.t_s != self._inputs_s:
            self._inputs_s = inputs.t_s
            self.memory.block["io.inputs"].write(io_layout.inputs_record(inputs), inputs.t_s)

    def _silence(self, now_s: float) -> str:
        """Return which process has been silent for too long, "" if none has."""
        for cell, name in _WATCHED.items():
            silent_s = self.silence_s(cell, now_s)
            if silent_s > LOOP_SILENCE_MAX_S:
                return f"safety chain opened: {name} has been silent for {silent_s:.3f} s{self.own_pause()}"
        return ""


def make(configuration: Message) -> Watchdog:
    """Return the watchdog of the configured rig; the threads of this process get its priority."""
    clock = clock_of(configuration)
    raise_priority(clock)
    rig = Rig.model_validate(configuration["rig"], strict=False)
    assert rig.io is not None
    memory = IoSharedMemory.attach(tuple(configuration["descriptors"]), rig.held_numbers)
    memory.note_calls(io_layout.WATCHDOG)
    return Watchdog(rig.io.make_driver(clock), memory, socket.socket(fileno=configuration["requests"]), clock)


def main() -> None:
    """Serve the devices until the parent ends this process."""
    serve(make, when_orphaned=signal.SIGTERM)


if __name__ == "__main__":
    main()
